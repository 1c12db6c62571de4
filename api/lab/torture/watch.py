"""What is seen of one drill: of each operation its events, journal and reports, and the blows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any
from weakref import WeakSet

from skyfolio.api.flights.allocations import AllocationsView
from skyfolio.api.flights.assigned_missions import AssignedMission
from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.losses import LossKind
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_views import OperationView
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.lab.torture.drill import Blow
from skyfolio.api.lab.torture.sightings import LostUav, Noted, Orphans, Reported, Slipped, SlotClock, Struck, Taken
from skyfolio.api.lab.torture.vehicles import REFUSALS, Vehicles
from skyfolio.api.lab.virtual.disk import COMMIT_S, FOLDER_PREFIX
from skyfolio.api.store.event_log import Event

NOT_IN_THE_AIR = frozenset({"crashed", "landed"})
"""Losses of UAVs that are on the ground, whose air is free."""
SETTLED_S = 15.0
"""Seconds in which a service that was just started waits for its vehicles, and asks them what they fly."""
HEARD_WITHIN_S = 3.0
"""What a vehicle sends as it falls has arrived within so many seconds, and been believed: HEARTBEATs come at 1 Hz."""
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
class Seen(Vehicles):
    """What was seen so far of one operation. `end`, `events` and `journal` are there once the drill is over.

    What tells of the fleet or the service as a whole is seen for each operation as well.
    """

    operation_id: str = ""
    beside: Seen | None = None
    """What is seen of the operation that is flown beside it, if there is one."""
    struck: list[Struck] = field(default_factory=list)
    state: str = "none"
    coverage: Counter[tuple[str, str]] = field(default_factory=Counter)
    moments: Counter[tuple[str, str]] = field(default_factory=Counter)
    """How often each blow struck at each kind of moment."""
    received: list[tuple[float, int, Any]] = field(default_factory=list)
    """Messages that vehicles received since the last look: virtual second, system id, message."""
    broken: dict[str, str] = field(default_factory=dict)
    """What was broken, by invariant, as it was seen first."""
    told: list[str] = field(default_factory=list)
    """What happened, in order: events, steps of the journal, vehicles' news, blows, and what they broke."""
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
    taken: list[Taken] = field(default_factory=list)
    """Every step of the journal that was stored, or held, while its service lived."""
    starts_s: list[float] = field(default_factory=list)
    """When a service was started, virtual seconds."""
    lost: dict[str, LostUav] = field(default_factory=dict)
    """UAVs whose air is reserved."""
    files_open: list[int] = field(default_factory=list)
    """How many files this process has open: before the drill, and after it."""
    seen_crashed: set[int] = field(default_factory=set)
    """Vehicles of which a service has said that they crashed."""
    held_lines: int = 0
    """Transactions in the local file once the service has stopped."""
    remembered: list[str] = field(default_factory=list)
    """Ended operations that their service still holds."""
    slot_clock: SlotClock | None = None
    """The slot clock at the last look."""
    slips: list[Slipped] = field(default_factory=list)
    new_slips: list[Slipped] = field(default_factory=list)
    """Those since the last look."""
    silences: list[tuple[str, float, float]] = field(default_factory=list)
    """UAVs that were declared lost because they are silent, when, and how long they really were, in seconds."""
    sent_away: dict[str, tuple[float, str]] = field(default_factory=dict)
    """UAVs that the operator has just ordered away from this operation: when, and to what."""
    cursors: dict[int, tuple[int, int]] = field(default_factory=dict)
    """What each vehicle flew at the last look: the id of its mission, and the item."""
    strange_since_s: dict[int, float] = field(default_factory=dict)
    """Since when vehicles fly what was not assigned to them."""
    allocated: dict[tuple[str, int], dict[int, dict[str, float]]] = field(default_factory=dict)
    """What each UAV was seen to be allocated, by UAV and revision: Hz by slot and user."""
    accepted: dict[str, list[dict[str, float]]] = field(default_factory=dict)
    """What the base station of each UAV has acknowledged of that: Hz by user."""
    allocation: AllocationsView | None = None
    """What all were allocated at the last look."""
    plan_id: str = ""
    """Which plan was in force then."""
    allocated_lost: dict[str, float] = field(default_factory=dict)
    """Since when lost UAVs are allocated users, virtual seconds that are not excused."""
    served_twice_s: dict[str, float] = field(default_factory=dict)
    """Since when users are served by two base stations."""
    known_lost: set[str] = field(default_factory=set)
    """UAVs whose users are looked after."""
    orphans: Orphans | None = None
    """Users of lost UAVs that no other serves yet."""
    _operations: WeakSet[Operation] = field(default_factory=WeakSet)

    def beside_it(self, uavs: Sequence[str]) -> Seen:
        """Return what is seen of an operation that other UAVs fly at the same time, from now on.

        Orders, blows, messages, files, and what is broken are noted in one place for both.
        """
        self.beside = Seen(
            self.drill,
            self.ground,
            uavs=uavs,
            struck=self.struck,
            ordered=self.ordered,
            received=self.received,
            broken=self.broken,
            told=self.told,
            files_open=self.files_open,
            starts_s=[*self.starts_s],
        )
        return self.beside

    @property
    def each(self) -> list[Seen]:
        """Return what is seen of each operation, this one first."""
        return [self] if self.beside is None else [self, self.beside]

    def is_own(self, event: Event) -> bool:
        """Return whether an event tells of this operation, or of one of its UAVs, or of the service as a whole."""
        of, uav = event.data.get("operation_id", self.operation_id), event.data.get("uav_id")
        return of == self.operation_id and (uav is None or uav in self.uavs)

    @property
    def own_noted(self) -> list[Noted]:
        """Return the announced events that tell of this operation."""
        return [noted for noted in self.noted if self.is_own(noted.event)]

    def tell(self, what: str) -> None:
        """Add a line to the steps of this drill."""
        self.told.append(f"{self.ground.now_s:9.2f} s  {what}")

    def note_event(self, event: Event) -> None:
        """Take in an event as its service announces it."""
        noted = Noted(at_s=self.ground.now_s, excused_s=self.excused_s, event=event)
        self.noted.append(noted)
        if not self.is_own(event):
            return
        self.news.append(noted)
        if event.kind == "operation":
            self.state = event.data["state"]
        elif event.kind == "uav_lost":
            self._lose(event.data["uav_id"], event.data["cause"], event.data["silent_for_s"])
            self._note_loss(event.data["uav_id"], event.data["cause"], event.data["detail"])
        elif event.kind == "slip":
            self._note_slip(event.data)
        elif event.kind == "uav_returned" and event.data["uav_id"] in self.lost:
            self.lost[event.data["uav_id"]].stood_m = None
        elif event.kind == "condition" and event.data["after"] == "crashed":
            self.seen_crashed.add(self.system_of(event.data["uav_id"]))

    def note_step(self, entry: Entry) -> None:
        """Take in a step of the journal that was stored, or is held, if it is one of this operation."""
        if entry.operation_id == self.operation_id:
            self.taken.append(Taken(at_s=self.ground.now_s, entry=entry))

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
        """Note the ended operations that are still held while their service lives, after garbage was collected."""
        self.remembered = [operation.id for operation in self._operations]

    def follow_truth(self) -> None:
        """Take in what happened to vehicles since the last look, and who fell about when a service was dead.

        A service that has just been started has received nothing yet; one that is killed soon receives nothing more.
        """
        super().follow_truth()
        for system_id, at_s in self.fell_at_s.items():
            dies_soon = self.ground.service is None and self.ground.now_s <= at_s + HEARD_WITHIN_S
            if dies_soon or any(abs(start_s - at_s) <= HEARD_WITHIN_S for start_s in self.starts_s[1:]):
                self.fell_unheard.add(system_id)

    def excuse(self, seconds: float, *, down: bool) -> None:
        """Excuse these last seconds if the service was down, or could not deal with an incident. down: it is dead.

        It cannot without its disk, which has to have each step first, nor without workers that plan; it waits for its
        vehicles once it was started, for its operator in a pause, and for a vehicle that may soon be heard again.
        """
        ground = self.ground
        settles = len(self.starts_s) > 1 and ground.now_s < self.starts_s[-1] + SETTLED_S
        broken = ground.workers.dead or ground.disk.refuses is not None or ground.disk.commit_s > COMMIT_S
        if down or settles or broken or self.state in _WAITS or any(map(self._is_cut_off, self.uavs)):
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

    def last_taken(self, step: Step, uav: str, *, until_s: float = inf) -> Taken | None:
        """Return the last such step of a UAV that was taken by then."""
        steps = (one for one in reversed(self.taken) if one.entry.step is step and one.entry.uav_id == uav)
        return next((one for one in steps if one.at_s <= until_s), None)

    def incident(self, number: int, step: Step) -> float | None:
        """Return when an incident took this step first; None if it did not."""
        found = (one.at_s for one in self.taken if one.entry.incident == number and one.entry.step is step)
        return next(found, None)

    def _is_cut_off(self, uav: str) -> bool:
        """Return whether a vehicle that counts is not heard well, or does not know where it is."""
        system_id = self.system_of(uav)
        vehicle = self.ground.fleet.vehicles[system_id]
        if uav in self.lost and self.lost[uav].stood_m is not None:
            return False
        return vehicle.alive and not self.is_heard_well(system_id)

    def _lose(self, uav: str, kind: LossKind, silent_for_s: float) -> None:
        if kind in NOT_IN_THE_AIR:
            return
        system_id = self.system_of(uav)
        heard_s = self.ground.now_s - silent_for_s
        stood_m = self.place_m(self.ground.fleet.vehicles[system_id])[:2]
        for sample in reversed(self.ground.fleet.truth.samples):
            if sample.t_s <= heard_s and sample.system_id == system_id:
                stood_m = self.place_of(sample.lat_deg, sample.lon_deg)
                break
        self.lost[uav] = LostUav(
            uav=uav,
            system_id=system_id,
            kind=kind,
            lost_at_s=self.ground.now_s,
            stood_m=stood_m,
            end_m=self.end_of_mission_m(self.ground.fleet.vehicles[system_id]),
        )

    def _note_loss(self, uav: str, kind: LossKind, detail: str) -> None:
        ground, works = self.ground, self.ground.disk.refuses is None and self.ground.disk.commit_s <= COMMIT_S
        if kind == "heartbeat_lost" and works:
            self.silences.append((uav, ground.now_s, ground.now_s - ground.heard_s(self.system_of(uav))))
        elif kind == "ordered":
            self.sent_away[uav] = ground.now_s, detail.removeprefix("ordered to ")

    def _note_slip(self, told: Mapping[str, Any]) -> None:
        operation = self.operation()
        elapsed_s = None if operation is None else operation.flight.elapsed_s()
        if elapsed_s is None:
            return
        system_id = self.system_of(told["uav_id"])
        vehicle = self.ground.fleet.vehicles[system_id]
        slip = Slipped(
            system_id=system_id,
            slot=told["slot"],
            distance_m=told["distance_m"],
            at_s=self.ground.now_s,
            elapsed_s=elapsed_s,
            at_m=self.place_m(vehicle)[:2],
            mission_id=vehicle.mission.mission_id,
            start=len(self.starts_s),
        )
        self.slips.append(slip)
        self.new_slips.append(slip)

    def break_once(self, invariant: str, detail: str) -> None:
        """Note what was broken, the first time."""
        if invariant not in self.broken:
            self.tell(f"BROKEN  {invariant}: {detail}")
        self.broken.setdefault(invariant, f"at {self.ground.now_s:.2f} s: {detail}")

    def note_blow(self, blow: Blow) -> None:
        """Note that a blow strikes now."""
        self.tell(f"STRIKE  {blow} (operation {self.state})")
        self.struck.append(Struck(at_s=self.ground.now_s, state=self.state, blow=blow))
        self.coverage[self.state, blow.kind] += 1
        self.moments[blow.when.where, blow.kind] += 1
