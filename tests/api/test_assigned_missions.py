"""Missions that were assigned to UAVs, stored for the next service."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import insert

from skyfolio.api.flights.assigned_missions import AssignedMission, AssignedMissionStore
from skyfolio.api.store import Database
from skyfolio.api.store.tables import operations
from skyfolio.mavlink_bridge import Autopilot, compile_mission, mission_differences
from skyfolio.planner import EXAMPLES, Plan, plan


@pytest.fixture(scope="module")
def minimal() -> Plan:
    return plan(EXAMPLES["minimal"]())


def assigned(minimal: Plan, uav: str, autopilot: Autopilot, altitude_m: float = 60.0) -> AssignedMission:
    return AssignedMission(
        mission=compile_mission(minimal, uav, autopilot=autopilot),
        path_m=list(minimal.trajectories_m[uav]),
        first_slot=3,
        slot_s=minimal.scenario.slot_duration_s,
        origin=minimal.scenario.origin,
        altitude_m=altitude_m,
    )


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_mission_comes_back_as_it_was(minimal: Plan, autopilot: Autopilot) -> None:
    before = assigned(minimal, "uav-1", autopilot)
    after = AssignedMission.of_document(before.document())
    assert mission_differences(before.mission.items, after.mission.items) == ()
    for name in ("path_m", "first_slot", "slot_s", "origin", "altitude_m", "began_s"):
        assert getattr(after, name) == getattr(before, name)
    for name in ("uav_id", "slot_of_item", "duration_s", "start_item", "autopilot"):
        assert getattr(after.mission, name) == getattr(before.mission, name)
    assert after.mission.autopilot is autopilot


def test_altitudes_over_terrain_come_back_too_and_older_documents_are_level(minimal: Plan) -> None:
    level = assigned(minimal, "uav-1", Autopilot.PX4)
    assert (level.altitudes.amsl, set(level.altitudes.metres)) == (False, {60.0})
    climbs = replace(level, altitudes_m=[500.0 + n for n in range(len(level.path_m))], amsl=True)
    assert AssignedMission.of_document(climbs.document()).altitudes == climbs.altitudes
    older = {name: value for name, value in json.loads(level.document()).items() if name not in ("altitudes_m", "amsl")}
    assert AssignedMission.of_document(json.dumps(older)).altitudes == level.altitudes


async def test_the_newest_mission_of_each_uav_comes_first(minimal: Plan, tmp_path: Path) -> None:
    database = await Database.open(f"sqlite+aiosqlite:///{tmp_path}/service.db")
    row = {"id": "op-1", "number": 1, "created_at": 0.0, "plan_id": "plan-1", "policy": "auto", "state": "flying"}
    await database.write((insert(operations), {**row, "version": 0, "document": "{}"}))
    store = AssignedMissionStore(database, "op-1")
    await store.write({uav: assigned(minimal, uav, Autopilot.PX4) for uav in ("uav-1", "uav-2")})
    await store.write({"uav-1": assigned(minimal, "uav-1", Autopilot.PX4, altitude_m=65.0)})
    await store.write({})
    missions = await store.read()
    assert {uav: [one.altitude_m for one in stored] for uav, stored in missions.items()} == {
        "uav-1": [65.0, 60.0],
        "uav-2": [60.0],
    }
    assert await AssignedMissionStore(database, "op-2").read() == {}
    await database.close()
