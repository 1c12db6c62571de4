"""What happens in flight and how it is answered: several losses, approval, pauses, returns, drills."""

from collections.abc import Iterator

import pytest
from sqlalchemy import update

from skyfolio import sim
from skyfolio.api.client import ApiError
from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.api.store.tables import operations as operations_table
from skyfolio.planner import EXAMPLES, Pins, Plan
from tests.api.sky import Sky, flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=24, altitude_m=8.0)


@pytest.fixture
def flown() -> Iterator[Sky]:
    """A fleet of its own for each test, ready to take off."""
    with flight(SCENARIO) as made:
        yield made


def steps(flown: Sky, operation_id: str, incident: int) -> list[str]:
    return [entry.step.value for entry in flown.client.journal(operation_id) if entry.incident == incident]


def missions_taken(flown: Sky, system_id: int) -> int:
    taken = [event.detail["mission_id"] for event in flown.fleet.truth.happened("mission_accepted", system_id)]
    assert len(taken) == len(set(taken))
    return len(taken)


def test_two_losses_at_once_leave_one_uav_that_serves_alone(flown: Sky) -> None:
    operation_id = flown.take_off()
    for system_id in (2, 3):
        flown.inject(sim.Kill(system_id))
    ended = flown.ended(operation_id)
    assert ended.lost == ["uav-2", "uav-3"]
    assert ended.recoveries[-1].outcome == "flying"
    assert ended.recoveries[-1].vehicles == {"uav-1": None}
    last = flown.client.read_plan(ended.plan_id)
    assert last.scenario is not None
    assert last.scenario.uav_ids == ("uav-1",)
    assert missions_taken(flown, 1) >= 2
    assert flown.fleet.truth.happened("landed", 1)


def test_a_uav_lost_while_missions_are_swapped_is_answered_next(flown: Sky) -> None:
    operation_id = flown.take_off()

    def fall(entry: Entry, stored: bool) -> None:
        if entry.step is Step.UPLOADING and entry.incident == 1 and stored:
            flown.inject(sim.Kill(2))

    flown.service.journal.listeners.append(fall)
    flown.inject(sim.Kill(3))
    ended = flown.until(operation_id, lambda view: len(view.recoveries) > 1)
    flown.service.journal.listeners.remove(fall)
    assert ended.lost == ["uav-2", "uav-3"]
    assert len(ended.recoveries) >= 2
    assert ended.recoveries[-1].outcome == "flying"
    assert ended.recoveries[-1].vehicles == {"uav-1": None}
    for report in ended.recoveries:
        assert steps(flown, operation_id, report.incident)[-1] == "closed"


def test_with_approval_nothing_is_swapped_until_the_operator_says_so(flown: Sky) -> None:
    operation_id = flown.take_off(replanning="approve")
    flown.inject(sim.Kill(3))
    asked = flown.until(operation_id, lambda view: view.proposal)
    assert asked.proposal is not None
    assert asked.plan_id == flown.plan.id
    assert missions_taken(flown, 1) == 1
    proposed = flown.client.read_plan(asked.proposal.plan_id)
    assert proposed.parent == flown.plan.id
    flown.client.decide(operation_id, asked.proposal.incident, agreed=True)
    with pytest.raises(ApiError, match="409"):
        flown.client.decide(operation_id, asked.proposal.incident, agreed=False)
    answered = flown.until(operation_id, lambda view: view.recoveries)
    assert answered.recoveries[0].outcome == "flying"
    assert steps(flown, operation_id, 1)[:6] == [
        "detected",
        "classified",
        "replanned",
        "checked",
        "proposed",
        "approved",
    ]
    flown.inject(sim.Kill(2))
    again = flown.until(operation_id, lambda view: view.proposal)
    assert again.proposal is not None
    flown.client.decide(operation_id, again.proposal.incident, agreed=False)
    ended = flown.until(operation_id, lambda view: len(view.recoveries) == 2)
    assert [report.outcome for report in ended.recoveries] == ["flying", "declined"]
    assert missions_taken(flown, 1) == 2


def assert_undecided(
    flown: Sky, operation_id: str, incident: int, outcome: str = "unanswered", because: str = "not completed: "
) -> None:
    """The incident is closed once, with what became of it and why, in the journal and in the operation."""
    entries = [entry for entry in flown.client.journal(operation_id) if entry.incident == incident]
    assert [entry.step.value for entry in entries][-2:] == ["proposed", "closed"]
    assert entries[-1].data["outcome"] == outcome
    assert entries[-1].data["error"].startswith(because)
    reports = {report.incident: report for report in flown.client.operation(operation_id).recoveries}
    assert (reports[incident].outcome, reports[incident].error) == (outcome, entries[-1].data["error"])


def test_an_operation_that_is_aborted_while_a_proposal_waits_closes_the_incident(flown: Sky) -> None:
    operation_id = flown.take_off(replanning="approve")
    flown.inject(sim.Kill(3))
    flown.until(operation_id, lambda view: view.proposal)
    ended = flown.client.command(operation_id, "abort", action="land")
    assert (ended.state, ended.proposal) == (State.ABORTED, None)
    assert_undecided(flown, operation_id, 1)


def test_a_proposal_that_nobody_decides_on_ends_when_no_slot_is_left_to_fly_differently() -> None:
    with flight(SCENARIO.with_changes(slots=8)) as flown:
        operation_id = flown.take_off(replanning="approve")
        flown.inject(sim.Kill(3))
        flown.until(operation_id, lambda view: view.proposal)
        assert flown.ended(operation_id).state == State.COMPLETED_PARTLY  # the plan counts on the lost one
        assert_undecided(flown, operation_id, 1, "too_late", "no decision was made while there was still a slot")


def test_a_proposal_that_waited_when_the_service_stopped_is_closed_by_the_next_one(flown: Sky) -> None:
    operation_id = flown.take_off(replanning="approve")
    flown.inject(sim.Kill(3))
    flown.until(operation_id, lambda view: view.proposal)
    flown.stop()
    flown.start()
    asked = flown.until(operation_id, lambda view: view.proposal)
    assert asked.proposal is not None
    assert asked.proposal.incident == 2
    assert steps(flown, operation_id, 1)[-1] == "closed"
    assert [(report.incident, report.outcome) for report in asked.recoveries] == [(1, "interrupted")]
    flown.stop()
    with flown.ground.disk.engine.begin() as database:  # as if it was killed while it aborted
        database.execute(update(operations_table).values(state="aborting"))
    flown.start()
    flown.until(operation_id, lambda view: view.state == State.INTERRUPTED)
    assert_undecided(flown, operation_id, 2)
    flown.client.command(operation_id, "abort", action="land")
    assert steps(flown, operation_id, 2).count("closed") == 1


def test_a_pause_stops_vehicles_and_slot_clock_and_a_stale_tag_is_refused(flown: Sky) -> None:
    operation_id = flown.take_off(launch="auto")
    version = flown.client.operation(operation_id).version
    with pytest.raises(ApiError, match="412"):
        flown.client.command(operation_id, "pause", version=version + 7)
    paused = flown.client.command(operation_id, "pause", version=version)
    assert paused.state == State.PAUSED
    flown.until(operation_id, lambda view: {uav.state for uav in view.uavs.values()} == {"holding"})
    assert flown.client.operation(operation_id).elapsed_s == paused.elapsed_s
    with pytest.raises(ApiError, match="409"):
        flown.client.command(operation_id, "pause")
    resumed = flown.client.command(operation_id, "resume")
    assert resumed.state == State.FLYING
    flown.until(operation_id, lambda view: (view.elapsed_s or 0) > (paused.elapsed_s or 0) + 5)
    assert {uav.state for uav in flown.client.operation(operation_id).uavs.values()} == {"flying"}
    ended = flown.client.command(operation_id, "abort", action="land")
    assert ended.state == State.ABORTED
    assert flown.client.operation(operation_id).state == State.ABORTED
    answer = flown.http.get(f"/v1/operations/{operation_id}", headers={"If-None-Match": tag(ended)})
    assert answer.status_code == 304


def tag(view: OperationView) -> str:
    return f'"{view.id}.{view.version}"'


def test_a_uav_that_comes_back_is_offered_and_flies_again_only_when_asked_to(flown: Sky) -> None:
    operation_id = flown.take_off()
    flown.inject(sim.Mute(3, for_s=20.0))
    flown.until(operation_id, lambda view: view.recoveries)
    with pytest.raises(ApiError, match="409"):
        flown.client.command(operation_id, "readmit", uav_id="uav-3")
    offered = flown.until(operation_id, lambda view: view.returned)
    assert offered.uavs["uav-3"].state == "returned"
    assert offered.lost == ["uav-3"]
    assert missions_taken(flown, 3) == 1
    flown.client.command(operation_id, "readmit", uav_id="uav-3")
    again = flown.until(operation_id, lambda view: len(view.recoveries) == 2)
    assert again.recoveries[1].cause == "uav_returned"
    assert again.recoveries[1].outcome == "flying"
    assert again.lost == []
    assert missions_taken(flown, 3) == 2
    plan = flown.client.read_plan(again.plan_id)
    assert plan.scenario is not None
    assert plan.scenario.uav_ids == SCENARIO.uav_ids


def test_a_uav_seen_falling_is_lost_at_once_with_that_cause(flown: Sky) -> None:
    operation_id = flown.take_off()
    flown.inject(sim.MotorFailure(3))
    answered = flown.until(operation_id, lambda view: view.recoveries)
    report = answered.recoveries[0]
    assert (report.outcome, answered.lost) == ("flying", ["uav-3"])
    assert report.cause == "crashed"
    assert report.lost == {"uav-3": 0.0}  # it was heard all the while
    lost = flown.told(operation_id, "uav_lost")
    assert [(event["uav_id"], event["cause"]) for event in lost] == [("uav-3", report.cause)]
    assert "above home" in lost[0]["detail"]
    assert report.plan_id is not None
    cause = flown.client.read_plan(report.plan_id).cause
    assert (cause.kind, cause.uav_ids) == (report.cause, ("uav-3",))
    assert "above home" in cause.detail


def test_a_uav_that_a_human_took_over_is_planned_around_and_never_commanded_again(flown: Sky) -> None:
    operation_id = flown.take_off()
    flown.inject(sim.LowBattery(1, 0.18))
    flown.inject(sim.ModeChange(3, "POSITION"))
    answered = flown.until(operation_id, lambda view: view.recoveries)
    report = answered.recoveries[0]
    assert (report.cause, report.outcome) == ("human_took_over", "flying")
    assert set(report.vehicles) == {"uav-1", "uav-2"}
    with pytest.raises(ApiError, match="409"):
        flown.client.command(operation_id, "readmit", uav_id="uav-3")
    assert flown.told(operation_id, "ghost_released") == []
    flown.inject(sim.ModeChange(3, "LAND"))
    flown.until(operation_id, lambda _: flown.told(operation_id, "ghost_released"))
    flown.client.command(operation_id, "abort", action="land")
    assert missions_taken(flown, 3) == 1
    modes = [event.detail["mode"] for event in flown.fleet.truth.happened("mode", 3)]
    after = modes[modes.index("POSITION") :]
    assert after[:2] == ["POSITION", "LAND"]
    assert set(after[2:]) <= {"POSITION"}  # PX4 goes back to the pilot's mode once it is disarmed
    conditions = flown.told(operation_id, "condition")
    assert {("uav-1", "low_battery"), ("uav-3", "human_took_over")} <= {
        (event["uav_id"], event["after"]) for event in conditions
    }
    assert "not commanded" in flown.told(operation_id, "uav_lost")[0]["detail"]


def test_a_recovery_keeps_pins_changes_little_and_says_what_it_changed_and_dropped(flown: Sky) -> None:
    pins = Pins(uavs=("uav-3",), associations={"user-1": "uav-1", "user-2": "uav-3"})
    flown.plan = flown.client.plan(SCENARIO, pins=pins)
    operation_id = flown.take_off(disruption_weight=1e6)
    assert flown.client.operation(operation_id).disruption_weight == 1e6
    flown.inject(sim.Kill(3))
    report = flown.until(operation_id, lambda view: view.recoveries).recoveries[0]
    assert report.outcome == "flying"
    assert report.pins is not None
    assert (report.pins.uavs, report.pins.users) == ([], ["user-1"])
    assert {(pin.kind, pin.id, pin.reason) for pin in report.pins.dropped} == {
        ("path", "uav-3", "'uav-3' is lost"),
        ("association", "user-2", "'uav-3' is lost"),
    }
    made = flown.client.read_plan(str(report.plan_id))
    assert isinstance(made, Plan)
    assert set(made.association["user-1"]) == {"uav-1"}
    assert report.disruption == made.disruption
    assert made.disruption is not None
    assert made.disruption.weight_kbps == 1e6
    assert made.disruption.users_changed == 0
    told = next(event["data"] for event in flown.events("recovery") if event["data"]["operation_id"] == operation_id)
    assert told["disruption"]["weight_kbps"] == 1e6
    assert told["pins"]["dropped"][0]["reason"] == "'uav-3' is lost"
    flown.client.command(operation_id, "abort", action="land")


def test_a_drill_on_a_vehicle_of_somebody_else_is_refused(flown: Sky) -> None:
    operation_id = flown.client.fly(flown.plan.id, launch="manual").id
    flown.until(operation_id, lambda view: view.state == State.READY)
    with pytest.raises(ApiError, match="409 uav_id: 'uav-1' is not simulated"):
        flown.client.drill(operation_id, "uav-1")
    assert flown.client.command(operation_id, "abort").state == State.ABORTED
