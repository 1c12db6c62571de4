"""`skyfolio check` on simulated vehicles of both kinds: what it finds, and that it leaves them as they were."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from skyfolio import sim
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.trial_mission import trial_plan
from skyfolio.api.fleet.vehicle_check import UAV, CheckConfig, CheckReport, changed_fields, check
from skyfolio.mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, MissionItem, compile_mission
from skyfolio.mavlink_bridge.fence import fence_items, rally_items
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.planner import Origin
from tests.api.test_cli import run
from tests.ports import free_port

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
HERE = Origin(lat_deg=47.397742, lon_deg=8.545594)
ELSEWHERE = [(0.0, 0.0), (0.0, 40.0), (10.0, 40.0)]
SAFE = {
    Autopilot.PX4: {"COM_LOW_BAT_ACT": 3.0},
    Autopilot.ARDUPILOT: {
        "SYSID_MYGCS": 245.0, "FS_GCS_ENABLE": 1.0, "BATT_FS_LOW_ACT": 2.0, "FENCE_ENABLE": 1.0, "WPNAV_JERK": 5.0,
        "FS_OPTIONS": 18.0,
    },
}  # fmt: skip


@asynccontextmanager
async def fleet_of(autopilot: Autopilot, vehicles: int = 1) -> AsyncIterator[tuple[sim.Fleet, CheckConfig]]:
    """Vehicles with good parameters on the ground, and how to reach them."""
    port = free_port(socket.SOCK_DGRAM)
    specs = sim.grid_of(vehicles, HERE.lat_deg, HERE.lon_deg, autopilot=autopilot.value)
    async with sim.Fleet(specs, clock=sim.ScaledClock(1.0), endpoint=f"udpout://127.0.0.1:{port}") as fleet:
        for vehicle in fleet.vehicles.values():
            for name, value in SAFE[autopilot].items():
                vehicle.autopilot.parameters[name] = value
        yield fleet, CheckConfig(urls=(f"udpin://127.0.0.1:{port}",))


def on_board(fleet: sim.Fleet, system_id: int) -> list[list[Any]]:
    plan = fleet.vehicles[system_id].autopilot.missions.plan
    return [[(item.command, item.x, item.y) for item in plan(kind).items] for kind in MissionType]


@BOTH
async def test_a_good_vehicle_is_ready_and_has_afterwards_what_it_had_before(autopilot: Autopilot) -> None:
    async with fleet_of(autopilot) as (fleet, config):
        plan = trial_plan(HERE, {UAV: ELSEWHERE})
        async with FleetLink(clock=FleetClock(), monitor=HeartbeatMonitor()) as link:
            await link.connect(config.urls[0])
            await link.wait_for({1}, timeout_s=10)
            assert (await link.upload({1: compile_mission(plan, UAV, autopilot=autopilot)}))[1].ok
            assert (await link.upload_fence({1: fence_items(plan.scenario)}))[1].ok
            rally = rally_items(plan.scenario, [(3.0, 4.0)], 20.0)
            assert (await link.upload_fence({1: rally}, mission_type=MissionType.RALLY))[1].ok
        before = on_board(fleet, 1)
        said: list[str] = []
        report = await check(config, said.append)
        (one,) = report.vehicles
        assert report.ready, report
        assert (one.system_id, one.autopilot, one.missing, one.findings) == (1, autopilot.value, [], [])
        assert [(each.kind, each.verified, each.restored) for each in one.transfers] == [
            ("mission", True, True), ("fence", True, True), ("rally", True, True)
        ]  # fmt: skip
        assert [each.items_before for each in one.transfers] == [len(items) for items in before]
        assert all(before)
        assert on_board(fleet, 1) == before
        assert not fleet.truth.happened("armed")
        assert said[0] == "waiting for heartbeats"
        assert "system 1: restoring its rally" in said


@BOTH
async def test_an_armed_vehicle_is_left_alone(autopilot: Autopilot) -> None:
    async with fleet_of(autopilot) as (fleet, config):
        assert fleet.vehicles[1].autopilot.arm()
        report = await check(config)
        (one,) = report.vehicles
        assert not report.ready
        assert (one.findings[0].name, one.findings[0].level.value) == ("armed", "blocker")
        assert one.transfers == []
        assert not fleet.truth.happened("mission_accepted")


@BOTH
async def test_what_a_vehicle_stores_wrongly_is_told_field_by_field_and_it_is_not_ready(autopilot: Autopilot) -> None:
    async with fleet_of(autopilot) as (fleet, config):
        fleet.inject(sim.CorruptUpload(1, uploads=99))
        report = await check(config)
        mission = report.vehicles[0].transfers[0]
        assert not report.ready
        assert not mission.verified
        assert mission.error is not None
        assert "read-back differs" in mission.error
        assert mission.changed


async def test_a_vehicle_without_a_fix_is_waited_for_and_then_ready() -> None:
    async with fleet_of(Autopilot.PX4) as (fleet, config):
        fleet.inject(sim.GpsLoss(1, for_s=5.0))
        said: list[str] = []
        report = await check(config, said.append)
        assert report.ready, report
        assert any(words.startswith("system 1: waiting for its GPS fix, position") for words in said)


async def test_all_vehicles_are_checked_unless_some_are_named() -> None:
    async with fleet_of(Autopilot.PX4, vehicles=3) as (fleet, config):
        fleet.vehicles[2].autopilot.parameters["NAV_DLL_ACT"] = 5.0
        report = await check(config)
        assert [one.system_id for one in report.vehicles] == [1, 2, 3]
        assert [one.ready for one in report.vehicles] == [True, False, True]
        assert not report.ready
        again = await check(CheckConfig(urls=config.urls, system_ids=(3,)))
        assert [one.system_id for one in again.vehicles] == [3]
        assert again.ready


def checked(patch: pytest.MonkeyPatch, *arguments: str, autopilot: Autopilot | None = None, **parameters: float) -> int:
    """The exit status of the command, beside a fleet of one in a thread, if any."""
    port = free_port(socket.SOCK_DGRAM)
    until, standing = threading.Event(), threading.Event()

    async def stand(kind: Autopilot) -> None:
        spec = sim.VehicleSpec(1, HERE.lat_deg, HERE.lon_deg, autopilot=kind.value)
        async with sim.Fleet([spec], clock=sim.ScaledClock(1.0), endpoint=f"udpout://127.0.0.1:{port}") as fleet:
            for name, value in {**SAFE[kind], **parameters}.items():
                fleet.vehicles[1].autopilot.parameters[name] = value
            standing.set()
            await asyncio.to_thread(until.wait)

    thread = None if autopilot is None else threading.Thread(target=lambda: asyncio.run(stand(autopilot)))
    if thread is not None:
        thread.start()
        assert standing.wait(10)
    try:
        return run(patch, "check", f"udpin://127.0.0.1:{port}", *arguments)
    finally:
        until.set()
        if thread is not None:
            thread.join()


def test_the_command_ends_with_0_and_a_verdict_or_with_json_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert checked(monkeypatch, autopilot=Autopilot.ARDUPILOT) == 0
    assert "system 1: ready" in capsys.readouterr().out
    assert checked(monkeypatch, "--json", autopilot=Autopilot.ARDUPILOT) == 0
    report = CheckReport.model_validate(json.loads(capsys.readouterr().out))
    assert (report.ready, len(report.vehicles[0].transfers)) == (True, 3)


def test_the_command_ends_with_1_when_something_blocks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert checked(monkeypatch, autopilot=Autopilot.PX4, NAV_DLL_ACT=5.0) == 1
    assert "NOT READY" in capsys.readouterr().out


def test_the_command_ends_with_2_when_nobody_answers_or_it_is_used_wrongly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert checked(monkeypatch, "--wait-s", "1") == 2
    assert "no heartbeat of an autopilot was heard" in capsys.readouterr().err
    assert checked(monkeypatch, "--wait-s", "1", "--system-id", "9") == 2
    assert "system 9" in capsys.readouterr().err


def test_fields_that_are_stored_otherwise_are_told_once_for_each_command() -> None:
    sent = [MissionItem(seq=n, frame=6, command=16, x=1, y=2, z=60.0, current=int(n == 0)) for n in range(5)]
    stored = [MissionItem(seq=n, frame=3, command=16, x=1, y=2, z=60.00000001) for n in range(5)]
    assert changed_fields(sent, sent) == []
    assert changed_fields(sent, stored) == ["command 16 frame: 6 sent, 3 stored (items 0, 1, 2, ...)"]
    assert changed_fields(sent, stored[:4]) == ["5 items sent, 4 stored"]
    nothing = MissionItem(seq=0, frame=2, command=16, param4=float("nan"))
    assert changed_fields([nothing], [nothing]) == []
