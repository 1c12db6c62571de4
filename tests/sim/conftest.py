"""Vehicles on a bench: an autopilot without sockets, in virtual time, and a ground station that talks to it."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import settings
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim import Fleet
from skyfolio.sim.autopilot import Autopilot
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.wire import Decoder

settings.register_profile("sim", deadline=None)
settings.load_profile("sim")

HOME = (47.397742, 8.545594)
STEP_S = 0.05


class GroundStation:
    """Makes messages as they arrive from a ground station: packed, sent and parsed again."""

    def __init__(self, system_id: int = 245, component_id: int = 190) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._decoder = Decoder()

    def frame(self, name: str, *values: Any) -> bytes:
        """Return the bytes of a message, e.g. `frame("mission_count", 1, 1, 3, 0)`."""
        return bytes(getattr(dialect, f"MAVLink_{name}_message")(*values).pack(self._mav))

    def message(self, name: str, *values: Any) -> Any:
        """Return a message as a receiver parses it."""
        (message,) = self._decoder.decode(self.frame(name, *values))
        return message

    def command(self, command: int, *params: float, system_id: int = 1) -> Any:
        """Return a COMMAND_LONG; parameters left out are 0."""
        return self.message("command_long", system_id, 1, command, 0, *params, *[0.0] * (7 - len(params)))


class Items:
    """Mission items around a home, in metres north and east of it."""

    def __init__(self) -> None:
        self.seq = 0

    def add(
        self, command: int, *, north_m: float = 0.0, east_m: float = 0.0, up_m: float = 20.0, **fields: float
    ) -> Any:
        """Return the values of the next MISSION_ITEM_INT (everything behind the target)."""
        x, y = round((HOME[0] + north_m / 111_180.0) * 1e7), round((HOME[1] + east_m / 75_450.0) * 1e7)
        values = {"frame": 6, "current": 0, "p1": 0.0, "p2": 0.0, "x": x, "y": y, **fields}
        item = (
            self.seq,
            int(values["frame"]),
            command,
            int(values["current"]),
            1,
            values["p1"],
            values["p2"],
            0.0,
            0.0,
        )
        self.seq += 1
        return (*item, int(values["x"]), int(values["y"]), up_m, 0)

    def waypoint(self, north_m: float, east_m: float, up_m: float = 20.0, **fields: float) -> Any:
        """Return a NAV_WAYPOINT."""
        return self.add(16, north_m=north_m, east_m=east_m, up_m=up_m, **fields)

    def speed(self, mps: float, **fields: float) -> Any:
        """Return a DO_CHANGE_SPEED."""
        return self.add(178, up_m=0.0, p1=1.0, p2=mps, **{"frame": 2.0, "x": 0.0, "y": 0.0, **fields})


@dataclass
class Bench:
    """One autopilot in virtual time; `wall_s` is the clock of its protocol timers."""

    wall_s: float = 0.0
    events: list[tuple[float, str, dict[str, Any]]] = field(default_factory=list)
    sent: list[Any] = field(default_factory=list)
    gcs: GroundStation = field(default_factory=GroundStation)
    flavour: str = "px4"
    booted_s_ago: float = 60.0

    def __post_init__(self) -> None:
        self.autopilot = Autopilot(
            VehicleSpec(1, *HOME, autopilot=self.flavour, booted_s_ago=self.booted_s_ago),
            protocol_clock=lambda: self.wall_s,
            on_event=lambda kind, detail: self.events.append((self.autopilot.now_s, kind, detail)),
        )

    def fly(self, seconds: float) -> None:
        """Let fleet time pass."""
        for _ in range(round(seconds / STEP_S)):
            self.autopilot.step(self.autopilot.now_s + STEP_S, STEP_S)
            self.sent += self.autopilot.due()

    def fly_until(self, condition: Callable[[], bool], within_s: float = 300.0) -> float:
        """Fly until a condition holds and return the seconds it took; fails if it never does."""
        start = self.autopilot.now_s
        while not condition():
            assert self.autopilot.now_s - start < within_s, f"did not happen within {within_s} s: {self.events[-5:]}"
            self.fly(STEP_S)
        return self.autopilot.now_s - start

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Send a message and return the answers."""
        return self.autopilot.handle(self.gcs.message(name, *values))

    def command(self, command: int, *params: float) -> int:
        """Send a COMMAND_LONG and return the MAV_RESULT."""
        ack = self.autopilot.handle(self.gcs.command(command, *params))[0]
        assert (ack.get_type(), ack.command) == ("COMMAND_ACK", command)
        return int(ack.result)

    def upload(self, *items: Any) -> Any:
        """Upload a mission and return the last answer."""
        (answer,) = self.ask("mission_count", 1, 1, len(items), 0)
        for item in items:
            assert answer.get_type() in ("MISSION_REQUEST_INT", "MISSION_REQUEST")
            answer = self.ask("mission_item_int", 1, 1, *item)[-1]
        return answer

    def take_off(self, up_m: float = 20.0) -> None:
        """Arm, climb and hold."""
        if self.flavour == "ardupilot":
            assert self.command(dialect.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == dialect.MAV_RESULT_ACCEPTED
            assert self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == dialect.MAV_RESULT_ACCEPTED
            assert self.command(dialect.MAV_CMD_NAV_TAKEOFF, *[0.0] * 6, up_m) == dialect.MAV_RESULT_ACCEPTED
            self.fly_until(lambda: abs(self.autopilot.body.up_m - up_m) < 0.1)
            return
        self.autopilot.parameters["MIS_TAKEOFF_ALT"] = up_m
        assert self.command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == dialect.MAV_RESULT_ACCEPTED
        assert self.command(dialect.MAV_CMD_NAV_TAKEOFF, *[float("nan")] * 7) == dialect.MAV_RESULT_ACCEPTED
        self.fly_until(lambda: abs(self.autopilot.body.up_m - up_m) < 0.1)

    def set_mode(self, sub_mode: int) -> int:
        """Command one of PX4's AUTO modes, or any of ArduCopter's, and return the MAV_RESULT."""
        if self.flavour == "ardupilot":
            return self.command(dialect.MAV_CMD_DO_SET_MODE, 1.0, float(sub_mode))
        return self.command(dialect.MAV_CMD_DO_SET_MODE, 1.0, 4.0, float(sub_mode))

    def kinds(self) -> list[str]:
        """Return the kinds of all events, in order."""
        return [kind for _, kind, _ in self.events]

    def reached(self) -> list[int]:
        """Return the mission items reached, in order."""
        return [detail["seq"] for _, kind, detail in self.events if kind == "item_reached"]


class VirtualGcs:
    """A ground station beside a fleet without sockets, in virtual time; one vehicle, one transfer at a time.

    It repeats only MISSION_COUNT, MISSION_REQUEST_LIST and its requests on a timer (1.5 s, or 0.25 s for an item), and
    sends items when they are asked for, and the last one again after silence; an error then makes it read back.
    """

    def __init__(self, fleet: Fleet, system_id: int = 1) -> None:
        self.fleet, self.system_id = fleet, system_id
        self.heard: list[Any] = []
        self._gcs = GroundStation()
        self._decoder = Decoder()
        self._to_fleet = fleet.attach(self._hear)

    def _hear(self, data: bytes, system_id: int) -> None:
        if system_id == self.system_id:
            self.heard += self._decoder.decode(data)

    def send(self, name: str, *values: Any) -> None:
        """Send a message to the vehicle."""
        self._to_fleet(self._gcs.frame(name, *values), self.system_id)

    def wait_for(self, names: tuple[str, ...], within_s: float) -> Any:
        """Return the next message of these names and forget those before it, or None after `within_s`."""
        deadline = self.fleet.now_s + within_s
        while True:
            while self.heard:
                message = self.heard.pop(0)
                late = message.get_type() == "MISSION_ACK" and message.type == dialect.MAV_MISSION_INVALID_SEQUENCE
                if message.get_type() in names and not late:
                    return message
            if self.fleet.now_s >= deadline:
                return None
            self.fleet.step_to(self.fleet.now_s + STEP_S)

    def upload(self, items: list[Any], retries: int = 5) -> bool:
        """Upload a mission; return whether it is certain to be on board."""
        requests = ("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
        answer = None
        for _ in range(retries + 1):
            self.send("mission_count", self.system_id, 1, len(items), 0)
            answer = self.wait_for(requests, 1.5)
            if answer is not None:
                break
        last = len(items) - 1
        sent, tries = -1, retries
        while answer is None or answer.get_type() != "MISSION_ACK":
            if answer is not None:
                sent = max(sent, answer.seq)
                self.send("mission_item_int", self.system_id, 1, *items[answer.seq])
            elif sent < last or tries == 0:
                break
            else:
                tries -= 1
                self.send("mission_item_int", self.system_id, 1, *items[last])
            answer = self.wait_for(requests, 1.5 if sent == last else 8.5)
        if answer is not None and answer.type == dialect.MAV_MISSION_ACCEPTED:
            return True
        return sent == last and self.read_back(items)

    def read_back(self, items: list[Any]) -> bool:
        """Return whether the vehicle holds these items: command and place of all but a home."""
        count = self._ask("mission_request_list", (self.system_id, 1, 0), ("MISSION_COUNT",), 1.5)
        if count is None or count.count != len(items):
            return False
        for seq in range(1, len(items)):
            for _ in range(20):
                item = self._ask("mission_request_int", (self.system_id, 1, seq, 0), ("MISSION_ITEM_INT",), 0.25)
                if item is None or item.seq == seq:
                    break
            if item is None or (item.seq, item.command, item.x, item.y) != (
                seq,
                items[seq][2],
                items[seq][9],
                items[seq][10],
            ):
                return False
        self.send("mission_ack", self.system_id, 1, dialect.MAV_MISSION_ACCEPTED, 0)
        return True

    def _ask(self, name: str, values: tuple[Any, ...], names: tuple[str, ...], within_s: float) -> Any:
        for _ in range(20):
            self.send(name, *values)
            answer = self.wait_for(names, within_s)
            if answer is not None:
                return answer
        return None


class Listener(asyncio.DatagramProtocol):
    """A ground station's socket: receives datagrams with their senders."""

    def __init__(self) -> None:
        self.heard: list[tuple[Any, tuple[str, int]]] = []
        self._decoders: dict[tuple[str, int], Decoder] = {}
        self.transport: asyncio.DatagramTransport | None = None

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Keep the messages."""
        decoder = self._decoders.setdefault(addr, Decoder())
        self.heard += [(message, addr) for message in decoder.decode(data)]


@pytest.fixture
def bench() -> Bench:
    """An autopilot on the ground."""
    return Bench()


@pytest.fixture
def copter() -> Bench:
    """An ArduCopter on the ground."""
    return Bench(flavour="ardupilot")


@pytest.fixture
def copter_up() -> Bench:
    """An ArduCopter that hovers 20 m above home in GUIDED."""
    bench = Bench(flavour="ardupilot")
    bench.take_off()
    return bench


@pytest.fixture
def airborne() -> Bench:
    """An autopilot that holds 20 m above home."""
    bench = Bench()
    bench.take_off()
    return bench


@pytest.fixture
def items() -> Items:
    """A counter of mission items."""
    return Items()


@pytest.fixture
def gcs() -> GroundStation:
    """A ground station."""
    return GroundStation()


@pytest.fixture(scope="session")
def new_bench() -> Callable[..., Bench]:
    """A maker of benches, for tests that need a fresh one for each example."""
    return Bench


@pytest.fixture
def new_station() -> Callable[..., GroundStation]:
    """A maker of ground stations with other ids."""
    return GroundStation


@pytest.fixture
def listener() -> Callable[[], Listener]:
    """A maker of datagram protocols that keep what they receive."""
    return Listener


@pytest.fixture
def virtual_gcs() -> Callable[[Fleet], VirtualGcs]:
    """A maker of ground stations beside a fleet in virtual time."""
    return VirtualGcs
