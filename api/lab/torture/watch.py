"""What is seen of one drill: events, journal, blows, and the ground truth, which the service cannot know."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.operation_views import OperationView
from skyfolio.api.lab.torture.drill import Blow, Drill
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.store.event_log import Event
from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.station import Vehicle

TAKES_OVER = frozenset({"HOLD", "RETURN", "LAND", "DISARM"})
"""Actions of a failsafe that end the mission."""


@dataclass(frozen=True, kw_only=True)
class Struck:
    """A blow, when it struck (virtual seconds), and the state of the operation then."""

    at_s: float
    state: str
    blow: Blow


@dataclass
class Seen:
    """What was seen so far. `end` and `journal` are there once the drill is over."""

    drill: Drill
    ground: Ground
    operation_id: str = ""
    struck: list[Struck] = field(default_factory=list)
    harmed: dict[int, float] = field(default_factory=dict)
    """Since when each vehicle is not what it was: by a blow to it, virtual seconds."""
    ordered: dict[int, float] = field(default_factory=dict)
    """When the operator ordered each vehicle last."""
    foreign: dict[int, float] = field(default_factory=dict)
    """Since when each vehicle is flown by a human or a failsafe."""
    state: str = "none"
    coverage: Counter[tuple[str, str]] = field(default_factory=Counter)
    received: list[tuple[float, int, Any]] = field(default_factory=list)
    """Messages that vehicles received since the last look: virtual second, system id, message."""
    broken: dict[str, str] = field(default_factory=dict)
    """What was broken, by invariant, as it was seen first."""
    end: OperationView | None = None
    events: list[Event] = field(default_factory=list)
    journal: list[Entry] = field(default_factory=list)
    known_missions: set[tuple[int, int, int]] = field(default_factory=set)
    """Missions on board that were found among the assigned ones: system id, checksum, items."""
    _truth_seen: int = 0
    _frame: LocalFrame | None = None

    def follow_truth(self) -> None:
        """Take in what happened to vehicles since the last look."""
        events = self.ground.fleet.truth.events
        for event in events[self._truth_seen :]:
            system_id = event.system_id
            if event.kind == "fault":
                self.harmed.setdefault(system_id, event.t_s)
                if event.detail.get("fault") == "mode_change":
                    self.foreign[system_id] = event.t_s
            elif event.kind == "failsafe" and event.detail.get("action") in TAKES_OVER:
                self.harmed.setdefault(system_id, event.t_s)
                self.foreign.setdefault(system_id, event.t_s)
            elif event.kind == "disarmed":
                self.foreign.pop(system_id, None)
        self._truth_seen = len(events)

    def place_m(self, vehicle: Vehicle) -> tuple[float, float, float]:
        """Return where a vehicle truly is: metres east and north of the scenario's origin, and above its home."""
        if self._frame is None:
            origin = self.ground.scenario.origin
            self._frame = LocalFrame(origin.lat_deg, origin.lon_deg)
        lat_deg, lon_deg, up_m = vehicle.position
        return (*self._frame.to_local(lat_deg, lon_deg), up_m)

    def break_once(self, invariant: str, detail: str) -> None:
        """Note what was broken, the first time."""
        self.broken.setdefault(invariant, f"at {self.ground.now_s:.2f} s: {detail}")

    def note_blow(self, blow: Blow) -> None:
        """Note that a blow strikes now."""
        self.struck.append(Struck(at_s=self.ground.now_s, state=self.state, blow=blow))
        self.coverage[self.state, blow.kind] += 1
