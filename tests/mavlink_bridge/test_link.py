"""The link against the real simulator on loopback."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge import (
    BridgeError,
    ConnectionFailed,
    FleetLink,
    HeartbeatMonitor,
    LinkClosed,
    LinkState,
    VehiclesMissing,
    compile_mission,
    east_north_to_geodetic,
    mission_differences,
)
from skyfolio.mavlink_bridge.conditions import Condition
from skyfolio.planner.plans import Plan
from skyfolio.sim import Kill, Mute, ScaledClock

Open = Callable[..., Any]
PlanOf = Callable[..., Plan]


def missions_of(plan: Plan) -> dict[int, Any]:
    return {n: compile_mission(plan, uav) for n, uav in enumerate(plan.trajectories_m, start=1)}


def on_board(field: Any, system_id: int) -> Any:
    return field.fleet.vehicles[system_id].autopilot.missions.mission.items


async def test_three_vehicles_on_one_port_are_found_and_tell_where_they_stand(airfield: Open, trio: Plan) -> None:
    async with airfield(trio) as field:
        assert field.link.heard_systems == {1, 2, 3}
        await field.fly_for(2.0)
        for system_id, path in enumerate(trio.trajectories_m.values(), start=1):
            now = field.link.telemetry(system_id)
            assert now is not None
            assert (now.system_id, now.armed) == (system_id, False)
            assert (now.lat_deg, now.lon_deg) == pytest.approx(
                east_north_to_geodetic(trio.scenario.origin, *path[0]), abs=2e-7
            )
            assert 0 <= field.clock.now() - now.heard_at_s < 2.0
        assert field.link.telemetry(9) is None


async def test_a_vehicle_that_never_answers_is_named_and_so_are_the_others(airfield: Open, trio: Plan) -> None:
    async with airfield(trio) as field:
        with pytest.raises(VehiclesMissing, match=r"system 7, 9 within 0.3 s; heard: 1, 2, 3") as caught:
            await field.link.wait_for({1, 7, 9}, timeout_s=0.3)
        assert (caught.value.missing, caught.value.present) == ((7, 9), (1, 2, 3))
        assert field.link.monitor.watched == {1, 2, 3}


async def test_a_41_item_mission_is_on_board_of_the_whole_fleet_and_proven(airfield: Open, trio: Plan) -> None:
    async with airfield(trio) as field:
        missions = missions_of(trio)
        results = await field.link.upload(missions)
        assert all(result.ok and result.verified and result.attempts == 1 for result in results.values())
        for system_id, mission in missions.items():
            assert len(mission.items) == 41
            assert mission_differences(mission.items, on_board(field, system_id)) == ()
            assert (
                results[system_id].mission_id
                == field.fleet.truth.happened("mission_accepted", system_id)[-1].detail["mission_id"]
            )


async def test_a_silent_vehicle_fails_by_name_and_the_others_get_their_missions(airfield: Open, trio: Plan) -> None:
    async with airfield(trio) as field:
        field.fleet.inject(Mute(2))
        missions = missions_of(trio)
        results = await field.link.upload({**missions, 9: missions[1]})
        assert {system_id: result.ok for system_id, result in results.items()} == {1: True, 2: False, 3: True, 9: False}
        assert results[2].error == "given up: the link was declared lost"
        assert results[9].error == "system 9 was never heard on this link"
        assert not results[2].verified
        assert on_board(field, 2) == ()


async def test_a_killed_vehicle_is_lost_within_six_seconds_and_nobody_else_is(airfield: Open, trio: Plan) -> None:
    async with airfield(trio, speedup=5.0) as field:
        await field.fly_for(2.0)
        changes, others = field.link.changes(), field.link.changes()
        field.fleet.inject(Kill(3))
        killed_s = field.clock.now()
        seen = []
        async with asyncio.timeout(5):
            async for change in changes:
                seen.append(change)
                if change.link[-1].after is LinkState.LOST:
                    break
        steps = [step for change in seen for step in change.link]
        assert [(step.system_id, step.after) for step in steps] == [(3, LinkState.STALE), (3, LinkState.LOST)]
        assert steps[-1].silent_for_s >= 5.0
        assert steps[-1].at_s - killed_s < 6.0
        assert [change.condition.after for change in seen if change.condition] == [Condition.STALE, Condition.LINK_LOST]
        assert await anext(others) == seen[0]


async def test_a_companion_that_lives_on_does_not_hide_the_dead_autopilot(
    airfield: Open, plan_of: PlanOf, free_port: int
) -> None:
    async with airfield(plan_of({"uav-1": [(0.0, 0.0)]}), speedup=10.0, port=free_port) as field:
        companion = dialect.MAVLink(None, srcSystem=1, srcComponent=191)
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=("127.0.0.1", free_port)
        )
        beat = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        changes = field.link.changes()
        field.fleet.inject(Kill(1))
        states = []
        async with asyncio.timeout(5):
            while LinkState.LOST not in states:
                transport.sendto(beat.pack(companion))
                await asyncio.sleep(0.05)
                states.append(field.link.monitor.state(1))
        assert (await anext(changes)).link[0].after is LinkState.STALE
        transport.close()
        await asyncio.sleep(0)


async def test_a_mission_gets_through_a_link_that_loses_every_tenth_datagram_each_way(
    airfield: Open, relay_to: Callable[[int], Any], line_and_hover: Plan, free_port: int
) -> None:
    chance = random.Random(7)

    def lossy(datagram: bytes) -> list[bytes]:
        return [] if chance.random() < 0.1 else [datagram]

    async with (
        relay_to(free_port) as relay,
        airfield(line_and_hover, endpoint=f"udpout://127.0.0.1:{relay.port}", port=free_port) as field,
    ):
        relay.to_ground = relay.to_vehicle = lossy
        results = await field.link.upload(missions_of(line_and_hover), attempts=5)
        assert results[1].verified, results[1]
        assert mission_differences(missions_of(line_and_hover)[1].items, on_board(field, 1)) == ()


async def test_a_read_back_that_differs_is_never_called_verified(
    airfield: Open, relay_to: Callable[[int], Any], trio: Plan, plan_of: PlanOf, free_port: int
) -> None:
    plan = plan_of({"uav-1": trio.trajectories_m["uav-1"]})
    async with (
        relay_to(free_port) as relay,
        airfield(plan, endpoint=f"udpout://127.0.0.1:{relay.port}", port=free_port) as field,
    ):
        relay.to_ground = raise_item_3
        (result,) = (await field.link.upload(missions_of(plan), attempts=2)).values()
        assert (result.ok, result.verified, result.attempts) == (False, False, 2)
        assert result.error == "read-back differs: item 3: z 60.0 sent, 61.0 read back"


def raise_item_3(datagram: bytes) -> list[bytes]:
    """Read back, item 3 is a metre higher than on board: a tamperer, or memory gone bad."""
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    messages = parser.parse_buffer(datagram) or []
    if [message.get_type() for message in messages] != ["MISSION_ITEM_INT"] or messages[0].seq != 3:
        return [datagram]
    item = messages[0]
    item.z += 1.0
    return [bytes(item.pack(dialect.MAVLink(None, srcSystem=item.get_srcSystem(), srcComponent=1)))]


async def test_qgroundcontrols_plan_reader_of_mavsdk_reads_our_plan_files(airfield: Open, line_and_hover: Plan) -> None:
    from mavsdk.plugins.mission_raw import MissionRaw  # noqa: PLC0415

    from skyfolio.mavlink_bridge import to_qgc_plan  # noqa: PLC0415

    async with airfield(line_and_hover) as field:
        mission = compile_mission(line_and_hover, "uav-1")
        raw = MissionRaw(field.link._port.mavsdk.get_systems()[0])
        read = raw.import_qgroundcontrol_mission_from_string(json.dumps(to_qgc_plan(mission))).mission_items
        assert [(item.seq, item.command, item.x, item.y) for item in read] == [
            (item.seq, item.command, item.x, item.y) for item in mission.items
        ]


async def test_a_url_that_cannot_be_opened_is_named() -> None:
    async with FleetLink(clock=ScaledClock(), monitor=HeartbeatMonitor()) as link:
        with pytest.raises(ConnectionFailed, match="nonsense://x"):
            await link.connect("nonsense://x")
        assert link.heard_systems == set()
    with pytest.raises(ConnectionFailed, match="nonsense://x"):
        await FleetLink(clock=ScaledClock(), monitor=HeartbeatMonitor()).connect("nonsense://x")


async def test_a_link_that_is_not_open_says_so(free_port: int) -> None:
    link = FleetLink(clock=ScaledClock(), monitor=HeartbeatMonitor())
    with pytest.raises(LinkClosed, match="not opened"):
        await link.wait_for({1}, timeout_s=1)
    await link.connect(f"udpin://127.0.0.1:{free_port}")
    changes = link.changes()
    await link.close()
    await link.close()
    assert [change async for change in changes] == []
    with pytest.raises(BridgeError, match="closed"):
        await link.connect(f"udpin://127.0.0.1:{free_port}")
