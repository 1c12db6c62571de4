"""Vehicles over hills: they stand on the ground, land on it, and crash into it; heights are told in both datums."""

from __future__ import annotations

from typing import Any

import pytest

from skyfolio.sim import Fleet, Hills, VehicleSpec, VirtualClock
from skyfolio.sim.geo import LocalFrame
from skyfolio.sim.modes import Mode

HOME = (47.397742, 8.545594)


def slope(rise: float = 0.5) -> Hills:
    """Ground that rises by `rise` metres a metre to the east of home, which is at 400 m, and is level to the west."""
    frame = LocalFrame(*HOME)
    return Hills(lambda lat, lon: 400.0 + rise * max(frame.to_local(lat, lon)[0], 0.0))


def fleet_on(hills: Hills, home_alt_m: float = 400.0) -> Fleet:
    return Fleet([VehicleSpec(1, *HOME, home_alt_m=home_alt_m)], clock=VirtualClock(), hills=hills)


def aloft(fleet: Fleet, up_m: float) -> Any:
    """Let the vehicle take off, and return it once it is up."""
    vehicle = fleet.vehicles[1]
    assert vehicle.autopilot.arm()
    vehicle.autopilot.takeoff(up_m)
    fleet.step_to(fleet.now_s + 5.0 + up_m)
    assert vehicle.autopilot.body.up_m == pytest.approx(up_m, abs=1.0)
    return vehicle


def test_over_a_slope_a_vehicle_is_nearer_to_the_ground_than_to_its_home() -> None:
    fleet = fleet_on(slope())
    vehicle = aloft(fleet, 60.0)
    vehicle.autopilot.reposition(60.0, 0.0, 60.0, 5.0)
    fleet.step_to(fleet.now_s + 30.0)
    last = fleet.truth.of(1)[-1]
    assert last.relative_alt_m == pytest.approx(60.0, abs=1.0)
    assert last.altitude_amsl_m == pytest.approx(460.0, abs=1.0)
    assert last.over_ground_m == pytest.approx(30.0, abs=1.5)


def test_a_vehicle_that_flies_into_the_slope_crashes_and_stays_where_it_hit() -> None:
    fleet = fleet_on(slope())
    vehicle = aloft(fleet, 20.0)
    vehicle.autopilot.reposition(200.0, 0.0, 20.0, 5.0)
    fleet.step_to(fleet.now_s + 60.0)
    assert [event.kind for event in fleet.truth.happened("crashed", 1)] == ["crashed"]
    body = vehicle.autopilot.body
    assert body.east_m == pytest.approx(40.0, abs=1.5)
    assert body.up_m == pytest.approx(20.0, abs=1.0)
    assert not vehicle.autopilot.dynamics.powered


def test_it_lands_uphill_on_the_ground_there_and_does_not_crash() -> None:
    fleet = fleet_on(slope(0.2))
    vehicle = aloft(fleet, 60.0)
    vehicle.autopilot.reposition(100.0, 0.0, 60.0, 5.0)
    fleet.step_to(fleet.now_s + 40.0)
    vehicle.autopilot.set_mode(Mode.LAND)
    fleet.step_to(fleet.now_s + 80.0)
    assert fleet.truth.happened("landed", 1)
    assert not fleet.truth.happened("crashed", 1)
    assert vehicle.autopilot.body.up_m == pytest.approx(20.0, abs=0.5)


def test_a_vehicle_whose_motors_stop_falls_as_far_as_the_ground_beneath_it() -> None:
    fleet = fleet_on(slope())
    vehicle = aloft(fleet, 60.0)
    vehicle.autopilot.reposition(60.0, 0.0, 60.0, 5.0)
    fleet.step_to(fleet.now_s + 30.0)
    vehicle.kill()
    fleet.step_to(fleet.now_s + 20.0)
    assert fleet.truth.of(1)[-1].over_ground_m == pytest.approx(0.0, abs=1e-6)
    assert fleet.truth.of(1)[-1].relative_alt_m == pytest.approx(30.0, abs=1.5)


def test_on_level_ground_height_over_ground_is_that_over_home() -> None:
    fleet = Fleet([VehicleSpec(1, *HOME)], clock=VirtualClock())
    aloft(fleet, 20.0)
    last = fleet.truth.of(1)[-1]
    assert last.over_ground_m == last.relative_alt_m
    assert last.altitude_amsl_m == 488.0 + last.relative_alt_m
