"""What really happened: sampled states and events of the whole fleet, which no client can see or bend."""

from collections import deque
from dataclasses import asdict, dataclass, field
from typing import Any

from sim.station import Vehicle

SAMPLE_INTERVAL_S = 0.1
MAX_SAMPLES = 1_000_000
"""The log keeps this many samples (an hour of 27 vehicles) and drops the oldest beyond."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One vehicle at one moment of fleet time; altitude above its home, `mission_id` 0 without a mission."""

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


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at a moment of fleet time.

    Kinds: armed, disarmed, mode {mode}, takeoff, landed, crashed {impact_mps}, mission_accepted {mission_id, items},
    item_reached {seq}, killed, muted.
    """

    t_s: float
    system_id: int
    kind: str
    detail: dict[str, Any] = field(default_factory=dict)


class TruthLog:
    """Samples every 0.1 s of fleet time, and events, oldest first."""

    def __init__(self, max_samples: int = MAX_SAMPLES) -> None:
        self.samples: deque[Sample] = deque(maxlen=max_samples)
        self.events: list[Event] = []

    def record(self, t_s: float, vehicle: Vehicle) -> None:
        """Add a sample of a vehicle."""
        autopilot = vehicle.autopilot
        self.samples.append(
            Sample(
                t_s,
                vehicle.system_id,
                *vehicle.position,
                autopilot.body.ground_speed_mps,
                autopilot.mode.name,
                autopilot.armed,
                vehicle.alive,
                vehicle.transmitting,
                autopilot.runner.mission.mission_id,
                autopilot.runner.index,
            )
        )

    def of(self, system_id: int) -> list[Sample]:
        """Return the samples of one vehicle."""
        return [sample for sample in self.samples if sample.system_id == system_id]

    def happened(self, kind: str, system_id: int | None = None) -> list[Event]:
        """Return the events of a kind, of one vehicle or of all."""
        return [event for event in self.events if event.kind == kind and system_id in (None, event.system_id)]

    def rows(self) -> list[dict[str, Any]]:
        """Return the samples as plain dictionaries, ready for JSON or a table."""
        return [asdict(sample) for sample in self.samples]
