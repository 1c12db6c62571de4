"""Orders to vehicles in flight: with one operation, with two, and with none; who is told, and who is left alone."""

import asyncio
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import httpx2
import pytest

from skyfolio import sim
from skyfolio.api.client import ApiError
from skyfolio.api.flights.ends import UavEnd
from skyfolio.api.flights.journal import Entry, Step
from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES
from tests.api.sky import Ask, Sky, flight

MINIMAL = EXAMPLES["minimal"]()
SCENARIO = EXAMPLES["paper"]().with_changes(slots=40, altitude_m=8.0)
LONG = MINIMAL.with_changes(slots=40, altitude_m=8.0)


@pytest.fixture
def flown() -> Iterator[Sky]:
    with flight(SCENARIO) as made:
        yield made


def modes(flown: Sky, system_id: int) -> list[str]:
    return [event.detail["mode"] for event in flown.fleet.truth.happened("mode", system_id)]


@contextmanager
def two_operations() -> Iterator[tuple[Sky, list[str]]]:
    """One fleet of two, each flying an operation of its own."""
    with flight(LONG) as flown:
        plans = [flown.client.plan(LONG.with_changes(uavs=(uav,))).id for uav in LONG.uavs]
        operations = [flown.client.fly(plan_id).id for plan_id in plans]
        for operation_id in operations:
            flown.until(operation_id, lambda view: view.state == State.FLYING)
        yield flown, operations


def test_hold_and_land_reach_the_vehicles_of_every_operation_and_of_those_that_are_over() -> None:
    with two_operations() as (flown, operations):
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
            assert modes(flown, system_id)[-2:] == ["HOLD", "LAND"]
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
    assert modes(flown, 3)[-1] == "RTL"
    assert flown.client.operation(operation_id).state == State.FLYING
    assert [one.outcome for one in flown.client.order("land", ["uav-1", "uav-2"])] == ["ok", "ok"]
    assert flown.client.operation(operation_id).state == State.ABORTED  # with the last that it had
    assert modes(flown, 3)[-1] == "RTL"


def test_an_order_while_missions_are_swapped_is_not_undone_by_the_swap(flown: Sky) -> None:
    operation_id = flown.take_off()
    order = flown.http.build_request("POST", "/v1/fleet:hold", json={"uav_ids": ["uav-1"]})
    ordered: list[asyncio.Task[httpx2.Response]] = []

    def hold(entry: Entry, stored: bool) -> None:
        if entry.step is Step.UPLOADING and stored and not ordered:
            ordered.append(flown.ground.spawn(flown.carry(order)))

    flown.service.journal.listeners.append(hold)
    flown.inject(sim.MotorFailure(3))
    flown.wait(lambda: ordered and ordered[0].done())
    assert ordered[0].result().json()[0]["outcome"] == "ok"
    view = flown.until(operation_id, lambda view: len(view.recoveries) == 2)
    assert set(view.lost) == {"uav-1", "uav-3"}
    assert set(view.recoveries[1].vehicles) == {"uav-2"}
    assert modes(flown, 1)[-1] == "HOLD"
    assert modes(flown, 2)[-1] == "MISSION"
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
    assert modes(flown, 3)[-1] == "POSITION"
    assert flown.client.order("land", ["uav-3"], force=True)[0].outcome == "ok"
    assert modes(flown, 3)[-1] == "LAND"
    flown.until(operation_id, lambda view: view.state in {State.ABORTED, State.COMPLETED_PARTLY})


def test_an_order_during_the_climb_ends_the_launch_and_nobody_is_sent_on(flown: Sky) -> None:
    operation_id = flown.client.fly(flown.plan.id).id
    flown.wait(lambda: flown.fleet.vehicles[1].position[2] > 4.0)
    assert {one.outcome for one in flown.client.order("land")} == {"ok"}
    assert flown.client.operation(operation_id).state == State.ABORTED
    for system_id in (1, 2, 3):
        assert set(modes(flown, system_id)[-2:]) <= {"TAKEOFF", "LAND", "HOLD"}  # HOLD: it has landed
        assert "LAND" in modes(flown, system_id)
    flown.wait(lambda: not any(vehicle.armed for vehicle in flown.client.vehicles()))
    assert not any("MISSION" in modes(flown, system_id) for system_id in (1, 2, 3))


def test_one_that_is_ordered_down_during_the_climb_ends_it_for_all(flown: Sky) -> None:
    operation_id = flown.client.fly(flown.plan.id).id
    flown.wait(lambda: flown.fleet.vehicles[1].position[2] > 4.0)
    flown.client.order("land", ["uav-1"])
    view = flown.client.operation(operation_id)
    assert view.state == State.ABORTED
    assert "land was ordered for uav-1" in (view.error or "")
    flown.let_pass(8.0)
    assert {modes(flown, system_id)[-1] for system_id in (2, 3)} <= {"HOLD", "LAND"}
    flown.client.order("land")


def test_fifty_aborts_at_once_are_one_and_another_action_is_carried_out_after_the_end(flown: Sky) -> None:
    operation_id = flown.take_off()
    path = f"/v1/operations/{operation_id}:abort"

    answers = flown.at_once([Ask("POST", path, json={"action": "hold"})] * 50)
    assert Counter(answer.status_code for answer in answers) == {200: 50}
    held = flown.client.operation(operation_id)
    assert (held.state, held.error) == (State.ABORTED, None)
    assert all(modes(flown, system_id).count("HOLD") <= 2 for system_id in (1, 2, 3))  # of the climb, and this
    assert flown.client.command(operation_id, "abort", action="hold").version == held.version
    landing = flown.client.command(operation_id, "abort", action="land")
    assert landing.abort is not None
    assert (landing.abort.action, landing.abort.error) == ("land", None)
    assert landing.version == held.version + 1
    flown.wait(lambda: not any(vehicle.armed for vehicle in flown.client.vehicles()))


def test_of_aborts_that_contradict_each_other_none_breaks_and_all_vehicles_obey_one(flown: Sky) -> None:
    operation_id = flown.take_off()
    actions = [("hold", "land", "return")[number % 3] for number in range(50)]
    path = f"/v1/operations/{operation_id}:abort"
    answers = flown.at_once([Ask("POST", path, json={"action": action}) for action in actions])
    assert Counter(answer.status_code for answer in answers) == {200: 50}
    view = flown.client.operation(operation_id)
    assert view.state == State.ABORTED
    assert view.abort is not None
    last = {"hold": "HOLD", "land": "LAND", "return": "RTL"}[view.abort.action]
    assert {modes(flown, system_id)[-1] for system_id in (1, 2, 3)} == {last}
    flown.client.order("land")


def test_a_pause_that_waits_behind_a_retire_finds_the_abort_and_holds_nobody(flown: Sky) -> None:
    operation_id = flown.take_off()

    bodies = {"retire": {"uav_id": "uav-1"}, "abort": {"action": "return"}}
    verbs = ("retire", "pause", "pause", "resume", "abort")
    answers = flown.at_once(
        [Ask("POST", f"/v1/operations/{operation_id}:{verb}", json=bodies.get(verb)) for verb in verbs]
    )
    *statuses, ended = [answer.status_code for answer in answers]
    assert ended == 200
    assert set(statuses) <= {200, 409, 502}
    flown.let_pass(4.0)
    assert {modes(flown, system_id)[-1] for system_id in (1, 2, 3)} == {"RTL"}


def test_an_order_to_a_vehicle_that_does_not_exist_is_refused_before_anybody_is_told(flown: Sky) -> None:
    operation_id = flown.take_off()
    with pytest.raises(ApiError, match="404"):
        flown.client.order("land", ["uav-1", "uav-9"])
    assert flown.client.operation(operation_id).state == State.FLYING
