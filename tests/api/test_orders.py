"""Orders to vehicles in flight: with one operation, with two, and with none; who is told, and who is left alone."""

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest
from fastapi.testclient import TestClient

from skyfolio import sim
from skyfolio.api.client import ApiError
from skyfolio.api.flights.ends import UavEnd
from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES
from tests.api.flying import FleetThread, Flight, flight, gone, service

pytestmark = [pytest.mark.e2e, pytest.mark.beside]
SPEEDUP = 8.0
PATIENT = {"heartbeat_stale_s": 6.0, "heartbeat_lost_s": 10.0, "rate_burst": 10_000}
MINIMAL = EXAMPLES["minimal"]()
SCENARIO = EXAMPLES["paper"]().with_changes(slots=40, altitude_m=8.0)
LONG = MINIMAL.with_changes(slots=40, altitude_m=8.0)


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[TestClient, str]]:
    with service(SPEEDUP, **PATIENT) as made:
        yield made


@pytest.fixture
def flown(served: tuple[TestClient, str]) -> Iterator[Sky]:
    with flight(*served, SCENARIO, SPEEDUP) as made:
        yield made


def modes(fleet: FleetThread, system_id: int) -> list[str]:
    return [event.detail["mode"] for event in fleet.fleet.truth.happened("mode", system_id)]


@contextmanager
def two_operations(served: tuple[TestClient, str]) -> Iterator[tuple[Flight, list[str]]]:
    """One fleet of two, each flying an operation of its own."""
    http, endpoint = served
    fleet = FleetThread(LONG, endpoint, SPEEDUP)
    try:
        flown = Flight(http, fleet, LONG)
        plans = [flown.client.plan(LONG.with_changes(uavs=(uav,))).id for uav in LONG.uavs]
        operations = [flown.client.fly(plan_id).id for plan_id in plans]
        for operation_id in operations:
            flown.until(operation_id, lambda view: view.state == State.FLYING)
        yield flown, operations
    finally:
        fleet.stop()
    gone(flown.client, fleet)


def test_hold_and_land_reach_the_vehicles_of_every_operation_and_of_those_that_are_over(
    served: tuple[TestClient, str],
) -> None:
    with two_operations(served) as (flown, operations):
        held = flown.client.order("hold")
        assert [(one.uav_id, one.outcome, one.operation_id) for one in held] == [
            ("uav-1", "ok", operations[0]),
            ("uav-2", "ok", operations[1]),
        ]
        for operation_id in operations:
            view = flown.client.operation(operation_id)
            assert view.state == State.ABORTED
            assert view.abort is not None
            assert (view.abort.action, set(view.abort.vehicles.values())) == ("hold", {None})
            assert {one.end for one in view.uavs.values()} == {UavEnd.IN_THE_AIR}
        landed = flown.client.order("land")  # nothing flies an operation any more
        assert [(one.outcome, one.operation_id) for one in landed] == [("ok", None), ("ok", None)]
        for system_id in (1, 2):
            assert modes(flown.fleet, system_id)[-2:] == ["HOLD", "LAND"]
        flown.wait(lambda: not any(vehicle.armed for vehicle in flown.client.vehicles()))
        assert {one.reason for one in flown.client.order("return")} == {"it is on the ground"}


def test_one_vehicle_of_several_leaves_its_operation_and_the_others_get_a_new_plan(flown: Sky) -> None:
    operation_id = flown.take_off()
    (given,) = flown.client.order("return", ["uav-3"])
    assert (given.outcome, given.operation_id) == ("ok", operation_id)
    answered = flown.until(operation_id, lambda view: view.recoveries)
    assert answered.lost == ["uav-3"]
    assert [(one.cause, one.outcome) for one in answered.recoveries] == [("ordered", "flying")]
    assert set(answered.recoveries[0].vehicles) == {"uav-1", "uav-2"}
    assert modes(flown.fleet, 3)[-1] == "RTL"
    assert flown.client.operation(operation_id).state == State.FLYING
    assert [one.outcome for one in flown.client.order("land", ["uav-1", "uav-2"])] == ["ok", "ok"]
    assert flown.client.operation(operation_id).state == State.ABORTED  # with the last that it had
    assert modes(flown.fleet, 3)[-1] == "RTL"


def test_an_order_while_missions_are_swapped_is_not_undone_by_the_swap(flown: Sky) -> None:
    operation_id = flown.take_off()
    flown.inject(sim.MotorFailure(3))
    flown.wait(lambda: any(entry.step is Step.UPLOADING for entry in flown.client.journal(operation_id)))
    assert flown.client.order("hold", ["uav-1"])[0].outcome == "ok"
    view = flown.until(operation_id, lambda view: len(view.recoveries) == 2)
    assert set(view.lost) == {"uav-1", "uav-3"}
    assert set(view.recoveries[1].vehicles) == {"uav-2"}
    assert modes(flown.fleet, 1)[-1] == "HOLD"
    assert modes(flown.fleet, 2)[-1] == "MISSION"
    flown.client.order("land")


def test_a_human_is_never_overruled_by_hold_and_by_land_only_with_force(flown: Sky) -> None:
    operation_id = flown.take_off(replanning="off")
    flown.inject(sim.ModeChange(3, "POSITION"))
    flown.wait(lambda: flown.client.vehicles()[2].mode == "position")
    given = {one.uav_id: one for one in flown.client.order("hold")}
    assert given["uav-3"].outcome == "left_alone"
    assert "somebody else flies it" in (given["uav-3"].reason or "")
    assert {given["uav-1"].outcome, given["uav-2"].outcome} == {"ok"}
    assert flown.client.order("land", ["uav-3"])[0].outcome == "left_alone"
    assert modes(flown.fleet, 3)[-1] == "POSITION"
    assert flown.client.order("land", ["uav-3"], force=True)[0].outcome == "ok"
    assert modes(flown.fleet, 3)[-1] == "LAND"
    flown.until(operation_id, lambda view: view.state in {State.ABORTED, State.COMPLETED_PARTLY})


def test_an_order_during_the_climb_ends_the_launch_and_nobody_is_sent_on(flown: Sky) -> None:
    operation_id = flown.client.fly(flown.plan.id).id
    flown.wait(lambda: flown.fleet.vehicles[1].position[2] > 4.0)
    assert {one.outcome for one in flown.client.order("land")} == {"ok"}
    assert flown.client.operation(operation_id).state == State.ABORTED
    for system_id in (1, 2, 3):
        assert set(modes(flown.fleet, system_id)[-2:]) <= {"TAKEOFF", "LAND", "HOLD"}  # HOLD: it has landed
        assert "LAND" in modes(flown.fleet, system_id)
    flown.wait(lambda: not any(vehicle.armed for vehicle in flown.client.vehicles()))
    assert not any("MISSION" in modes(flown.fleet, system_id) for system_id in (1, 2, 3))


def test_one_that_is_ordered_down_during_the_climb_ends_it_for_all(flown: Sky) -> None:
    operation_id = flown.client.fly(flown.plan.id).id
    flown.wait(lambda: flown.fleet.vehicles[1].position[2] > 4.0)
    flown.client.order("land", ["uav-1"])
    view = flown.client.operation(operation_id)
    assert view.state == State.ABORTED
    assert "land was ordered for uav-1" in (view.error or "")
    flown.let_pass(8.0)
    assert {modes(flown.fleet, system_id)[-1] for system_id in (2, 3)} <= {"HOLD", "LAND"}
    flown.client.order("land")


def test_fifty_aborts_at_once_are_one_and_another_action_is_carried_out_after_the_end(flown: Sky) -> None:
    operation_id = flown.take_off()
    path = f"/v1/operations/{operation_id}:abort"

    def abort(action: str) -> int:
        return flown.http.post(path, json={"action": action}).status_code

    with ThreadPoolExecutor(50) as pool:
        assert Counter(pool.map(abort, ["hold"] * 50)) == {200: 50}
    held = flown.client.operation(operation_id)
    assert (held.state, held.error) == (State.ABORTED, None)
    assert all(modes(flown.fleet, system_id).count("HOLD") <= 2 for system_id in (1, 2, 3))  # of the climb, and this
    assert flown.client.command(operation_id, "abort", action="hold").version == held.version
    landing = flown.client.command(operation_id, "abort", action="land")
    assert landing.abort is not None
    assert (landing.abort.action, landing.abort.error) == ("land", None)
    assert landing.version == held.version + 1
    flown.wait(lambda: not any(vehicle.armed for vehicle in flown.client.vehicles()))


def test_of_aborts_that_contradict_each_other_none_breaks_and_all_vehicles_obey_one(flown: Sky) -> None:
    operation_id = flown.take_off()

    def abort(number: int) -> int:
        body = {"action": ("hold", "land", "return")[number % 3]}
        return flown.http.post(f"/v1/operations/{operation_id}:abort", json=body).status_code

    with ThreadPoolExecutor(50) as pool:
        assert Counter(pool.map(abort, range(50))) == {200: 50}
    view = flown.client.operation(operation_id)
    assert view.state == State.ABORTED
    assert view.abort is not None
    last = {"hold": "HOLD", "land": "LAND", "return": "RTL"}[view.abort.action]
    assert {modes(flown.fleet, system_id)[-1] for system_id in (1, 2, 3)} == {last}
    flown.client.order("land")


def test_a_pause_that_waits_behind_a_retire_finds_the_abort_and_holds_nobody(flown: Sky) -> None:
    operation_id = flown.take_off()

    def command(verb: str) -> int:
        body = {"retire": {"uav_id": "uav-1"}, "abort": {"action": "return"}}.get(verb)
        return flown.http.post(f"/v1/operations/{operation_id}:{verb}", json=body).status_code

    with ThreadPoolExecutor(8) as pool:
        waiting = [pool.submit(command, verb) for verb in ("retire", "pause", "pause", "resume")]
        ended = pool.submit(command, "abort").result()
        statuses = {one.result() for one in waiting}
    assert ended == 200
    assert statuses <= {200, 409, 502}
    flown.let_pass(4.0)
    assert {modes(flown.fleet, system_id)[-1] for system_id in (1, 2, 3)} == {"RTL"}


def test_an_order_to_a_vehicle_that_does_not_exist_is_refused_before_anybody_is_told(flown: Sky) -> None:
    operation_id = flown.take_off()
    with pytest.raises(ApiError, match="404"):
        flown.client.order("land", ["uav-1", "uav-9"])
    assert flown.client.operation(operation_id).state == State.FLYING
