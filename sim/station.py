"""One vehicle of the fleet: an autopilot with a radio, and what a fault can do to either."""

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Protocol

from skyfolio.sim.autopilot import Autopilot
from skyfolio.sim.base_station import BaseStation
from skyfolio.sim.kinematics import Body, Limits
from skyfolio.sim.land import Hills
from skyfolio.sim.link import Address, Link, Radio
from skyfolio.sim.missions import Mission
from skyfolio.sim.modes import Mode
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.weather import Air
from skyfolio.sim.wire import Encoder, Message

MAX_DATAGRAM_BYTES = 1200
UNREAD = 256
"""How many messages wait for an autopilot that hangs; older ones are lost."""
REST_S = 0.5
"""The longest time for which a vehicle that stands on the ground is left alone."""
REBOOT_S = 3.0
"""How long an autopilot sends nothing when it reboots."""


class Tap(Protocol):
    """Takes every message of every vehicle at fleet time `t_s`, as the vehicle sends or decodes it.

    What a link does to a message happens after it is sent, and before it is received.
    """

    def frame_sent(self, t_s: float, system_id: int, frame: bytes) -> None:
        """Take a frame that a vehicle sends."""

    def message_received(self, t_s: float, system_id: int, message: Any, sender: Address) -> None:
        """Take a message that a vehicle receives from this address."""

    def message_answered(self, t_s: float, system_id: int, name: str) -> None:
        """Take the name of a message that a vehicle sends as an answer."""


class Vehicle:
    """A simulated vehicle with its radio; `Fleet` creates it."""

    def __init__(
        self,
        spec: VehicleSpec,
        *,
        limits: Limits | None,
        radio: Radio,
        on_event: Callable[[str, dict[str, Any]], None],
        now_s: float,
        phase: float,
        air: Air,
        tap: Tap,
        encoder: Encoder,
        hills: Hills | None = None,
    ) -> None:
        self.spec = spec
        self.system_id = spec.system_id
        """The MAVLink system id."""
        self.pack_id = ""
        """The id of the battery pack on board; empty without a ground crew, which knows them apart."""
        self.radio = radio
        self.autopilot = Autopilot(
            spec,
            limits=limits,
            protocol_clock=radio.clock,
            on_event=on_event,
            now_s=now_s,
            phase=phase,
            air=air,
            hills=hills,
        )
        self.base_station = BaseStation()
        self.withheld: set[str] = set()
        """Names of messages that the radio does not send."""
        self.link: Link | None = None
        self._encoder = encoder
        self._emit = on_event
        self._tap = tap
        self._now_s = now_s
        self._killed = False
        self.is_off = False
        """Whether somebody has switched it off, on the ground."""
        self._muted_until_s = self._frozen_until_s = self._booting_until_s = -math.inf
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._frozen_since: tuple[float, float] | None = None
        self._stepped_s, self._rests_until_s = now_s, -math.inf
        self._where: tuple[Body, tuple[float, float, float]] | None = None
        self._unread: deque[tuple[Any, Address]] = deque(maxlen=UNREAD)

    @property
    def position(self) -> tuple[float, float, float]:
        """True latitude and longitude (degrees) and altitude above home (metres)."""
        body = self.autopilot.body
        if self._where is None or self._where[0] is not body:
            self._where = body, (*self.autopilot.frame.to_geodetic(body.east_m, body.north_m), body.up_m)
        return self._where[1]

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
    def item(self) -> int:
        """The current item of the mission on board."""
        return self.autopilot.runner.index

    @property
    def alive(self) -> bool:
        """Whether the vehicle still works: neither killed nor crashed."""
        return not (self._killed or self.autopilot.dynamics.crashed)

    @property
    def running(self) -> bool:
        """Whether the autopilot runs: neither killed, frozen nor booting."""
        now_s = self._now_s
        return now_s >= self._frozen_until_s and now_s >= self._booting_until_s and not self._killed

    @property
    def transmitting(self) -> bool:
        """Whether the radio works and the autopilot uses it."""
        return self.running and self._now_s >= self._muted_until_s and not self.autopilot.component_failures.silenced

    @property
    def _hangs(self) -> bool:
        """Whether the autopilot hangs, while its receiver still fills the buffer."""
        running = not self._killed and self._now_s >= self._booting_until_s
        return running and self._now_s < self._frozen_until_s and self._now_s >= self._muted_until_s

    def step(self, now_s: float, dt_s: float) -> None:
        """Fly for `dt_s` seconds, to arrive at fleet time `now_s`, and send what is due."""
        self._now_s = now_s
        if self._later:
            self._do_what_is_due(now_s, dt_s)
        if self.is_off:
            self._stepped_s = now_s
            return
        if now_s < self._rests_until_s - 1e-9 and self._rests:
            if self.link is not None:
                self.link.pump()
            return
        self._move(now_s, dt_s)
        if self.autopilot.component_failures.take_reboot_request():
            self.flush()
            self.reboot(REBOOT_S)
        self.flush()
        self._rests_until_s = min(self.autopilot.next_due_s, now_s + REST_S)

    @property
    def _rests(self) -> bool:
        """Whether it may be left alone for a while: it stands on the ground, its autopilot runs, and nothing moves."""
        return self.running and not self.is_off and self.autopilot.rests

    def _move(self, now_s: float, dt_s: float) -> None:
        """Catch up to fleet time `now_s`: the rest that it had, and a step of `dt_s` unless it rests still."""
        if self._rests:
            self._end_rest(now_s)
            return
        self._end_rest(now_s - dt_s)
        if self.running or self._killed:
            self.autopilot.step(now_s, dt_s)
        else:
            self.autopilot.coast(now_s, dt_s)
        self._stepped_s = now_s

    def _end_rest(self, now_s: float) -> None:
        """Let the time pass that it has rested until fleet time `now_s`."""
        self._rests_until_s = -math.inf
        if self._stepped_s < now_s - 1e-9:
            self.autopilot.rest(now_s, now_s - self._stepped_s)
            self._stepped_s = now_s

    def wake(self) -> None:
        """End its rest, because something happens to it now."""
        if self._rests:
            self._end_rest(self._now_s)

    def _do_what_is_due(self, now_s: float, dt_s: float) -> None:
        due = [entry for entry in self._later if entry[0] <= now_s + 1e-9]
        if due and self._rests:
            self._end_rest(now_s - dt_s)
        for entry in due:
            self._later.remove(entry)
            entry[1]()

    def flush(self) -> None:
        """Broadcast what the autopilot sends, and deliver what the link has delayed."""
        messages = self.autopilot.due() if self.running else []
        if self.link is None or not self.link.is_open:
            return
        if messages and self.transmitting:
            for datagram in self._datagrams(messages):
                self.link.broadcast(datagram)
        self.link.pump()

    def receive(self, message: Any, sender: Address) -> None:
        """Answer a message, unless the vehicle cannot receive; one that hangs answers when it goes on."""
        if self._hangs:
            self._unread.append((message, sender))
        if not self.transmitting or self.link is None:
            return
        self.wake()
        self._tap.message_received(self._now_s, self.system_id, message, sender)
        answers = self.autopilot.handle(message)
        for answer in answers:
            self._tap.message_answered(self._now_s, self.system_id, answer.get_type())
        for datagram in self._datagrams(answers):
            self.link.send(datagram, sender)
        self.flush()

    def after(self, seconds: float | None, action: Callable[[], None]) -> None:
        """Call `action` once `seconds` of fleet time have passed; None: never."""
        if seconds is not None:
            self._later.append((self._now_s + seconds, action))

    def kill(self) -> None:
        """Stop motors, autopilot and radio for good: it falls, and never sends again."""
        if not self._killed:
            self._killed = True
            if self.link is not None:
                self.link.close()
            self._emit("killed", {})
            self.autopilot.component_failures.cut_power()

    def mute(self, for_s: float | None = None) -> None:
        """Break the radio, for `for_s` seconds or for good: the vehicle flies on, but neither sends nor receives."""
        if self._now_s >= self._muted_until_s:
            self._emit("muted", {} if for_s is None else {"for_s": for_s})
        self._muted_until_s = self._until(for_s)
        self.radio.up.clear()
        self.radio.down.clear()
        self.after(for_s, lambda: self._emit("unmuted", {}))

    def freeze(self, for_s: float | None = None) -> None:
        """Let the autopilot hang, for `for_s` seconds or for good; then it goes on as if nothing had happened."""
        self._emit("frozen", {} if for_s is None else {"for_s": for_s})
        self._frozen_until_s = self._until(for_s)
        if self._frozen_since is None:
            self._frozen_since = (self._now_s, self.radio.clock())
        self.after(for_s, self._thaw)

    def _thaw(self) -> None:
        if self._frozen_since is None or self._now_s < self._frozen_until_s - 1e-9:
            return
        since_s, since_wall_s = self._frozen_since
        self._frozen_since, self._frozen_until_s = None, -math.inf
        self.autopilot.thaw(self._now_s - since_s, self.radio.clock() - since_wall_s)
        self._emit("thawed", {})
        unread = list(self._unread)
        self._unread.clear()
        for message, sender in unread:
            self.receive(message, sender)

    def reboot(self, for_s: float = REBOOT_S) -> None:
        """Restart the autopilot; it neither sends nor receives until it is up again after `for_s` seconds."""
        if self.is_off:
            return
        self._emit("rebooting", {})
        self._go_down(self._now_s + for_s)
        self.after(for_s, self._boot)

    def switch_off(self) -> None:
        """Cut the power of a vehicle that stands on the ground, until `switch_on`."""
        self.is_off = True
        self._emit("switched_off", {})
        self._go_down(math.inf)

    def switch_on(self) -> None:
        """Give it power again: its autopilot boots."""
        self.is_off, self._booting_until_s = False, -math.inf
        self._boot()

    def _go_down(self, until_s: float) -> None:
        self.autopilot.shut_down()
        self._frozen_since, self._frozen_until_s = None, -math.inf
        self._unread.clear()
        self._booting_until_s = until_s

    def _boot(self) -> None:
        if self.is_off or self._now_s < self._booting_until_s - 1e-9:
            return
        self.autopilot.boot(self._now_s)
        self._emit("booted", {})

    def _until(self, for_s: float | None) -> float:
        return math.inf if for_s is None else self._now_s + for_s

    def _datagrams(self, messages: Iterable[Message]) -> list[bytes]:
        """Return datagrams with the messages in order, several in each."""
        datagrams: list[bytes] = []
        for message in messages:
            if self.withheld and message.get_type() in self.withheld:
                continue
            frame = self._encoder.encode(message)
            self._tap.frame_sent(self._now_s, self.system_id, frame)
            if datagrams and len(datagrams[-1]) + len(frame) <= MAX_DATAGRAM_BYTES:
                datagrams[-1] += frame
            else:
                datagrams.append(frame)
        return datagrams
