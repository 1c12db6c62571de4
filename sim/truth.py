"""What really happened: states, events, messages and slots of the whole fleet, which no client can see or change."""

import json
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, is_dataclass
from typing import Any, NamedTuple

from skyfolio.sim.link import Address
from skyfolio.sim.station import Vehicle
from skyfolio.sim.tlog import TlogWriter

SAMPLE_INTERVAL_S = 0.1
MAX_SAMPLES = 1_000_000
"""The log keeps this many samples (an hour of 27 vehicles) and drops the oldest beyond."""
MAX_MESSAGES = 200_000


class Sample(NamedTuple):
    """One vehicle at one moment of fleet time.

    Degrees (WGS 84), metres above home, above the ground beneath and above mean sea level, m/s; `mission_id` is 0
    without a mission, `battery` a share from 0 to 1 of what the pack holds, `pack` the id of the pack on board (empty
    without a ground crew).
    """

    t_s: float
    system_id: int
    lat_deg: float
    lon_deg: float
    relative_alt_m: float
    ground_speed_mps: float
    mode: str
    armed: bool
    alive: bool
    transmitting: bool
    mission_id: int
    mission_current: int
    battery: float = 1.0
    over_ground_m: float = 0.0
    altitude_amsl_m: float = 0.0
    pack: str = ""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at a moment of fleet time.

    Kinds: armed, disarmed, mode {mode}, takeoff, landed, crashed {impact_mps}, mission_accepted {mission_id, items},
    fence_accepted {items}, rally_accepted {items}, item_reached {seq}, failsafe {cause, action}, fault {fault, knobs},
    killed, muted {for_s}, unmuted, frozen {for_s}, thawed, rebooting, booted, gps_lost, gps_back, motor_failed,
    battery_set {share}, clock_jumped {seconds}, slot {slot, error_m}. Of the ground crew: off_pad {distance_m},
    swap_waits {because, full_in_s}, swap_begun {done_s}, swap_abandoned {because}, switched_off, swapped {pack, cycles,
    health, resistance_ohm, removed, removed_share}. Of the air, with system id 0: wind_front {east_mps, north_mps,
    gust_mps, ramp_s}.
    """

    t_s: float
    system_id: int
    kind: str
    detail: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LoggedMessage:
    """A message that a vehicle received ("in") or sent as an answer ("out"); streams are only counted.

    `command`: the MAV_CMD of a command or mission item that it received; None for other messages. `sender`: HOST:PORT
    from which it was received over UDP; None otherwise.
    """

    t_s: float
    system_id: int
    direction: str
    name: str
    command: int | None = None
    sender: str | None = None


Row = dict[str, Any]


class TruthLog:
    """Samples every 0.1 s of fleet time, events and messages, oldest first.

    `sent` counts frames by (system id, message id). `sink` gets every entry as a plain row at once, e.g. a file that
    outlives what is kept here; `tlog` gets every frame; `on_received` is called with fleet second, system id and
    message of everything that a vehicle receives. Extra `rows` (a plan's rates) may be added by `note`.
    """

    def __init__(self, max_samples: int = MAX_SAMPLES) -> None:
        self.samples: deque[Sample] = deque(maxlen=max_samples)
        self.events: list[Event] = []
        self.messages: deque[LoggedMessage] = deque(maxlen=MAX_MESSAGES)
        self.notes: list[Row] = []
        self.sent: Counter[tuple[int, int]] = Counter()
        self.sink: Callable[[Row], None] | None = None
        self.tlog: TlogWriter | None = None
        self.on_received: Callable[[float, int, Any], None] | None = None

    def record(self, t_s: float, vehicle: Vehicle) -> None:
        """Add a sample of a vehicle."""
        autopilot = vehicle.autopilot
        body = autopilot.dynamics.body
        sample = Sample(
            t_s,
            vehicle.system_id,
            *vehicle.position,
            body.ground_speed_mps,
            autopilot.mode.name,
            autopilot.armed,
            vehicle.alive,
            vehicle.transmitting,
            autopilot.runner.mission.mission_id,
            autopilot.runner.index,
            autopilot.battery.share,
            body.up_m - body.ground_m,
            autopilot.spec.home_alt_m + body.up_m,
            vehicle.pack_id,
        )
        self.samples.append(sample)
        if self.sink is not None:
            self.sink(row_of(sample))

    def add_event(self, event: Event) -> None:
        """Add an event."""
        self.events.append(event)
        self._sink(event)

    def note(self, row: Row) -> None:
        """Add a row of another kind, which it names in "kind"."""
        self.notes.append(row)
        if self.sink is not None:
            self.sink(row)

    def frame_sent(self, t_s: float, system_id: int, frame: bytes) -> None:
        """Count a frame that a vehicle sends, and write it to the `.tlog`."""
        self.sent[system_id, int.from_bytes(frame[7:10], "little")] += 1
        if self.tlog is not None:
            self.tlog.write(t_s, frame)

    def message_received(self, t_s: float, system_id: int, message: Any, sender: Address) -> None:
        """Log a message that a vehicle receives."""
        command = getattr(message, "command", None)
        at = f"{sender[0]}:{sender[1]}" if len(sender) > 1 else None
        self._message(LoggedMessage(t_s, system_id, "in", message.get_type(), command, at))
        if self.on_received is not None:
            self.on_received(t_s, system_id, message)
        if self.tlog is not None:
            self.tlog.write(t_s, bytes(message.get_msgbuf()))

    def message_answered(self, t_s: float, system_id: int, name: str) -> None:
        """Log the name of a message that a vehicle sends as an answer."""
        self._message(LoggedMessage(t_s, system_id, "out", name))

    def of(self, system_id: int) -> list[Sample]:
        """Return the samples of one vehicle."""
        return [sample for sample in self.samples if sample.system_id == system_id]

    def happened(self, kind: str, system_id: int | None = None) -> list[Event]:
        """Return the events of a kind, of one vehicle or of all."""
        return [event for event in self.events if event.kind == kind and system_id in (None, event.system_id)]

    def rows(self) -> list[Row]:
        """Return the samples as plain dictionaries, ready for JSON or a table."""
        return [sample._asdict() for sample in self.samples]

    def lines(self) -> Iterator[str]:
        """Return everything as JSON lines: samples, events, messages, notes."""
        entries: list[Sample | Event | LoggedMessage] = [*self.samples, *self.events, *self.messages]
        yield from (as_line(row_of(entry)) for entry in entries)
        yield from (as_line(note) for note in self.notes)

    def _message(self, message: LoggedMessage) -> None:
        self.messages.append(message)
        self._sink(message)

    def _sink(self, entry: Sample | Event | LoggedMessage) -> None:
        if self.sink is not None:
            self.sink(row_of(entry))


def row_of(entry: Sample | Event | LoggedMessage) -> Row:
    """Return an entry as a plain row; `log` is its type: sample, event or message."""
    if isinstance(entry, Event):
        row = {"log": "event", "t_s": round(entry.t_s, 6), "system_id": entry.system_id, "kind": entry.kind}
        return {**row, **entry.detail}
    if isinstance(entry, Sample):
        return {"log": "sample", **entry._asdict(), "t_s": round(entry.t_s, 6)}
    return {"log": "message", **asdict(entry), "t_s": round(entry.t_s, 6)}


def as_line(row: Row) -> str:
    """Return a row as one line of JSON; the same row always gives the same bytes."""
    return json.dumps(row, default=_plain, separators=(",", ":"), allow_nan=True)


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    raise TypeError(f"cannot write {type(value).__name__} as JSON")
