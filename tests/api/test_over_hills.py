"""Whole flights over hills in virtual time: truth keeps the clearance, homes that contradict the terrain stay down."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest

from skyfolio import sim
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import run
from skyfolio.planner import Scenario
from skyfolio.planner.terrain import Terrain
from skyfolio.sim.modes import Mode
from tests.api.test_virtual_ground import ended, flown, until
from tests.planner.hills import over_the_hill

TRACKING_M = 2.0
"""By so much a simulated vehicle may be lower than its plan has it."""


def tilted_hill() -> Terrain:
    """A hill on a slope: the ground at the two starts is 57 m apart in height."""
    places = np.arange(-50.0, 551.0, 25.0)
    east, north = np.meshgrid(places, places)
    heights = 300.0 + 0.3 * north + 90.0 * np.exp(-((east - 250.0) ** 2 + (north - 250.0) ** 2) / (2 * 70.0**2))
    return Terrain(south_west_m=(-50.0, -50.0), spacing_m=25.0, heights_m=tuple(map(tuple, heights.round(2).tolist())))


def hilly() -> Scenario:
    scenario = over_the_hill(terrain=tilted_hill(), clearance_m=25.0, slots=14)
    return scenario.with_changes(uavs=tuple(uav.model_copy(update={"max_speed_mps": 5.0}) for uav in scenario.uavs))


def on_hills(
    work: Callable[[Ground], Awaitable[object]], autopilots: Iterable[str] = ("px4",), lift_m: float = 0.0
) -> None:
    async def carry_out() -> None:
        scenario = hilly()
        specs = [replace(spec, home_alt_m=spec.home_alt_m + lift_m) for spec in Ground.specs_of(scenario, autopilots)]
        async with Ground(scenario, seed=5, specs=specs) as ground:
            await work(ground)

    run(carry_out())


def least_over_ground(ground: Ground, system_id: int, from_s: float, for_s: float) -> float:
    samples = [one for one in ground.fleet.truth.of(system_id) if from_s <= one.t_s <= from_s + for_s]
    assert len(samples) > 100
    return min(one.over_ground_m for one in samples)


@pytest.mark.parametrize("autopilots", [("px4",), ("ardupilot",), ("px4", "ardupilot")])
def test_vehicles_with_homes_at_different_heights_keep_the_clearance_all_the_way(autopilots: tuple[str, ...]) -> None:
    async def fly(ground: Ground) -> None:
        operation_id = await flown(ground)
        began_s = ground.now_s
        view = await until(ground, operation_id, ended)
        assert (view.state, view.error) == (State.COMPLETED, None)
        for system_id in (1, 2):
            assert least_over_ground(ground, system_id, began_s, 60.0) >= 25.0 - TRACKING_M
        homes = [vehicle.autopilot.spec.home_alt_m for vehicle in ground.fleet.vehicles.values()]
        assert abs(homes[0] - homes[1]) > 50.0
        assert not ground.fleet.truth.happened("crashed")
        frames = [item.frame for item in ground.fleet.vehicles[1].autopilot.missions.mission.items if item.has_place]
        assert set(frames) <= {0, 5}  # MAV_FRAME_GLOBAL(_INT): above mean sea level

    on_hills(fly, autopilots)


def test_the_survivor_of_a_loss_keeps_the_clearance_on_its_way_into_the_new_plan() -> None:
    async def fly(ground: Ground) -> None:
        operation_id = await flown(ground)
        began_s = ground.now_s
        ground.fleet.inject(sim.Kill(2), at_s=began_s + 22.0)
        view = await until(ground, operation_id, ended)
        assert [report.outcome for report in view.recoveries] == ["flying"]
        assert (view.state, view.lost) == (State.COMPLETED, ["south"])
        assert least_over_ground(ground, 1, began_s, 60.0) >= 25.0 - TRACKING_M

    on_hills(fly)


def test_a_uav_that_is_lower_than_planned_when_another_is_lost_is_planned_for_from_where_it_is() -> None:
    """West climbs all the way by its plan; here it climbs a third as fast."""

    async def fly(ground: Ground) -> None:
        operation_id = await flown(ground)
        began_s = ground.now_s
        ground.fleet.vehicles[1].autopilot.parameters["MPC_Z_V_AUTO_UP"] = 0.5
        ground.fleet.inject(sim.Kill(2), at_s=began_s + 12.0)
        view = await until(ground, operation_id, lambda view: view.recoveries and view.recoveries[0].plan_id)
        assert ground.service is not None
        first, again = [await ground.ask(ground.service.plans.finished(plan_id)) for plan_id in view.plan_ids]
        [west] = again.scenario.uavs
        assert first.altitudes_m is not None
        assert west.start_altitude_m is not None
        await asyncio.sleep(began_s + again.first_slot * 5.0 - ground.now_s)
        flown_m = ground.fleet.truth.of(1)[-1].altitude_amsl_m
        assert first.altitudes_m["west"][again.first_slot] > flown_m + 10.0
        assert flown_m - 1.0 <= west.start_altitude_m < flown_m + 8.0  # it is believed to climb until then
        await until(ground, operation_id, ended)
        assert least_over_ground(ground, 1, began_s + 40.0, 25.0) >= 25.0 - TRACKING_M

    on_hills(fly)


def test_a_return_in_flight_comes_home_over_the_hill() -> None:
    async def fly(ground: Ground) -> None:
        await flown(ground)
        began_s = ground.now_s
        assert ground.service is not None
        vehicle = ground.fleet.vehicles[1].autopilot
        ground.fleet.inject(sim.Kill(2), at_s=began_s + 5.0)
        await asyncio.sleep(45.0)
        vehicle.set_mode(Mode.RTL)
        await asyncio.sleep(120.0)
        assert ground.fleet.truth.happened("landed", 1)
        assert not ground.fleet.truth.happened("crashed", 1)
        home = [one for one in ground.fleet.truth.of(1) if one.mode == "RTL"]
        flying = [one for one in home if one.ground_speed_mps > 1.0]
        assert min(one.over_ground_m for one in flying) >= 25.0 - TRACKING_M

    on_hills(fly)


def test_homes_that_contradict_the_terrain_keep_the_fleet_on_the_ground() -> None:
    """GPS heights 20 m too great: the fleet would fly 20 m lower over the ground than planned, of 25."""

    async def fly(ground: Ground) -> None:
        service = await ground.start()
        await ground.register()
        record = await ground.ask(service.plans.submit(ground.scenario, fresh("plan")))
        await ground.ask(service.plans.wait(record, 60.0))
        operation = await ground.ask(service.operations.start(record.id, "auto", fresh("operation")))
        view = await until(ground, operation.id, ended)
        assert view.state == State.FAILED
        assert "home altitude is " in (view.error or "")
        assert "as the terrain has it" in (view.error or "")
        assert not ground.fleet.truth.happened("takeoff")

    on_hills(fly, lift_m=20.0)
