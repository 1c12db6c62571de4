"""What vehicles answer, and what becomes of a fleet of which one answers oddly; what is current on board."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge import Autopilot, Mission, compile_mission, mission_differences
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.planner.plans import Plan
from skyfolio.sim import Impair, Impairments, Mode
from tests.virtual_time import in_virtual_time

Open = Callable[..., Any]
PlanOf = Callable[..., Plan]
IDS = (1, 2, 3)
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
COMMAND_LONG, REQUEST = 76, 512
ONE_SECOND = Impairments(latency_s=1.0)


def missions_of(plan: Plan, autopilot: Autopilot, **how: Any) -> dict[int, Mission]:
    return {n: compile_mission(plan, uav, autopilot=autopilot, **how) for n, uav in enumerate(plan.trajectories_m, 1)}


def north(plan_of: PlanOf, *, uavs: int = 1) -> Plan:
    """UAVs side by side that fly north for half an hour, with another speed on each leg."""
    return plan_of(
        {f"uav-{n}": [(40.0 * n, 12.0 * slot + slot % 2 * 3) for slot in range(40)] for n in range(1, uavs + 1)},
        altitude_m=10.0,
    )


def elsewhere(plan_of: PlanOf) -> Plan:
    """Another plan for uav-1, as short as can be."""
    return plan_of({"uav-1": [(40.0, 0.0), (60.0, 20.0), (60.0, 70.0), (60.0, 95.0)]}, altitude_m=10.0)


async def flying(field: Any, missions: dict[int, Mission]) -> None:
    uploaded = await field.link.upload(missions)
    assert all(result.ok for result in uploaded.values()), uploaded
    launched = await field.link.launch(dict.fromkeys(missions, 10.0), timeout_s=15)
    assert all(result.ok for result in launched.values()), launched
    started = await field.link.start(missions)
    assert all(result.ok for result in started.values()), started


def has(field: Any, mission: Mission) -> bool:
    """Whether vehicle 1 flies this mission, whole."""
    autopilot = field.fleet.vehicles[1].autopilot
    same = not mission_differences(mission.items, autopilot.runner.mission.items, autopilot=mission.autopilot)
    return same and autopilot.mode is Mode.MISSION


@pytest.mark.parametrize(("number", "name"), [(7, "COMMAND_LONG_ONLY"), (8, "COMMAND_INT_ONLY"), (99, "UNKNOWN_99")])
@in_virtual_time
async def test_one_odd_answer_is_that_vehicles_error_and_the_others_do_as_they_are_told(
    airfield: Open, plan_of: PlanOf, number: int, name: str
) -> None:
    plan = north(plan_of, uavs=3)
    async with airfield(plan) as field:
        await flying(field, missions_of(plan, Autopilot.PX4))
        field.fleet.vehicles[2].autopilot._inbox._handlers["COMMAND_LONG"] = lambda message: [
            dialect.MAVLink_command_ack_message(message.command, number, 0, 0, 245, 190)
        ]
        results = await field.link.hold(IDS)
        assert {system_id: result.error for system_id, result in results.items()} == {
            1: None,
            2: f"set mode: {name}",
            3: None,
        }


@in_virtual_time
async def test_a_request_that_breaks_for_one_vehicle_does_not_take_the_others_results(
    airfield: Open, plan_of: PlanOf, caplog: pytest.LogCaptureFixture
) -> None:
    async with airfield(north(plan_of, uavs=3)) as field:

        def broken(*_: Any) -> None:
            raise OSError("no such wire")

        field.link.vehicle(2).send = broken
        results = await field.link.upload(missions_of(north(plan_of, uavs=3), Autopilot.PX4))
        assert [result.ok for result in results.values()] == [True, False, True]
        assert results[2].error == "OSError: no such wire"
        assert "system 2: the request broke" in caplog.text


@BOTH
def test_an_order_to_begin_with_a_speed_is_told_as_the_item_that_is_flown(
    plan_of: PlanOf, autopilot: Autopilot
) -> None:
    (mission,) = missions_of(north(plan_of), autopilot).values()
    items, profile = mission.items, profile_of(autopilot)
    for item in items[1:]:
        told = profile.current_after(items, item.seq)
        assert told.start == item.seq
        assert told[-1] == (item.seq if item.is_flown else item.seq + 1)
    assert list(profile.current_after(items, 0)) == ([0, 1] if autopilot is Autopilot.ARDUPILOT else [0])
    assert list(profile.current_after((), 5)) == [5]


@BOTH
@in_virtual_time
async def test_a_vehicle_in_flight_is_told_to_go_on_with_a_speed(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot
) -> None:
    plan = north(plan_of)
    async with airfield(plan, autopilot=autopilot) as field:
        (mission,) = missions_of(plan, autopilot).values()
        await flying(field, {1: mission})
        speeds = [item.seq for item in mission.items if not item.is_flown and item.seq > mission.start_item + 4]
        (result,) = (await field.link.start({1}, item=speeds[0])).values()
        assert result.ok, result
        assert field.link.telemetry(1).mission_current == speeds[0] + 1
        assert field.link.telemetry(1).mission_total == len(mission.items)


async def test_a_vehicle_that_refuses_to_be_asked_is_asked_once(
    airfield: Open, relay_to: Callable[[int], Any], plan_of: PlanOf, free_port: int
) -> None:
    plan, asked = north(plan_of), []

    def count(datagram: bytes) -> list[bytes]:
        message, payload = int.from_bytes(datagram[7:10], "little"), datagram[10:]
        if message == COMMAND_LONG and int.from_bytes(payload[28:30], "little") == REQUEST:
            asked.append(payload[:4])
        return [datagram]

    async with (
        relay_to(free_port) as relay,
        airfield(plan, endpoint=f"udpout://127.0.0.1:{relay.port}", port=free_port) as field,
    ):
        relay.to_vehicle = count
        missions = missions_of(plan, Autopilot.PX4)
        await flying(field, missions)
        for item in (6, 9, 12):
            (result,) = (await field.link.start({1}, item=item)).values()
            assert result.ok, result
        mission_current = b"\x00\x00\x28\x42"  # 42 as a float
        assert asked.count(mission_current) == 1


@BOTH
@in_virtual_time
async def test_after_a_refused_swap_the_mission_from_before_goes_on(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot
) -> None:
    plan = north(plan_of)
    async with airfield(plan, autopilot=autopilot) as field:
        old, new = missions_of(plan, autopilot)[1], missions_of(elsewhere(plan_of), autopilot, airborne=True)
        await flying(field, {1: old})
        await field.fly_for(12.0)
        at_item = field.link.telemetry(1).mission_current
        field.fleet.vehicles[1].autopilot.missions.refusals = 2
        (result,) = (await field.link.swap(new)).values()
        assert (result.ok, result.went_on, result.held) == (False, True, False)
        assert str(result.error).startswith("refused with ERROR at item ")
        assert has(field, old)
        await field.fly_for(2.0)
        assert field.link.telemetry(1).mission_current >= at_item


@BOTH
@in_virtual_time
async def test_a_swap_over_a_second_each_way_ends_flying_the_new_mission(
    airfield: Open, plan_of: PlanOf, autopilot: Autopilot
) -> None:
    plan = north(plan_of)
    async with airfield(plan, autopilot=autopilot, speedup=1.5) as field:
        await flying(field, missions_of(plan, autopilot))
        field.fleet.inject(Impair(1, up=ONE_SECOND, down=ONE_SECOND))
        await asyncio.sleep(2.5)
        new = missions_of(elsewhere(plan_of), autopilot, airborne=True)
        (result,) = (await field.link.swap(new)).values()
        assert (result.ok, result.upload.attempts) == (True, 1), result
        assert has(field, new[1])
        (held,) = (await field.link.hold({1})).values()
        assert held.ok, held
