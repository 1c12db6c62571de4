"""Flying simulated vehicles through the link: launch, go to, start, swap, hold, land."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import hypot
from typing import Any

import pytest

from skyfolio.mavlink_bridge import (
    Autopilot,
    FlightMode,
    Mission,
    compile_mission,
    east_north_to_geodetic,
    geodetic_to_east_north,
    mission_differences,
)
from skyfolio.planner.plans import Plan
from skyfolio.sim import Kill, Mode, Mute
from tests.virtual_time import in_virtual_time

Open = Callable[..., Any]
PlanOf = Callable[..., Plan]
IDS = (1, 2, 3)


BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


def missions_of(plan: Plan, **how: Any) -> dict[int, Mission]:
    return {n: compile_mission(plan, uav, **how) for n, uav in enumerate(plan.trajectories_m, start=1)}


def low(plan: Plan) -> Plan:
    """The same plan at 10 m: the climb is not what is tested."""
    return plan.model_copy(update={"scenario": plan.scenario.with_changes(altitude_m=10.0)})


def moved(plan: Plan, east_m: float) -> Plan:
    """The same plan, everyone flying `east_m` further east."""
    paths = {uav: [(e + east_m, n) for e, n in path] for uav, path in plan.trajectories_m.items()}
    return plan.model_copy(update={"trajectories_m": paths})


async def in_the_air(field: Any, plan: Plan) -> None:
    """Everyone at altitude with the mission on board."""
    missions = missions_of(plan, autopilot=field.link.autopilot(1))
    uploaded = await field.link.upload(missions)
    assert all(result.ok for result in uploaded.values()), uploaded
    launched = await field.link.launch(dict.fromkeys(field.fleet.vehicles, plan.scenario.altitude_m), timeout_s=10)
    assert all(result.ok for result in launched.values()), launched


async def flying(field: Any, plan: Plan) -> None:
    """Everyone in slot 0 of the plan."""
    await in_the_air(field, plan)
    started = await field.link.start(set(field.fleet.vehicles))
    assert all(result.ok for result in started.values()), started


def mode_of(field: Any, system_id: int) -> Mode:
    mode: Mode = field.fleet.vehicles[system_id].autopilot.mode
    return mode


def mission_id_of(field: Any, system_id: int) -> int:
    return int(field.fleet.vehicles[system_id].autopilot.runner.mission.mission_id)


@BOTH
@in_virtual_time
async def test_a_fleet_is_launched_and_starts_its_missions_together(
    airfield: Open, trio: Plan, autopilot: Autopilot
) -> None:
    async with airfield(low(trio), autopilot=autopilot) as field:
        await flying(field, low(trio))
        for system_id in IDS:
            now = field.link.telemetry(system_id)
            assert (now.mode, now.armed) == (FlightMode.MISSION, True)
            assert now.relative_alt_m == pytest.approx(10.0, abs=1.5)
            assert mode_of(field, system_id) is Mode.MISSION
        entered = [event.t_s for event in field.fleet.truth.happened("mode") if event.detail["mode"] == "MISSION"]
        assert len(entered) == 3
        assert max(entered) - min(entered) < 1.0


@in_virtual_time
async def test_a_vehicle_that_cannot_climb_in_time_says_how_far_it_got(airfield: Open, line_and_hover: Plan) -> None:
    async with airfield(line_and_hover, speedup=2.0) as field:
        (result,) = (await field.link.launch({1: 60.0}, timeout_s=0.5)).values()
        assert not result.ok
        assert result.error is not None
        assert result.error.endswith("of 60 m after 0.5 s")


@in_virtual_time
async def test_starting_without_a_mission_fails_by_name_and_the_rest_fly(airfield: Open, trio: Plan) -> None:
    plan = low(trio)
    async with airfield(plan) as field:
        missions = missions_of(plan)
        await field.link.upload({1: missions[1], 3: missions[3]})
        await field.link.launch(dict.fromkeys(IDS, 10.0), timeout_s=10)
        results = await field.link.start(IDS)
        assert {system_id: result.ok for system_id, result in results.items()} == {1: True, 2: False, 3: True}


@in_virtual_time
async def test_a_vehicle_goes_to_a_place_and_waits_there(airfield: Open, line_and_hover: Plan) -> None:
    plan = low(line_and_hover)
    async with airfield(plan) as field:
        await in_the_air(field, plan)
        lat, lon = east_north_to_geodetic(plan.scenario.origin, 15.0, -20.0)
        (result,) = (await field.link.go_to({1: (lat, lon, 12.0)}, timeout_s=10)).values()
        assert result.ok, result
        now = field.link.telemetry(1)
        assert geodetic_to_east_north(plan.scenario.origin, now.lat_deg, now.lon_deg) == pytest.approx(
            (15.0, -20.0), abs=1.0
        )
        assert now.relative_alt_m == pytest.approx(12.0, abs=1.0)


@BOTH
@in_virtual_time
async def test_a_swap_in_flight_ends_flying_the_new_mission_without_a_stop(
    airfield: Open, trio: Plan, autopilot: Autopilot
) -> None:
    plan = low(trio)
    async with airfield(plan, autopilot=autopilot, speedup=2.0) as field:
        await flying(field, plan)
        await field.fly_for(7.0)
        swapped_s = field.clock.now()
        new = missions_of(moved(plan, 8.0), airborne=True, autopilot=autopilot)
        results = await field.link.swap(new)
        assert all(result.ok and result.upload.verified and not result.held for result in results.values()), results
        await field.fly_for(12.0)
        for system_id in IDS:
            assert mode_of(field, system_id) is Mode.MISSION
            on_board = field.fleet.vehicles[system_id].autopilot.runner.mission.items
            assert mission_differences(new[system_id].items, on_board, autopilot=autopilot) == ()
            samples = [sample for sample in field.fleet.truth.of(system_id) if sample.t_s > swapped_s]
            assert min(sample.ground_speed_mps for sample in samples) > 0.2
            assert min(sample.relative_alt_m for sample in samples) > 9.0


@in_virtual_time
async def test_a_vehicle_that_hovers_is_swapped_into_its_mission(airfield: Open, line_and_hover: Plan) -> None:
    plan = low(line_and_hover)
    async with airfield(plan) as field:
        await flying(field, plan)
        assert (await field.link.hold({1}))[1].ok
        assert mode_of(field, 1) is Mode.HOLD
        (result,) = (await field.link.swap(missions_of(moved(plan, 8.0), airborne=True))).values()
        assert result.ok, result
        assert mode_of(field, 1) is Mode.MISSION


@in_virtual_time
async def test_a_silent_vehicle_is_not_swapped_and_not_said_to_hold(airfield: Open, trio: Plan) -> None:
    plan = low(trio)
    async with airfield(plan) as field:
        await flying(field, plan)
        field.fleet.inject(Mute(2))
        results = await field.link.swap(missions_of(moved(plan, 8.0), airborne=True))
        assert {system_id: result.ok for system_id, result in results.items()} == {1: True, 2: False, 3: True}
        assert not results[2].held
        assert results[2].error in {"given up: the link was declared lost", "MISSION_COUNT: no answer for 1.5 s"}


async def test_a_vehicle_whose_new_mission_cannot_be_proven_holds(
    airfield: Open, relay_to: Callable[[int], Any], line_and_hover: Plan, free_port: int
) -> None:
    plan = low(line_and_hover)
    async with (
        relay_to(free_port) as relay,
        airfield(plan, endpoint=f"udpout://127.0.0.1:{relay.port}", port=free_port) as field,
    ):
        await flying(field, plan)
        relay.to_ground = lambda datagram: [] if datagram[7] == MISSION_COUNT else [datagram]  # no download begins
        (result,) = (await field.link.swap(missions_of(moved(plan, 8.0), airborne=True))).values()
        assert (result.ok, result.held) == (False, True)
        assert str(result.error).startswith("MISSION_REQUEST_LIST: no answer for ")  # longer, the slower the link was
        assert mode_of(field, 1) is Mode.HOLD


MISSION_COUNT = 44


@in_virtual_time
async def test_a_vehicle_somebody_else_took_over_is_left_alone(airfield: Open, line_and_hover: Plan) -> None:
    plan = low(line_and_hover)
    async with airfield(plan) as field:
        await flying(field, plan)
        before = mission_id_of(field, 1)
        field.fleet.vehicles[1].autopilot.set_mode(Mode.RTL)
        await field.fly_for(1.5)
        (result,) = (await field.link.swap(missions_of(moved(plan, 8.0), airborne=True))).values()
        assert (result.ok, result.held) == (False, False)
        assert result.error == "not ours to command: it is in mode 'return'"
        assert (mode_of(field, 1), mission_id_of(field, 1)) == (Mode.RTL, before)


async def test_a_human_who_takes_over_in_the_middle_of_a_swap_is_not_overruled(
    airfield: Open, relay_to: Callable[[int], Any], line_and_hover: Plan, free_port: int
) -> None:
    plan = low(line_and_hover)
    async with (
        relay_to(free_port) as relay,
        airfield(plan, endpoint=f"udpout://127.0.0.1:{relay.port}", port=free_port) as field,
    ):
        await flying(field, plan)
        relay.to_ground = lambda datagram: [] if datagram[7] == MISSION_COUNT else [datagram]  # no download begins
        swapping = asyncio.create_task(field.link.swap(missions_of(moved(plan, 8.0), airborne=True)))
        while mode_of(field, 1) is not Mode.HOLD:  # until the new mission is proven
            await field.fly_for(0.1)
        field.fleet.vehicles[1].autopilot.set_mode(Mode.POSITION)
        (result,) = (await swapping).values()
        assert (result.ok, result.held) == (False, False)
        assert mode_of(field, 1) is Mode.POSITION


@in_virtual_time
async def test_vehicles_hold_and_land_on_command(airfield: Open, trio: Plan) -> None:
    plan = low(trio)
    async with airfield(plan) as field:
        await flying(field, plan)
        field.fleet.inject(Kill(3))
        held = await field.link.hold({1, 3})
        assert (held[1].ok, held[3].error) == (True, "set mode: TIMEOUT")
        assert (await field.link.land({1}))[1].ok
        await field.fly_for(25.0)
        now = field.link.telemetry(1)
        assert (now.armed, round(now.relative_alt_m)) == (False, 0)
        assert mode_of(field, 2) is Mode.MISSION


@in_virtual_time
async def test_a_fleet_flies_its_plan_is_swapped_after_a_loss_and_lands_at_the_new_end(
    airfield: Open, trio: Plan
) -> None:
    plan = low(trio)
    async with airfield(plan, speedup=10.0) as field:
        await flying(field, plan)
        began_s = field.clock.now()
        await field.fly_for(50.0)
        field.fleet.inject(Kill(3))
        async for change in field.link.changes():
            if change.system_id == 3 and any(step.after == "lost" for step in change.link):
                break
        slot = int((field.clock.now() - began_s) // 5.0)
        rest = {
            uav: [positions_m(field, plan)[n], *[(e + 6.0, north) for e, north in plan.trajectories_m[uav][slot + 1 :]]]
            for n, uav in ((1, "uav-1"), (2, "uav-2"))
        }
        replan = plan.model_copy(update={"trajectories_m": rest})
        left_s = (slot + 1) * 5.0 - (field.clock.now() - began_s)
        results = await field.link.swap(missions_of(replan, airborne=True, first_leg_s=left_s))
        assert all(result.ok for result in results.values()), results
        await field.fly_for(100.0 - (field.clock.now() - began_s) + 25.0)
        for system_id, uav in ((1, "uav-1"), (2, "uav-2")):
            now = field.link.telemetry(system_id)
            assert (now.armed, round(now.relative_alt_m)) == (False, 0)
            e, n = positions_m(field, plan)[system_id]
            assert hypot(e - rest[uav][-1][0], n - rest[uav][-1][1]) < 1.0


def positions_m(field: Any, plan: Plan) -> dict[int, tuple[float, float]]:
    """Where each vehicle was last heard, metres east/north of the origin."""
    found = {system_id: field.link.telemetry(system_id) for system_id in IDS}
    return {n: geodetic_to_east_north(plan.scenario.origin, t.lat_deg, t.lon_deg) for n, t in found.items()}
