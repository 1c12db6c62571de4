"""Vehicles whose batteries are changed between two flights: nobody is lost, all is asked again, and they fly again."""

from __future__ import annotations

import pytest

from skyfolio import sim
from skyfolio.api.flights.operation_views import State
from skyfolio.planner import EXAMPLES
from tests.api.sky import Sky, flight

SCENARIO = EXAMPLES["paper"]().with_changes(slots=8, altitude_m=8.0)
CREW = sim.GroundCrew(members=3, turnaround_s=40.0)
QUICK = sim.GroundCrew(members=3, turnaround_s=10.0, off_s=3.0)
"""A crew whose vehicles are off for so short that no link is lost."""
PARAMETER_READS = ("PARAM_REQUEST_READ", "PARAM_REQUEST_LIST")


def swapped(flown: Sky) -> float:
    """Let time pass until every vehicle has another battery; the fleet second in which the last one is switched on."""
    crew, vehicles = flown.fleet.crew, flown.fleet.vehicles
    assert crew is not None
    flown.wait(lambda: len(flown.fleet.truth.happened("swapped")) == len(vehicles), "all have another battery")
    return flown.now_s


def asked(flown: Sky, since_s: float, *names: str) -> set[int]:
    """Vehicles that were sent one of these messages since then."""
    messages = flown.fleet.truth.messages
    return {one.system_id for one in messages if one.direction == "in" and one.name in names and one.t_s > since_s}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("crew", [CREW, QUICK], ids=["slow", "quick"])
def test_the_same_vehicles_fly_a_second_operation_on_other_batteries(autopilot: str, crew: sim.GroundCrew) -> None:
    with flight(SCENARIO, autopilots=[autopilot], crew=crew) as flown:
        first = flown.ended(flown.take_off(at_end="return"))
        assert (first.state, first.error, first.lost) == (State.COMPLETED, None, [])
        low = {view.uav_id: view.battery_percent for view in flown.client.vehicles()}
        on_s = swapped(flown)
        second_id = flown.take_off(at_end="return")
        high = {view.uav_id: view.battery_percent for view in flown.client.vehicles()}
        assert all((high[uav] or 0.0) > (low[uav] or 0.0) for uav in low)
        assert asked(flown, on_s, *PARAMETER_READS) == set(flown.fleet.vehicles)
        second = flown.ended(second_id)
        assert (second.state, second.error, second.lost) == (State.COMPLETED, None, [])
        assert {uav.end for uav in second.uavs.values()} == {"flown"}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_an_operation_that_begins_while_vehicles_boot_waits_for_a_new_home(autopilot: str) -> None:
    with flight(SCENARIO, autopilots=[autopilot], crew=CREW) as flown:
        flown.ended(flown.take_off(at_end="return"))
        flown.wait(lambda: all(vehicle.is_off for vehicle in flown.fleet.vehicles.values()))
        flown.wait(lambda: not any(vehicle.is_off for vehicle in flown.fleet.vehicles.values()))
        operation_id = flown.take_off(at_end="return")
        missing = [fact for one in flown.told(operation_id, "waiting_for_facts") for fact in one["missing"]]
        assert "home position" in missing
        assert not flown.ended(operation_id).lost


def test_a_vehicle_that_is_sent_home_is_given_a_battery_while_the_others_fly_on() -> None:
    scenario = SCENARIO.with_changes(slots=40)
    with flight(scenario, crew=CREW) as flown:
        operation_id = flown.take_off(at_end="return")
        flown.client.command(operation_id, "retire", uav_id="uav-3")
        flown.wait(lambda: flown.fleet.truth.happened("swapped", 3), "it has another battery")
        flown.let_pass(20.0)
        view = flown.client.operation(operation_id)
        assert view.state == State.FLYING
        assert view.lost == ["uav-3"]
        end = flown.ended(operation_id)
        assert (end.state, end.error, end.uavs["uav-3"].end) == (State.COMPLETED, None, "returned")
