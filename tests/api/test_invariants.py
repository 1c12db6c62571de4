"""What must hold in drills: silent on a history in which it holds, and heard on one in which it is broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skyfolio.api.flights.allocations import AllocationsView, SlotAllocation, UavAllocation
from skyfolio.api.flights.ends import UavEnd
from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.losses import silent
from skyfolio.api.flights.operation_views import Abort, OperationView, State, UavView
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.lab.torture import missions
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment
from skyfolio.api.lab.torture.invariants import AFTERWARDS, AT_END, MEANWHILE, look
from skyfolio.api.lab.torture.sightings import (
    Gone,
    LostUav,
    Noted,
    Orphans,
    Reported,
    Slipped,
    SlotClock,
    Stored,
    Struck,
    Taken,
)
from skyfolio.api.lab.torture.watch import Seen, files_open_now
from skyfolio.api.lab.virtual.disk import COMMIT_S, Disk
from skyfolio.api.lab.virtual.ground import EPOCH_S
from skyfolio.api.store.event_log import Event
from skyfolio.sim import Mode, truth
from skyfolio.sim.base_station import BaseStation, Served
from skyfolio.sim.geo import LocalFrame

DRILL = Drill(seed=1, stations=True)
SCENARIO = DRILL.scenario()
FRAME = LocalFrame(SCENARIO.origin.lat_deg, SCENARIO.origin.lon_deg)
OPERATION = "operation-1"
INVARIANTS = {**MEANWHILE, **AT_END, **AFTERWARDS}


@dataclass
class Uav:
    """A vehicle as the simulator has it, metres east, north and up."""

    system_id: int
    at_m: tuple[float, float, float]
    mode: Mode = Mode.MISSION
    armed: bool = True
    alive: bool = True
    transmitting: bool = True
    mission_id: int = 1
    item: int = 3
    commands: tuple[int, ...] = (16,)
    base_station: BaseStation = field(default_factory=BaseStation)
    spec: Any = field(default_factory=lambda: SimpleNamespace(autopilot="px4"))

    @property
    def position(self) -> tuple[float, float, float]:
        east, north, up = self.at_m
        return (*FRAME.to_geodetic(east, north), up)

    @property
    def mission(self) -> Any:
        values = dict.fromkeys(("param1", "param2", "param3", "param4", "z"), 0.0)
        whole = {"frame": 6, "current": 0, "autocontinue": 1, "x": 0, "y": 0}
        items = [
            SimpleNamespace(**values, **whole, seq=seq, command=command) for seq, command in enumerate(self.commands)
        ]
        return SimpleNamespace(mission_id=self.mission_id, items=items)


class Truth:
    """What the simulator logs."""

    def __init__(self) -> None:
        self.events: list[Any] = []
        self.samples: list[Any] = []

    def happened(self, kind: str) -> list[Any]:
        return [event for event in self.events if event.kind == kind]


def event(number: int, kind: str, **data: Any) -> Event:
    return Event(id=number, at=datetime.fromtimestamp(EPOCH_S + number, UTC), kind=kind, data=data)


def entry(step: Step, uav: str | None = None, incident: int = 1, **data: Any) -> Entry:
    at = datetime.fromtimestamp(EPOCH_S, UTC)
    return Entry(operation_id=OPERATION, incident=incident, step=step, uav_id=uav, at=at, elapsed_s=20.0, data=data)


def slip(distance_m: float, **changes: Any) -> Slipped:
    """What the keeper of the first UAV has told of slot 9, which begins in the 45th second."""
    told: dict[str, Any] = {
        "system_id": 1,
        "slot": 9,
        "at_s": 89.6,
        "elapsed_s": 45.1,
        "at_m": (100.0, 0.0),
        "mission_id": 1,
    }
    told |= {"start": 1, **changes}
    return Slipped(distance_m=distance_m, **told)


REPORT = RecoveryReport(
    outcome="flying",
    incident=1,
    lost={"uav-3": 5.0},
    declared_at_s=25.0,
    at_slot=6,
    plan_id="plan-2",
    vehicles={"uav-1": None, "uav-2": None},
)
STEPS = (
    (20.0, entry(Step.DETECTED, cause="heartbeat_lost", lost={"uav-3": 5.0})),
    (20.1, entry(Step.REPLANNED, at_slot=6)),
    (20.2, entry(Step.UPLOADING, "uav-1", plan_id="plan-2", attempt=1)),
    (20.2, entry(Step.UPLOADING, "uav-2", plan_id="plan-2", attempt=1)),
    (20.9, entry(Step.VERIFIED, "uav-1")),
    (20.9, entry(Step.VERIFIED, "uav-2")),
    (21.0, entry(Step.CLOSED, outcome="flying")),
)
EVENTS = (
    event(1, "operation", state="uploading", error=None),
    event(2, "operation", state="launching", error=None),
    event(3, "operation", state="starting", error=None),
    event(4, "operation", state="flying", error=None),
    event(19, "uav_lost", uav_id="uav-3", cause="heartbeat_lost", detail="silent", silent_for_s=5.0),
    event(21, "recovery", **REPORT.model_dump(mode="json")),
    event(70, "operation", state="landing", error=None),
    event(80, "operation", state="completed", error=None, ends={"uav-1": "flown"}),
)
"""Their numbers are their seconds, until they are numbered in order below."""


def history() -> Seen:
    """A flight in which the third UAV was lost and all went well, seen as the second report comes in."""
    fleet = SimpleNamespace(vehicles={n: Uav(n, (100.0 * n, 0.0, 10.0)) for n in (1, 2)}, truth=Truth())
    fleet.vehicles[3] = Uav(3, (300.0, 0.0, 0.0), mode=Mode.HOLD, armed=False, alive=False)
    flight = SimpleNamespace(
        lost={"uav-3": 15.0},
        elapsed_s=lambda: 45.0,
        paused=False,
        guidance=SimpleNamespace(airspace=SimpleNamespace(ghosts={"uav-3": object()})),
        roster=SimpleNamespace(losses={"uav-3": silent(5.0)}),
        slot=lambda: 9,
        plan=SimpleNamespace(id="plan-2"),
    )
    radio = SimpleNamespace(shown=allocated({"uav-1": {"user-1": 1e4}, "uav-2": {"user-2": 1e4}, "uav-3": {}}))
    radio.allocations = SimpleNamespace(view=lambda: radio.shown)
    operation = SimpleNamespace(flight=flight, radio=radio, state=State.FLYING)
    ground = SimpleNamespace(
        scenario=SCENARIO,
        fleet=fleet,
        service=SimpleNamespace(operations=SimpleNamespace(active=lambda _id: operation)),
        now_s=90.0,
        alive_tasks=[],
        clock_ahead_s=0.0,
        disk=SimpleNamespace(refuses=None, commit_s=COMMIT_S, denied=[]),
        workers=SimpleNamespace(dead=False),
    )
    seen = Seen(DRILL, ground, operation_id=OPERATION, state="flying")  # type: ignore[arg-type]
    seen.noted = [
        Noted(at_s=float(one.id), excused_s=0.0, event=one.model_copy(update={"id": number}))
        for number, one in enumerate(EVENTS, start=1)
    ]
    seen.events = [noted.event for noted in seen.noted]
    seen.taken = [Taken(at_s=at_s, entry=step) for at_s, step in STEPS]
    seen.journal = [one.entry for one in seen.taken]
    seen.starts_s = [0.0]
    one = Reported(at_s=21.5, excused_s=0.0, report=REPORT)
    seen.reports, seen.new_reports = {1: one}, [one]
    seen.lost = {
        "uav-3": LostUav(uav="uav-3", system_id=3, kind="heartbeat_lost", lost_at_s=19.0, stood_m=(300.0, 0.0))
    }
    seen.harmed, seen.harms = {3: 14.0}, {3: {"kill"}}
    seen.gone = {3: Gone(at_s=14.0, excused_s=0.0)}
    seen.known_missions = {
        (n, 1, 1): assigned(path_m=[(100.0 * n + 2.0 * slot, 0.0) for slot in range(4)]) for n in (1, 2, 3)
    }
    seen.received = [(20.5, 1, message("MISSION_COUNT", mission_type=0, count=5))]
    seen.slips, seen.new_slips = [slip(5.0)], [slip(5.0)]
    seen.silences = [("uav-3", 19.0, 5.0)]
    seen.cursors = {1: (1, 2)}
    seen.files_open = [10, 10]
    seen.slot_clock = SlotClock(at_s=89.5, elapsed_s=44.5, paused=False)
    seen.end = view()
    seen.known_lost, seen.plan_id = {"uav-3"}, "plan-2"
    return seen


def allocated(bands: dict[str, dict[str, float]]) -> AllocationsView:
    """What each UAV is to serve in slot 9."""
    uavs = {
        uav: UavAllocation(
            now=SlotAllocation(slot=9, valid_from_s=45.0, valid_until_s=50.0, bandwidth_hz=band), next=None
        )
        for uav, band in bands.items()
    }
    return AllocationsView(
        operation_id=OPERATION, revision=12, plan_id="plan-2", elapsed_s=45.0, paused=False, uavs=uavs
    )


def serve(seen: Seen, uav: str, band: dict[str, float]) -> None:
    """Let the base station of a UAV serve some users."""
    station = seen.ground.fleet.vehicles[seen.system_of(uav)].base_station
    station.hear(1, [Served(0.0, 1e6, band)], 0.0)
    station.acknowledge(1)


def assigned(**changes: Any) -> Any:
    """An assigned mission from slot 6 on."""
    return SimpleNamespace(**{"first_slot": 6, "altitude_m": 10.0, "slot_s": 5.0, "path_m": [], **changes})


def message(name: str, **fields: Any) -> Any:
    return SimpleNamespace(get_type=lambda: name, **fields)


def view(state: State = State.COMPLETED, **changes: Any) -> OperationView:
    ends = {"uav-1": "flown", "uav-2": "flown", "uav-3": "lost"}
    documents = {
        "uavs": {uav: UavView(system_id=n, state="flying", end=end) for n, (uav, end) in enumerate(ends.items(), 1)},
        "vehicles": {uav: n for n, uav in enumerate(ends, 1)},
        "recoveries": [REPORT],
        "plan_ids": ["plan-1", "plan-2"],
        "lost": ["uav-3"],
        **changes,
    }
    return OperationView.model_construct(id=OPERATION, state=state, **documents)


def broken_in(seen: Seen, *, meanwhile: bool) -> set[str]:
    """What is broken; the vehicles are on the ground when all is over."""
    if not meanwhile:
        for vehicle in [vehicle for one in seen.each for vehicle in one.ground.fleet.vehicles.values()]:
            if vehicle.mode is Mode.MISSION and vehicle.system_id in (1, 2):
                vehicle.armed, vehicle.at_m = False, (*vehicle.at_m[:2], 0.0)  # type: ignore[attr-defined,misc]
    look(seen, MEANWHILE if meanwhile else AT_END | AFTERWARDS)
    return set(seen.broken)


def test_a_flight_in_which_all_went_well_breaks_nothing() -> None:
    assert broken_in(history(), meanwhile=True) == set()
    assert broken_in(history(), meanwhile=False) == set()


# -- one thing is wrong ------------------------------------------------------------------------------------------------

DOCTORS: dict[str, Callable[[Seen], None]] = {}


def breaks(name: str) -> Callable[[Callable[[Seen], None]], Callable[[Seen], None]]:
    """Say which invariant a change of the history breaks."""

    def keep(doctor: Callable[[Seen], None]) -> Callable[[Seen], None]:
        DOCTORS[name] = doctor
        return doctor

    return keep


def vehicle_of(seen: Seen, number: int) -> Any:
    return seen.ground.fleet.vehicles[number]


def strike(seen: Seen, kind: str) -> None:
    blow = Blow(when=Moment(), kind=kind)
    seen.struck.append(Struck(at_s=1.0, state="flying", blow=blow))


def policy(seen: Seen, name: str) -> None:
    seen.drill = seen.drill.model_copy(update={"policy": name})


def happens(seen: Seen, kind: str, system_id: int) -> None:
    happened: Any = SimpleNamespace(kind=kind, system_id=system_id, t_s=30.0)
    seen.ground.fleet.truth.events.append(happened)


@breaks("separation")
def _two_too_near(seen: Seen) -> None:
    vehicle_of(seen, 2).at_m = (101.0, 0.0, 10.0)


@breaks("whole missions")
def _a_hybrid(seen: Seen) -> None:
    vehicle_of(seen, 1).mission_id = 99


@breaks("nobody begins a mission that is not proven")
def _begins_what_a_bad_upload_left(seen: Seen) -> None:
    seen.harmed[1], seen.harms[1] = 20.0, {"corrupt_upload"}
    seen.begun.append((89.8, 1, Stored(mission_id=99, items=vehicle_of(seen, 1).mission.items)))


@breaks("nobody commands a vehicle that a human or a failsafe flies")
def _a_human_overruled(seen: Seen) -> None:
    seen.foreign[2] = 10.0
    seen.received.append((30.0, 2, message("COMMAND_LONG", command=176)))


@breaks("missions are sent after the journal has them")
def _sent_before_it_is_written(seen: Seen) -> None:
    seen.received.append((19.5, 2, message("MISSION_COUNT", mission_type=0, count=5)))


@breaks("who is said to fly a new plan does")
def _hovers_instead(seen: Seen) -> None:
    vehicle_of(seen, 1).mode = Mode.HOLD


@breaks("separation from reserved air")
def _where_the_lost_one_was(seen: Seen) -> None:
    vehicle_of(seen, 1).at_m = (301.0, 1.0, 10.0)


@breaks("air is freed when nobody is in it")
def _freed_in_flight(seen: Seen) -> None:
    seen.ground.fleet.vehicles[3] = Uav(3, (300.0, 0.0, 10.0), mode=Mode.HOLD)  # type: ignore[assignment]
    seen.news.append(Noted(at_s=40.0, excused_s=0.0, event=event(9, "ghost_released", uav_id="uav-3")))


@breaks("air is reserved for who is lost")
def _reserved_for_one_that_counts(seen: Seen) -> None:
    operation = seen.operation()
    assert operation is not None
    operation.flight.guidance.airspace.ghosts["uav-1"] = object()  # type: ignore[index]


@breaks("every operation ends")
def _never_ends(seen: Seen) -> None:
    seen.end = view(State.LANDING)


@breaks("states follow each other")
def _flies_after_its_end(seen: Seen) -> None:
    seen.events.append(event(9, "operation", state="flying", error=None))


@breaks("the slot clock keeps time")
def _begun_anew(seen: Seen) -> None:
    seen.slot_clock = SlotClock(at_s=85.0, elapsed_s=30.0, paused=False)


@breaks("ends are as they are said to be")
def _crashed_and_said_to_have_flown(seen: Seen) -> None:
    vehicle_of(seen, 2).alive = False


@breaks("event ids have no gaps")
def _a_gap(seen: Seen) -> None:
    seen.events[-1] = seen.events[-1].model_copy(update={"id": 20})
    seen.noted[-1] = replace(seen.noted[-1], event=seen.events[-1])


@breaks("events are announced once in order")
def _announced_again(seen: Seen) -> None:
    seen.noted.append(seen.noted[2])


@breaks("events are stored as they were announced")
def _another_under_its_number(seen: Seen) -> None:
    seen.events[-1] = event(seen.events[-1].id, "operation", state="completed", error="another")


@breaks("nothing is denied by the database")
def _a_number_given_twice(seen: Seen) -> None:
    seen.ground.disk.denied.append("UNIQUE constraint failed: events.id")


@breaks("steps outlive the service")
def _a_step_is_gone(seen: Seen) -> None:
    seen.taken.append(Taken(at_s=22.0, entry=entry(Step.FLYING)))


@breaks("nothing is left in the local file")
def _held_for_ever(seen: Seen) -> None:
    seen.held_lines = 3


@breaks("nothing fails unforeseen")
def _a_task_failed(seen: Seen) -> None:
    seen.events.append(event(9, "task_failed", task="watch", error="KeyError: 3"))


@breaks("no task is left")
def _a_task_is_left(seen: Seen) -> None:
    seen.ground.alive_tasks.append("keep-uav-1")


@breaks("no operation is left in memory")
def _an_operation_is_left(seen: Seen) -> None:
    seen.remembered = [OPERATION]


@breaks("no file is left open")
def _a_file_is_left(seen: Seen) -> None:
    seen.files_open = [10, 11]


def _heard_just_before(seen: Seen) -> None:
    seen.silences.append(("uav-3", 19.0, 0.2))


def _told_too_early(seen: Seen) -> None:
    seen.new_slips.append(slip(5.0, elapsed_s=30.0))


def _a_slot_clock_that_runs_in_a_pause(seen: Seen) -> None:
    seen.operation().state = State.PAUSED  # type: ignore[union-attr]
    seen.slot_clock = SlotClock(at_s=89.5, elapsed_s=44.5, paused=True)


def _sent_to_one_that_was_lost_again(seen: Seen) -> None:
    readmitted_before_it_is_sent_to(seen)
    lost = seen.noted[4]
    seen.noted.insert(-2, replace(lost, at_s=32.0))
    for step in (entry(Step.REPLANNED, incident=3), entry(Step.UPLOADING, "uav-3", incident=3)):
        seen.taken.append(Taken(at_s=33.0, entry=step))


def _a_stranger_is_read_back_late(seen: Seen) -> None:
    _a_hybrid(seen)
    seen.harms[1] = {"corrupt_upload"}
    seen.strange_since_s = {1: 70.0}


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("nobody healthy is lost", _heard_just_before),
        ("slips are told as they are", _told_too_early),
        ("the slot clock keeps time", _a_slot_clock_that_runs_in_a_pause),
        ("nothing is sent to who is lost", _sent_to_one_that_was_lost_again),
        ("whole missions", _a_stranger_is_read_back_late),
    ],
    ids=lambda change: getattr(change, "__name__", ""),
)
def test_an_invariant_is_heard_in_another_way(
    name: str, change: Callable[[Seen], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(missions, "_assigned", lambda _seen, _uav: [])
    seen = history()
    change(seen)
    assert name in broken_in(seen, meanwhile=name in MEANWHILE)


@breaks("nobody healthy is lost")
def _lost_in_the_best_of_health(seen: Seen) -> None:
    seen.harmed.clear()


@breaks("no human is seen where none is")
def _a_mission_ends_and_looks_like_a_human(seen: Seen) -> None:
    said = event(60, "condition", uav_id="uav-1", before="live", after="human_took_over", cause="in mode 'return'")
    seen.noted.insert(-2, Noted(at_s=69.0, excused_s=0.0, event=said))


@breaks("who is gone is declared lost")
def _nobody_noticed(seen: Seen) -> None:
    seen.gone[2] = Gone(at_s=40.0, excused_s=0.0)


@breaks("every incident is closed once")
def _closed_again(seen: Seen) -> None:
    seen.journal.append(entry(Step.CLOSED))


@breaks("every incident is reported")
def _not_reported(seen: Seen) -> None:
    seen.journal += [entry(Step.DETECTED, incident=2), entry(Step.CLOSED, incident=2)]


@breaks("every loss is dealt with once")
def _dealt_with_again(seen: Seen) -> None:
    seen.reports[2] = replace(seen.reports[1], report=REPORT.model_copy(update={"incident": 2}))


@breaks("survivors are on a plan soon after a verdict")
def _nothing_was_done(seen: Seen) -> None:
    seen.reports.clear()


@breaks("nothing is flown that the operator has not approved")
def _not_approved(seen: Seen) -> None:
    policy(seen, "approve")


@breaks("nothing is sent to who is lost")
def _sent_to_the_lost_one(seen: Seen) -> None:
    seen.taken.append(Taken(at_s=20.3, entry=entry(Step.UPLOADING, "uav-3")))


@breaks("nothing is sent twice")
def _sent_twice(seen: Seen) -> None:
    seen.journal.append(entry(Step.UPLOADING, "uav-1", plan_id="plan-2", attempt=1))


@breaks("nothing is sent again after a restart")
def _sent_again(seen: Seen) -> None:
    seen.starts_s.append(20.15)


@breaks("nothing is broken off once it is sent")
def _broken_off(seen: Seen) -> None:
    seen.reports[1] = replace(seen.reports[1], report=REPORT.model_copy(update={"outcome": "superseded"}))


@breaks("the plan that is flown is in force")
def _the_old_plan_in_force(seen: Seen) -> None:
    seen.end = view(plan_ids=["plan-1"])


@breaks("nobody healthy crashes")
def _a_crash(seen: Seen) -> None:
    happens(seen, "crashed", 1)


@breaks("nothing fails to which nothing happened")
def _a_failure_without_a_cause(seen: Seen) -> None:
    assert seen.end is not None
    seen.struck.clear()
    seen.end = seen.end.model_copy(update={"state": State.FAILED, "error": "upload failed"})


@breaks("who flew to the end is on the ground")
def _left_in_the_air(seen: Seen) -> None:
    vehicle_of(seen, 1).mode = Mode.HOLD


@breaks("vehicles are left as they were ordered")
def _flies_on_after_an_order_to_land(seen: Seen) -> None:
    seen.end = view(State.ABORTED, abort=Abort(action="land", vehicles={"uav-1": None}))
    vehicle_of(seen, 1).mode = Mode.RTL


@breaks("the air of who is lost is reserved")
def _not_reserved(seen: Seen) -> None:
    operation = seen.operation()
    assert operation is not None
    operation.flight.guidance.airspace.ghosts.clear()  # type: ignore[attr-defined]


@breaks("what is flown counts after a restart")
def _flown_and_interrupted(seen: Seen) -> None:
    interrupted = REPORT.model_copy(update={"outcome": "interrupted"})
    seen.new_reports = [replace(seen.new_reports[0], report=interrupted)]


@breaks("missions keep out of reserved air")
def _through_the_air_of_the_lost_one(seen: Seen) -> None:
    seen.known_missions[1, 1, 1].path_m[:] = [(100.0, 0.0), (320.0, 0.0)]


@breaks("an operation ends once")
def _ends_again(seen: Seen) -> None:
    seen.noted.append(replace(seen.noted[-1], at_s=85.0))


@breaks("plans begin with a slot that is not flown yet")
def _a_slot_too_early(seen: Seen) -> None:
    seen.journal.append(entry(Step.REPLANNED, at_slot=3))


@breaks("plans are awaited")
def _asked_too_soon(seen: Seen) -> None:
    seen.journal.append(entry(Step.REFUSED, error="plan 'plan-2' is running and has no result to use"))


@breaks("slips are told as they are")
def _by_another_mission(seen: Seen) -> None:
    seen.new_slips.append(slip(25.0))


@breaks("the slip of a slot is told once")
def _told_twice(seen: Seen) -> None:
    seen.slips.append(slip(5.0))


@breaks("nobody flies an item again")
def _back_to_the_first_item(seen: Seen) -> None:
    vehicle_of(seen, 1).item = 1


@breaks("who is ordered away obeys")
def _flies_its_mission_all_the_same(seen: Seen) -> None:
    seen.sent_away["uav-2"] = (80.0, "land")


@breaks("a base station serves only what was acknowledged")
def _(seen: Seen) -> None:
    seen.accepted["uav-1"] = [{"user-1": 1e4}]
    serve(seen, "uav-1", {"user-1": 1e4, "user-2": 1e4})


@breaks("a revision keeps what it allocates")
def _(seen: Seen) -> None:
    seen.allocated["uav-1", 12] = {9: {"user-3": 1e4}}


@breaks("no user is served twice for long")
def _(seen: Seen) -> None:
    for uav in ("uav-1", "uav-2"):
        seen.accepted[uav] = [{"user-1": 1e4}]
        serve(seen, uav, {"user-1": 1e4})
    seen.served_twice_s["user-1"] = 75.0


@breaks("a lost uav is allocated no user")
def _(seen: Seen) -> None:
    operation: Any = seen.operation()
    operation.radio.shown = allocated({"uav-1": {}, "uav-2": {}, "uav-3": {"user-3": 1e4}})
    seen.allocated_lost["uav-3"] = 80.0


@breaks("users of a lost uav are allocated to others")
def _(seen: Seen) -> None:
    seen.orphans = Orphans(users={"user-2", "user-3"}, plan_id="plan-2", since_s=80.0)


@breaks("revisions of allocations only grow")
def _(seen: Seen) -> None:
    seen.events += [event(81, "allocations", operation_id=OPERATION, revision=revision) for revision in (7, 1000, 8)]


@pytest.mark.parametrize("name", sorted(INVARIANTS))
def test_each_invariant_is_heard_where_it_is_broken(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(missions, "_assigned", lambda _seen, _uav: [])
    seen = history()
    DOCTORS[name](seen)
    assert name in broken_in(seen, meanwhile=name in MEANWHILE)


# -- two operations at once ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(INVARIANTS))
def test_each_invariant_is_heard_where_the_operation_beside_breaks_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(missions, "_assigned", lambda _seen, _uav: [])
    seen, beside = history(), history()
    seen.beside, beside.broken, beside.told = beside, seen.broken, seen.told
    DOCTORS[name](beside)
    assert name in broken_in(seen, meanwhile=name in MEANWHILE)


def test_what_another_operation_does_is_not_held_against_this_one() -> None:
    seen = history()
    others = [
        event(9, "operation", operation_id="operation-2", state="failed", error="KeyError: 3"),
        event(10, "uav_lost", operation_id="operation-2", uav_id="uav-1", cause="crashed", detail="", silent_for_s=0.0),
    ]
    for other in others:
        seen.note_event(other)
    step = entry(Step.UPLOADING, "uav-3", incident=7).model_copy(update={"operation_id": "operation-2"})
    seen.note_step(step)
    assert (seen.state, seen.news, len(seen.taken)) == ("flying", [], len(STEPS))
    assert seen.lost.keys() == {"uav-3"}
    assert len(seen.own_noted) == len(EVENTS)


def test_a_vehicle_of_another_operation_may_be_left_in_the_air() -> None:
    seen = history()
    seen.uavs = ("uav-2", "uav-3")
    assert seen.end is not None
    seen.end = view(uavs={uav: one for uav, one in seen.end.uavs.items() if uav in seen.uavs})
    _left_in_the_air(seen)
    assert broken_in(seen, meanwhile=False) == set()


@pytest.mark.parametrize("end", ["home", "rally point", "end of its mission"])
def test_air_is_reserved_on_each_way_on_which_a_lost_uav_may_land(end: str) -> None:
    seen, home_m = history(), SCENARIO.uav("uav-3").start_m
    lost = seen.lost["uav-3"]
    rally_m = (500.0, 0.0)
    if end == "rally point":
        seen.ground.scenario = SCENARIO.with_changes(rally_points=[{"position_m": rally_m}])
    elif end == "end of its mission":
        lost.end_m = (500.0, 0.0)
    start_m, end_m = {
        "home": (lost.stood_m, home_m),
        "rally point": (lost.stood_m, rally_m),
        "end of its mission": (lost.end_m, home_m),
    }[end]
    assert start_m is not None
    way_m = [(start_m[0] + share * (end_m[0] - start_m[0]), share * end_m[1]) for share in (0.4, 0.5)]
    seen.known_missions[1, 1, 1] = assigned(path_m=way_m)
    vehicle_of(seen, 1).at_m = (*way_m[1], 10.0)
    seen.new_slips.clear()
    reserved = {"missions keep out of reserved air", "separation from reserved air"}
    assert broken_in(seen, meanwhile=True) == reserved


@pytest.mark.parametrize(("back_to", "again"), [(5, set()), (4, {"nobody flies an item again"})])
def test_only_who_flies_to_a_place_again_flies_an_item_again(back_to: int, again: set[str]) -> None:
    seen = history()
    vehicle = vehicle_of(seen, 1)
    vehicle.commands, vehicle.item = (16, 178, 16, 178, 16, 178, 16), back_to
    seen.known_missions[1, 1, 7] = seen.known_missions[1, 1, 1]
    seen.cursors = {1: (1, 6)}
    assert broken_in(seen, meanwhile=True) == again


@pytest.mark.parametrize(
    ("heard_s", "armed", "held"),
    [([], True, False), ([9.9], True, False), ([10.2], True, True), ([10.75], True, False), ([10.2], False, False)],
    ids=["never", "before", "meanwhile", "as the order is followed", "before it is launched"],
)
def test_a_human_counts_whose_mode_was_heard_in_flight_before_our_order_left(
    heard_s: list[float], armed: bool, held: bool
) -> None:
    seen = history()
    seen.ground.heartbeats_s = lambda system_id: heard_s if system_id == 2 else []  # type: ignore[method-assign]
    fault = {"fault": "mode_change", "mode": "POSITION"}
    seen.ground.fleet.truth.events += [
        *([truth.Event(2.0, 2, "armed")] if armed else []),
        truth.Event(10.0, 2, "fault", fault),
        truth.Event(10.0, 2, "mode", {"mode": "POSITION"}),
        truth.Event(10.8, 2, "mode", {"mode": "MISSION"}),
    ]
    seen.follow_truth()
    assert (2 in seen.gone, 2 in seen.foreign) == (held, held)


# -- what is no fault --------------------------------------------------------------------------------------------------


def excused(seen: Seen) -> None:
    seen.reports.clear()
    seen.noted[-2:] = [replace(noted, excused_s=60.0) for noted in seen.noted[-2:]]


def lost_after_the_last_slot(seen: Seen) -> None:
    seen.reports.clear()
    late = (0, 1, 2, 3, 6, 4, 7)
    seen.noted = [replace(seen.noted[place], at_s=40.0 * number) for number, place in enumerate(late)]
    seen.noted = [
        replace(noted, event=noted.event.model_copy(update={"id": number}))
        for number, noted in enumerate(seen.noted, start=1)
    ]
    seen.events = [noted.event for noted in seen.noted]
    seen.gone.clear()


def superseded(seen: Seen) -> None:
    first = REPORT.model_copy(update={"outcome": "superseded"})
    again = Reported(at_s=30.0, excused_s=0.0, report=REPORT.model_copy(update={"incident": 2}))
    seen.reports = {1: replace(seen.reports[1], report=first), 2: again}
    seen.taken = [one for one in seen.taken if one.entry.step is not Step.UPLOADING]
    seen.received = []


def flies_above(seen: Seen) -> None:
    _where_the_lost_one_was(seen)
    _through_the_air_of_the_lost_one(seen)
    seen.known_missions[1, 1, 1] = assigned(altitude_m=15.0)


def on_its_first_leg(seen: Seen) -> None:
    _where_the_lost_one_was(seen)
    seen.operation().flight.elapsed_s = lambda: 36.0  # type: ignore[union-attr,method-assign]
    seen.slot_clock = None


def sent_before_the_loss(seen: Seen) -> None:
    _where_the_lost_one_was(seen)
    seen.lost["uav-3"].lost_at_s = 40.0


def on_a_disk_that_stayed_full(seen: Seen) -> None:
    seen.held_lines, seen.ground.disk.refuses = 3, "database or disk is full"


def said_to_be_down(seen: Seen) -> None:
    assert seen.end is not None
    seen.end.uavs["uav-3"] = seen.end.uavs["uav-3"].model_copy(update={"end": UavEnd.RETURNED})


def fell_unheard_where_it_may_have_landed(seen: Seen) -> None:
    seen.fell_unheard.add(3)
    said_to_be_down(seen)


def fell_as_a_clock_that_lies_restarted(seen: Seen) -> None:
    seen.harms[3] = {"reboot", "clock_jump"}
    said_to_be_down(seen)


def dealt_with_before_a_full_disk_let_it_be_announced(seen: Seen) -> None:
    seen.noted[4] = replace(seen.noted[4], at_s=69.0)
    seen.gone.clear()


def ordered_by_the_operator(seen: Seen) -> None:
    seen.harmed.clear()
    seen.ordered[3] = 10.0


def told_by_the_service_before(seen: Seen) -> None:
    seen.slips.append(slip(5.0, start=2))


@pytest.mark.parametrize(
    "change",
    [
        told_by_the_service_before,
        excused,
        lost_after_the_last_slot,
        superseded,
        flies_above,
        on_its_first_leg,
        sent_before_the_loss,
        ordered_by_the_operator,
        on_a_disk_that_stayed_full,
        fell_unheard_where_it_may_have_landed,
        fell_as_a_clock_that_lies_restarted,
        dealt_with_before_a_full_disk_let_it_be_announced,
    ],
    ids=lambda change: change.__name__,
)
def test_what_is_no_fault_breaks_nothing(change: Callable[[Seen], None]) -> None:
    for meanwhile in (True, False):
        seen = history()
        change(seen)
        seen.new_reports.clear()
        assert broken_in(seen, meanwhile=meanwhile) == set()


def test_who_fell_unheard_in_a_mode_that_does_not_land_has_not_landed() -> None:
    seen = history()
    fell_unheard_where_it_may_have_landed(seen)
    seen.ground.fleet.vehicles[3].mode = Mode.MISSION  # type: ignore[misc]
    assert broken_in(seen, meanwhile=False) == {"ends are as they are said to be"}


def readmitted_before_it_is_sent_to(seen: Seen) -> None:
    blow = Blow(when=Moment(), kind="readmit", options={"uav": "uav-3"})
    seen.struck.append(Struck(at_s=30.0, state="flying", blow=blow))
    for at_s, step in (
        (30.1, entry(Step.DETECTED, incident=2, cause="uav_returned")),
        (30.2, entry(Step.REPLANNED, incident=2)),
        (30.3, entry(Step.UPLOADING, "uav-3", incident=2)),
    ):
        seen.taken.append(Taken(at_s=at_s, entry=step))


def obeyed(seen: Seen) -> None:
    seen.sent_away["uav-2"] = (80.0, "hold")
    vehicle_of(seen, 2).mode = Mode.HOLD


def ordered_once_more(seen: Seen) -> None:
    seen.sent_away["uav-2"] = (80.0, "land")
    seen.ordered[2] = 82.0


def flies_a_new_mission_from_its_beginning(seen: Seen) -> None:
    seen.cursors[1] = (2, 7)


def told_while_a_mission_was_sent(seen: Seen) -> None:
    _by_another_mission(seen)
    seen.taken.append(Taken(at_s=89.0, entry=entry(Step.UPLOADING, "uav-1", incident=2)))


def sent_the_next_plan_already(seen: Seen) -> None:
    vehicle_of(seen, 1).mode = Mode.HOLD
    seen.taken.append(Taken(at_s=89.0, entry=entry(Step.UPLOADING, "uav-1", incident=2)))


def aborted_again(seen: Seen) -> None:
    _ends_again(seen)
    blow = Blow(when=Moment(), kind="abort", options={"actions": ["land"]})
    seen.struck.append(Struck(at_s=82.0, state="completed", blow=blow))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("nothing is sent to who is lost", readmitted_before_it_is_sent_to),
        ("who is ordered away obeys", obeyed),
        ("who is ordered away obeys", ordered_once_more),
        ("nobody flies an item again", flies_a_new_mission_from_its_beginning),
        ("an operation ends once", aborted_again),
        ("who is said to fly a new plan does", sent_the_next_plan_already),
        ("slips are told as they are", told_while_a_mission_was_sent),
    ],
    ids=lambda change: getattr(change, "__name__", ""),
)
def test_an_invariant_is_not_held_against_what_it_does_not_mean(name: str, change: Callable[[Seen], None]) -> None:
    seen = history()
    change(seen)
    assert name not in broken_in(seen, meanwhile=name in MEANWHILE)


def test_only_open_files_of_a_virtual_disk_are_counted(tmp_path: Path) -> None:
    disk, before = Disk(), files_open_now()
    with (tmp_path / "another").open("w"):
        assert files_open_now() == before
    with (disk.folder / "left").open("w"):
        assert files_open_now() == before + 1
    disk.close()
    assert files_open_now() == before


def test_a_vehicle_begins_an_assigned_mission_whatever_it_has_stored_since() -> None:
    seen = history()
    seen.ground.fleet.truth.events += [
        truth.Event(t_s, 1, kind, detail)
        for t_s, kind, detail in (
            (88.0, "mission_accepted", {"mission_id": 1, "items": vehicle_of(seen, 1).mission.items}),
            (89.0, "mode", {"mode": "MISSION"}),
            (89.1, "mission_accepted", {"mission_id": 99, "items": vehicle_of(seen, 1).mission.items}),
        )
    ]
    seen.follow_truth()
    assert [(at_s, system_id, stored.mission_id) for at_s, system_id, stored in seen.begun] == [(89.0, 1, 1)]
    assert broken_in(seen, meanwhile=True) == set()


def test_a_human_may_be_seen_after_a_fault_an_order_or_a_restart() -> None:
    for excuse in ("harmed", "ordered", "starts_s"):
        seen = history()
        DOCTORS["no human is seen where none is"](seen)
        if excuse == "starts_s":
            seen.starts_s.append(60.0)
        else:
            getattr(seen, excuse)[1] = 60.0
        assert "no human is seen where none is" not in broken_in(seen, meanwhile=False)
