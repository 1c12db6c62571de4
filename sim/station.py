"""One vehicle of the fleet: an autopilot with a radio, and what a fault can do to either."""

from collections.abc import Callable, Iterable
from typing import Any

from sim.autopilot import Autopilot
from sim.lineup import VehicleSpec
from sim.link import Address, DatagramLink
from sim.missions import Mission
from sim.modes import Mode
from sim.vehicle import Limits
from sim.wire import Encoder, Message

MAX_DATAGRAM_BYTES = 1200


class Vehicle:
    """A simulated vehicle as its surroundings see it. Made by `Fleet`."""

    def __init__(
        self,
        spec: VehicleSpec,
        *,
        limits: Limits | None,
        protocol_clock: Callable[[], float],
        on_event: Callable[[str, dict[str, Any]], None],
        boot_s: float,
        phase: float,
    ) -> None:
        self.spec = spec
        self.autopilot = Autopilot(
            spec, limits=limits, protocol_clock=protocol_clock, on_event=on_event, boot_s=boot_s, phase=phase
        )
        self.link: DatagramLink | None = None
        self._encoder = Encoder(spec.system_id)
        self._emit = on_event
        self._killed = False
        self._muted = False

    @property
    def system_id(self) -> int:
        """The MAVLink system id."""
        return self.spec.system_id

    @property
    def position(self) -> tuple[float, float, float]:
        """True latitude and longitude (degrees) and altitude above home (metres)."""
        body = self.autopilot.body
        return (*self.autopilot.frame.to_geodetic(body.east_m, body.north_m), body.up_m)

    @property
    def mode(self) -> Mode:
        """The flight mode."""
        return self.autopilot.mode

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""
        return self.autopilot.armed

    @property
    def mission(self) -> Mission:
        """The mission on board."""
        return self.autopilot.runner.mission

    @property
    def alive(self) -> bool:
        """Whether it still works: neither killed nor crashed."""
        return not (self._killed or self.autopilot.crashed)

    @property
    def transmitting(self) -> bool:
        """Whether its radio works: neither killed nor muted."""
        return not (self._killed or self._muted)

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly `dt_s`, to arrive at fleet time `now_s`, and send what is due."""
        self.autopilot.step(now_s, dt_s)
        self.flush()

    def flush(self) -> None:
        """Send what the autopilot has for everybody."""
        messages = self.autopilot.due() if not self._killed else []
        if self.link is not None and self.link.is_open:
            for datagram in self._datagrams(messages):
                self.link.broadcast(datagram)

    def receive(self, message: Any, sender: Address) -> None:
        """Answer a message, unless the vehicle is dead or deaf."""
        if not self.transmitting or self.link is None:
            return
        for datagram in self._datagrams(self.autopilot.handle(message)):
            self.link.send(datagram, sender)
        self.flush()

    def kill(self) -> None:
        """Stop motors, autopilot and radio for good: it falls, and never sends again."""
        if not self._killed:
            self._killed = True
            self._close()
            self._emit("killed", {})
            self.autopilot.cut_power()

    def mute(self) -> None:
        """Break the radio for good: it flies on as before, sends nothing and hears nothing."""
        if not self._muted:
            self._muted = True
            self._close()
            self._emit("muted", {})

    def _close(self) -> None:
        if self.link is not None:
            self.link.close()

    def _datagrams(self, messages: Iterable[Message]) -> list[bytes]:
        """Pack messages in order, several to a datagram."""
        datagrams: list[bytes] = []
        for message in messages:
            frame = self._encoder.encode(message)
            if datagrams and len(datagrams[-1]) + len(frame) <= MAX_DATAGRAM_BYTES:
                datagrams[-1] += frame
            else:
                datagrams.append(frame)
        return datagrams
