"""What happens in flight and how it is answered: several losses, approval, pauses, returns, drills."""

import socket
import sqlite3
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio import sim
from skyfolio.api.client import ApiError, Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.operation_views import OperationView, State
from skyfolio.api.http.app import create_app
from skyfolio.planner import EXAMPLES, Pins, Plan
from tests.api.flying import Flight, flight, service, serving
from tests.ports import free_port

pytestmark = [pytest.mark.e2e, pytest.mark.beside]
SCENARIO = EXAMPLES["paper"]().with_changes(slots=24, altitude_m=8.0)
SPEEDUP = 8.0


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[TestClient, str]]:
    with service(SPEEDUP) as made:
        yield made


@pytest.fixture
def flown(served: tuple[TestClient, str]) -> Iterator[Flight]:
    """A fleet of its own for each test, ready to take off."""
    with flight(*served, SCENARIO, SPEEDUP) as made:
        yield made


def steps(flown: Flight, operation_id: str, incident: int) -> list[str]:
    return [entry.step.value for entry in flown.client.journal(operation_id) if entry.incident == incident]


def wait_for(client: Client, operation_id: str, state: State) -> OperationView:
    deadline = time.monotonic() + 90
    while time.monotonic() < deadline:
        view = client.operation(operation_id)
        if view.state == state:
            return view
        assert view.state != State.FAILED, view.error
        time.sleep(0.05)
    raise AssertionError(f"still {view.state}")


def missions_taken(flown: Flight, system_id: int) -> int:
    taken = [event.detail["mission_id"] for event in flown.fleet.fleet.truth.happened("mission_accepted", system_id)]
    assert len(taken) == len(set(taken))
    return len(taken)


def test_two_losses_at_once_leave_one_uav_that_serves_alone(flown: Flight) -> None:
    operation_id = flown.take_off()
    for system_id in (2, 3):
        flown.fleet.inject(sim.Kill(system_id))
    ended = flown.ended(operation_id)
    assert ended.lost == ["uav-2", "uav-3"]
    assert ended.recoveries[-1].outcome == "flying"
    assert ended.recoveries[-1].vehicles == {"uav-1": None}
    last = flown.client.read_plan(ended.plan_id)
    assert last.scenario is not None
    assert last.scenario.uav_ids == ("uav-1",)
    assert missions_taken(flown, 1) >= 2
    assert flown.fleet.fleet.truth.happened("landed", 1)


def test_a_uav_lost_while_missions_are_swapped_is_answered_next(flown: Flight) -> None:
    operation_id = flown.take_off()

    def fall(entry: Entry, stored: bool) -> None:
        if entry.step is Step.UPLOADING and entry.incident == 1 and stored:
            flown.fleet.inject(sim.Kill(2))

    flown.service.journal.listeners.append(fall)
    flown.fleet.inject(sim.Kill(3))
    ended = flown.until(operation_id, lambda view: len(view.recoveries) > 1)
    flown.service.journal.listeners.remove(fall)
    assert ended.lost == ["uav-2", "uav-3"]
    assert len(ended.recoveries) >= 2
    assert ended.recoveries[-1].outcome == "flying"
    assert ended.recoveries[-1].vehicles == {"uav-1": None}
    for report in ended.recoveries:
        assert steps(flown, operation_id, report.incident)[-1] == "closed"


def test_with_approval_nothing_is_swapped_until_the_operator_says_so(flown: Flight) -> None:
    operation_id = flown.take_off(replanning="approve")
    flown.fleet.inject(sim.Kill(3))
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
    flown.fleet.inject(sim.Kill(2))
    again = flown.until(operation_id, lambda view: view.proposal)
    assert again.proposal is not None
    flown.client.decide(operation_id, again.proposal.incident, agreed=False)
    ended = flown.until(operation_id, lambda view: len(view.recoveries) == 2)
    assert [report.outcome for report in ended.recoveries] == ["flying", "declined"]
    assert missions_taken(flown, 1) == 2


def assert_undecided(
    flown: Flight, operation_id: str, incident: int, outcome: str = "unanswered", because: str = "not completed: "
) -> None:
    """The incident is closed once, with what became of it and why, in the journal and in the operation."""
    entries = [entry for entry in flown.client.journal(operation_id) if entry.incident == incident]
    assert [entry.step.value for entry in entries][-2:] == ["proposed", "closed"]
    assert entries[-1].data["outcome"] == outcome
    assert entries[-1].data["error"].startswith(because)
    reports = {report.incident: report for report in flown.client.operation(operation_id).recoveries}
    assert (reports[incident].outcome, reports[incident].error) == (outcome, entries[-1].data["error"])


def test_an_operation_that_is_aborted_while_a_proposal_waits_closes_the_incident(flown: Flight) -> None:
    operation_id = flown.take_off(replanning="approve")
    flown.fleet.inject(sim.Kill(3))
    flown.until(operation_id, lambda view: view.proposal)
    ended = flown.client.command(operation_id, "abort", action="land")
    assert (ended.state, ended.proposal) == (State.ABORTED, None)
    assert_undecided(flown, operation_id, 1)


def test_a_proposal_that_nobody_decides_on_ends_when_no_slot_is_left_to_fly_differently() -> None:
    with service(SPEEDUP) as served, flight(*served, SCENARIO.with_changes(slots=8), SPEEDUP) as flown:
        operation_id = flown.take_off(replanning="approve")
        flown.fleet.inject(sim.Kill(3))
        flown.until(operation_id, lambda view: view.proposal)
        assert flown.ended(operation_id).state == State.COMPLETED_PARTLY  # the plan counts on the lost one
        assert_undecided(flown, operation_id, 1, "too_late", "no decision was made while there was still a slot")


def test_a_proposal_that_waited_when_the_service_stopped_is_closed_by_the_next_one(tmp_path: Path) -> None:
    settings = Settings(
        fleet_url=f"udpin://127.0.0.1:{(port := free_port(socket.SOCK_DGRAM))}",
        database_url=f"sqlite+aiosqlite:///{tmp_path}/service.db",
        time_scale=SPEEDUP,
        heartbeat_stale_s=10.0,  # starting takes a sped-up fleet's seconds
        heartbeat_lost_s=20.0,
    )
    with ExitStack() as stack:
        with serving(settings) as http:
            flown = stack.enter_context(flight(http, f"udpout://127.0.0.1:{port}", SCENARIO, SPEEDUP))
            operation_id = flown.take_off(replanning="approve")
            flown.fleet.inject(sim.Kill(3))
            flown.until(operation_id, lambda view: view.proposal)
        with serving(settings) as http:
            flown.reached_by(http)
            asked = flown.until(operation_id, lambda view: view.proposal)
            assert asked.proposal is not None
            assert asked.proposal.incident == 2
            assert steps(flown, operation_id, 1)[-1] == "closed"
            assert [(report.incident, report.outcome) for report in asked.recoveries] == [(1, "interrupted")]
        with closing(sqlite3.connect(tmp_path / "service.db")) as database:  # as if it was killed while it aborted
            database.execute("UPDATE operations SET state = 'aborting'")
            database.commit()
        with serving(settings) as http:
            flown.reached_by(http)
            flown.until(operation_id, lambda view: view.state == State.INTERRUPTED)
            assert_undecided(flown, operation_id, 2)
            flown.client.command(operation_id, "abort", action="land")
            assert steps(flown, operation_id, 2).count("closed") == 1
            stack.close()  # the fleet ends before the service does


def test_a_pause_stops_vehicles_and_slot_clock_and_a_stale_tag_is_refused(flown: Flight) -> None:
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


def test_a_uav_that_comes_back_is_offered_and_flies_again_only_when_asked_to(flown: Flight) -> None:
    operation_id = flown.take_off()
    flown.fleet.inject(sim.Mute(3, for_s=20.0))
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


def events_of(flown: Flight, operation_id: str, kind: str) -> list[dict[str, Any]]:
    """Data of the events of a kind since this operation was made."""
    found = flown.events()
    first = next(event["id"] for event in found if event["data"].get("operation_id") == operation_id)
    return [event["data"] for event in found if event["kind"] == kind and event["id"] >= first]


def test_a_uav_seen_falling_is_lost_at_once_with_that_cause(flown: Flight) -> None:
    operation_id = flown.take_off()
    flown.fleet.inject(sim.MotorFailure(3))
    answered = flown.until(operation_id, lambda view: view.recoveries)
    report = answered.recoveries[0]
    assert (report.outcome, answered.lost) == ("flying", ["uav-3"])
    assert report.cause in {"crashed", "landed"}  # a fall of 8 m may be over before it is seen
    assert report.lost == {"uav-3": 0.0}  # it was heard all the while
    lost = events_of(flown, operation_id, "uav_lost")
    assert [(event["uav_id"], event["cause"]) for event in lost] == [("uav-3", report.cause)]
    assert "above home" in lost[0]["detail"]
    assert report.plan_id is not None
    cause = flown.client.read_plan(report.plan_id).cause
    assert (cause.kind, cause.uav_ids) == (report.cause, ("uav-3",))
    assert "above home" in cause.detail


def test_a_uav_that_a_human_took_over_is_planned_around_and_never_commanded_again(flown: Flight) -> None:
    operation_id = flown.take_off()
    flown.fleet.inject(sim.LowBattery(1, 0.18))
    flown.fleet.inject(sim.ModeChange(3, "POSITION"))
    answered = flown.until(operation_id, lambda view: view.recoveries)
    report = answered.recoveries[0]
    assert (report.cause, report.outcome) == ("human_took_over", "flying")
    assert set(report.vehicles) == {"uav-1", "uav-2"}
    with pytest.raises(ApiError, match="409"):
        flown.client.command(operation_id, "readmit", uav_id="uav-3")
    assert events_of(flown, operation_id, "ghost_released") == []
    flown.fleet.inject(sim.ModeChange(3, "LAND"))
    flown.until(operation_id, lambda _: events_of(flown, operation_id, "ghost_released"))
    flown.client.command(operation_id, "abort", action="land")
    assert missions_taken(flown, 3) == 1
    modes = [event.detail["mode"] for event in flown.fleet.fleet.truth.happened("mode", 3)]
    after = modes[modes.index("POSITION") :]
    assert after[:2] == ["POSITION", "LAND"]
    assert set(after[2:]) <= {"POSITION"}  # PX4 goes back to the pilot's mode once it is disarmed
    conditions = events_of(flown, operation_id, "condition")
    assert {("uav-1", "low_battery"), ("uav-3", "human_took_over")} <= {
        (event["uav_id"], event["after"]) for event in conditions
    }
    assert "not commanded" in events_of(flown, operation_id, "uav_lost")[0]["detail"]


def test_a_recovery_keeps_pins_changes_little_and_says_what_it_changed_and_dropped(flown: Flight) -> None:
    pins = Pins(uavs=("uav-3",), associations={"user-1": "uav-1", "user-2": "uav-3"})
    flown.plan = flown.client.plan(SCENARIO, pins=pins)
    operation_id = flown.take_off(disruption_weight=1e6)
    assert flown.client.operation(operation_id).disruption_weight == 1e6
    flown.fleet.inject(sim.Kill(3))
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


def test_a_drill_strikes_only_what_the_service_simulates_and_a_plan_made_ahead_answers_it() -> None:
    settings = Settings(simulate="minimal", time_scale=SPEEDUP, plan_ahead=False)
    with TestClient(create_app(settings)) as http:
        client = Client(http=http)
        assert {vehicle.simulated for vehicle in client.vehicles()} == {True}
        plan = client.plan(EXAMPLES["minimal"]().with_changes(slots=14))
        for slot in range(1, 13):
            assert client.contingencies(plan.id, at_slot=slot).complete
        operation = client.fly(plan.id, launch="manual")
        wait_for(client, operation.id, State.READY)
        assert client.drill(operation.id, "uav-2", at_slot=2).state == "scheduled"
        for refused in ({"fault": "earthquake"}, {"at_slot": 99}, {"strength": 9}):
            with pytest.raises(ApiError, match="422"):
                client.drill(operation.id, "uav-2", **refused)
        client.command(operation.id, "start")
        ended = wait_for(client, operation.id, State.COMPLETED)
        assert [report.outcome for report in ended.recoveries] == ["flying"]
        assert ended.recoveries[0].source == "planned_ahead"
        assert http.get("/v1/drills").json()["items"][0]["state"] == "struck"
        track = http.get(f"/v1/operations/{operation.id}/track").json()
        assert len(track) > 50
        with pytest.raises(ApiError, match="409"):
            client.drill(operation.id, "uav-1")


def test_a_drill_on_a_vehicle_of_somebody_else_is_refused(flown: Flight) -> None:
    operation_id = flown.client.fly(flown.plan.id, launch="manual").id
    flown.until(operation_id, lambda view: view.state == State.READY)
    with pytest.raises(ApiError, match="409 uav_id: 'uav-1' is not simulated"):
        flown.client.drill(operation_id, "uav-1")
    assert flown.client.command(operation_id, "abort").state == State.ABORTED
