"""What is seen of one drill: events, journal, blows, and the ground truth, which the service cannot know."""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any
from weakref import WeakSet

from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.losses import LossKind
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import OperationView
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.lab.torture.drill import Blow, Drill
from skyfolio.api.lab.torture.sightings import Gone, LostUav, Noted, Reported, SlotClock, Struck, Taken
from skyfolio.api.lab.virtual.disk import COMMIT_S, FOLDER_PREFIX
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.store.event_log import Event
from skyfolio.planner.geometry import Point
from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.station import Vehicle

LOW_M = 2.0
"""Metres above home; a vehicle that is higher is in the air."""
TAKES_OVER = frozenset({"HOLD", "RETURN", "LAND", "DISARM"})
"""Actions of a failsafe that end the mission."""


REFUSALS = frozenset({"reject_mission", "corrupt_upload"})
"""Faults of vehicles that fly well all the same."""
NOT_IN_THE_AIR = frozenset({"crashed", "landed"})
"""Losses of UAVs that are on the ground, whose air is free."""
SETTLED_S = 15.0
"""Seconds in which a service that was just started waits for its vehicles, and asks them what they fly."""
_WAITS = frozenset({"paused", "link_lost", "interrupted"})
"""States of an operation in which nothing is planned."""


def files_open_now() -> int:
    """Return how many files of virtual disks this process has open: what else it opens meanwhile is no drill's."""
    return sum(FOLDER_PREFIX in _target(link) for link in Path("/proc/self/fd").iterdir())


def _target(link: Path) -> str:
    try:
        return str(link.readlink())
    except OSError:  # closed since it was listed
        return ""


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
    harms: dict[int, set[str]] = field(default_factory=dict)
    """The faults that each vehicle has had."""
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
    known_missions: dict[tuple[int, int, int], AssignedMission] = field(default_factory=dict)
    """Missions on board that were found among the assigned ones, by system id, checksum and items."""
    noted: list[Noted] = field(default_factory=list)
    """Every event whose service lived to announce it."""
    news: list[Noted] = field(default_factory=list)
    """Those since the last look."""
    reports: dict[int, Reported] = field(default_factory=dict)
    """Reports of recoveries, by incident."""
    new_reports: list[Reported] = field(default_factory=list)
    """Those since the last look."""
    gone: dict[int, Gone] = field(default_factory=dict)
    """Vehicles that are dead, or that a human has taken."""
    refusing: set[int] = field(default_factory=set)
    """Vehicles that refuse uploads, or store them wrongly, and fly well all the same."""
    taken: list[Taken] = field(default_factory=list)
    """Every step of the journal that was stored, or held, while its service lived."""
    starts_s: list[float] = field(default_factory=list)
    """When a service was started, virtual seconds."""
    excused_s: float = 0.0
    """Virtual seconds in which something kept the service from dealing with an incident."""
    lost: dict[str, LostUav] = field(default_factory=dict)
    """UAVs whose air is reserved."""
    files_open: list[int] = field(default_factory=list)
    """How many files this process has open: before the drill, and after it."""
    remembered: list[str] = field(default_factory=list)
    """Ended operations that their service still holds."""
    slot_clock: SlotClock | None = None
    """The slot clock at the last look."""
    _operations: WeakSet[Operation] = field(default_factory=WeakSet)
    _impaired_until_s: dict[int, float] = field(default_factory=dict)
    _blind: set[int] = field(default_factory=set)
    _truth_seen: int = 0
    _frame: LocalFrame | None = None

    def note_event(self, event: Event) -> None:
        """Take in an event as its service announces it."""
        noted = Noted(at_s=self.ground.now_s, excused_s=self.excused_s, event=event)
        self.noted.append(noted)
        self.news.append(noted)
        if event.kind == "uav_lost":
            self._lose(event.data["uav_id"], event.data["cause"], event.data["silent_for_s"])
        elif event.kind == "uav_returned" and event.data["uav_id"] in self.lost:
            self.lost[event.data["uav_id"]].stood_m = None

    def note_step(self, entry: Entry) -> None:
        """Take in a step of the journal that was stored, or is held."""
        is_slow = self.ground.disk.commit_s > COMMIT_S
        self.taken.append(Taken(at_s=self.ground.now_s, entry=entry, on_slow_disk=is_slow))

    def note_start(self) -> None:
        """Take in that a service was started."""
        self.starts_s.append(self.ground.now_s)

    def follow_operation(self) -> None:
        """Take in what the service that lives has reported of its operation since the last look."""
        self.new_reports.clear()
        operation = self.operation()
        if operation is not None:
            self._operations.add(operation)
            self.note_reports(operation.incidents.reports)

    def note_reports(self, reports: Iterable[RecoveryReport]) -> None:
        """Take in reports that were not seen before."""
        for report in reports:
            if report.incident not in self.reports:
                one = Reported(at_s=self.ground.now_s, excused_s=self.excused_s, report=report)
                self.reports[report.incident] = one
                self.new_reports.append(one)

    def look_into_memory(self) -> None:
        """Note the ended operations that are still held while their service lives."""
        gc.collect()
        self.remembered = [operation.id for operation in self._operations]

    def excuse(self, seconds: float, *, down: bool) -> None:
        """Excuse these last seconds if the service was down, or could not deal with an incident. down: it is dead."""
        ground = self.ground
        settles = len(self.starts_s) > 1 and ground.now_s < self.starts_s[-1] + SETTLED_S
        broken = ground.workers.dead or ground.disk.refuses is not None or ground.disk.commit_s > COMMIT_S
        if down or settles or broken or self.state in _WAITS or any(map(self._is_cut_off, ground.fleet.vehicles)):
            self.excused_s += seconds

    def operation(self) -> Operation | None:
        """Return the operation as the service that lives holds it; None if it has ended, or no service lives."""
        service = self.ground.service
        return None if service is None else service.operations.active(self.operation_id)

    def is_ours(self, uav: str) -> bool:
        """Return whether nothing has happened to a UAV that takes it from the service."""
        system_id = self.system_of(uav)
        is_well = system_id not in self.harmed or self.harms[system_id] <= REFUSALS
        return is_well and system_id not in self.ordered and uav not in self.lost

    def uav_of(self, system_id: int) -> str:
        """Return which UAV of the scenario a vehicle is."""
        return self.ground.scenario.uav_ids[system_id - 1]

    def system_of(self, uav: str) -> int:
        """Return which vehicle a UAV of the scenario is."""
        return self.ground.scenario.uav_ids.index(uav) + 1

    def is_aloft(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle is really in the air under its own power."""
        return vehicle.alive and vehicle.armed and vehicle.position[2] > LOW_M

    def last_taken(self, step: Step, uav: str, *, until_s: float = inf) -> Taken | None:
        """Return the last such step of a UAV that was taken by then."""
        steps = (one for one in reversed(self.taken) if one.entry.step is step and one.entry.uav_id == uav)
        return next((one for one in steps if one.at_s <= until_s), None)

    def incident(self, number: int, step: Step) -> float | None:
        """Return when an incident took this step first; None if it did not."""
        found = (one.at_s for one in self.taken if one.entry.incident == number and one.entry.step is step)
        return next(found, None)

    def _is_cut_off(self, system_id: int) -> bool:
        """Return whether a vehicle that counts is not heard well, or does not know where it is."""
        vehicle = self.ground.fleet.vehicles[system_id]
        uav = self.uav_of(system_id)
        if uav in self.lost and self.lost[uav].stood_m is not None:
            return False
        if not vehicle.alive:
            return False
        impaired = self.ground.now_s < self._impaired_until_s.get(system_id, 0.0)
        return impaired or system_id in self._blind or not vehicle.transmitting

    def _lose(self, uav: str, kind: LossKind, silent_for_s: float) -> None:
        if kind in NOT_IN_THE_AIR:
            return
        system_id = self.system_of(uav)
        heard_s = self.ground.now_s - silent_for_s
        stood_m = self.place_m(self.ground.fleet.vehicles[system_id])[:2]
        for sample in reversed(self.ground.fleet.truth.samples):
            if sample.t_s <= heard_s and sample.system_id == system_id:
                stood_m = self._local(sample.lat_deg, sample.lon_deg)
                break
        self.lost[uav] = LostUav(uav=uav, system_id=system_id, kind=kind, lost_at_s=self.ground.now_s, stood_m=stood_m)

    def follow_truth(self) -> None:
        """Take in what happened to vehicles since the last look."""
        events = self.ground.fleet.truth.events
        for event in events[self._truth_seen :]:
            system_id = event.system_id
            if event.kind == "fault":
                self.harmed.setdefault(system_id, event.t_s)
                self._follow_fault(system_id, event.t_s, event.detail)
            elif event.kind in {"killed", "crashed"}:
                self._follow_gone(system_id, event.t_s)
            elif event.kind == "failsafe" and event.detail.get("action") in TAKES_OVER:
                self.harmed.setdefault(system_id, event.t_s)
                self.foreign.setdefault(system_id, event.t_s)
            elif event.kind == "disarmed":
                self.foreign.pop(system_id, None)
            elif event.kind == "gps_lost":
                self._blind.add(system_id)
            elif event.kind == "gps_back":
                self._blind.discard(system_id)
        self._truth_seen = len(events)

    def _follow_gone(self, system_id: int, at_s: float) -> None:
        self.gone.setdefault(system_id, Gone(at_s=at_s, excused_s=self.excused_s))

    def _follow_fault(self, system_id: int, at_s: float, fault: dict[str, Any]) -> None:
        self.harms.setdefault(system_id, set()).add(str(fault.get("fault")))
        if fault.get("fault") == "mode_change":
            self.foreign[system_id] = at_s
            self._follow_gone(system_id, at_s)
        elif fault.get("fault") in REFUSALS:
            self.refusing.add(system_id)
        elif fault.get("fault") == "impair":
            self._impaired_until_s[system_id] = inf if fault.get("for_s") is None else at_s + fault["for_s"]

    def place_m(self, vehicle: Vehicle) -> tuple[float, float, float]:
        """Return where a vehicle truly is: metres east and north of the scenario's origin, and above its home."""
        lat_deg, lon_deg, up_m = vehicle.position
        return (*self._local(lat_deg, lon_deg), up_m)

    def _local(self, lat_deg: float, lon_deg: float) -> Point:
        if self._frame is None:
            origin = self.ground.scenario.origin
            self._frame = LocalFrame(origin.lat_deg, origin.lon_deg)
        return self._frame.to_local(lat_deg, lon_deg)

    def break_once(self, invariant: str, detail: str) -> None:
        """Note what was broken, the first time."""
        self.broken.setdefault(invariant, f"at {self.ground.now_s:.2f} s: {detail}")

    def note_blow(self, blow: Blow) -> None:
        """Note that a blow strikes now."""
        self.struck.append(Struck(at_s=self.ground.now_s, state=self.state, blow=blow))
        self.coverage[self.state, blow.kind] += 1
