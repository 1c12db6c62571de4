"""api.lab.simulate: the options of `skyfolio simulate`"""

from __future__ import annotations

import asyncio
import json
import math
import socket
from pathlib import Path

import pytest

from skyfolio.api.lab.simulate import SimulateConfig, SimulateError, begin_slots, fleet_of, run_fleet
from skyfolio.planner import EXAMPLES, Scenario, plan
from skyfolio.sim import Impairments, Mission, MissionItem, Mode, Mute, field_from
from tests.ports import free_port


def test_options_reach_the_fleet() -> None:
    fleet = fleet_of(
        SimulateConfig(
            vehicles=2,
            autopilot="ardupilot",
            faults=("mute:2@3,for_s=4",),
            up="loss=0.1,burst=3",
            weather="wind_east_mps=4,gps_m=0.5",
        )
    )
    assert {vehicle.spec.autopilot for vehicle in fleet.vehicles.values()} == {"ardupilot"}
    assert fleet.vehicles[1].radio.up.impairments == Impairments(loss=0.1, burst=3)
    assert fleet.vehicles[1].radio.down.impairments == Impairments()
    assert fleet.vehicles[2].autopilot.air.weather.wind_east_mps == 4
    fleet.step_to(3.1)
    assert not fleet.vehicles[2].transmitting
    assert fleet.truth.happened("fault", 2)[0].detail == {"fault": "mute", "for_s": Mute(2, for_s=4).for_s}


def test_crew_packs_and_fronts_reach_the_fleet() -> None:
    knobs = field_from(
        crew=2, turnaround_s=60.0, packs="count=3", battery_minutes=9.0, fronts=["at_s=5,east_mps=3,ramp_s=0"]
    )
    for scenario in (None, EXAMPLES["minimal"]()):
        fleet = fleet_of(SimulateConfig(vehicles=2, scenario=scenario, field_knobs=knobs))
        assert fleet.crew is not None
        assert fleet.crew.crew.members == 2
        assert [len(pad.stored) for pad in fleet.crew.pads.values()] == [2] * len(fleet.vehicles)
        assert fleet.vehicles[1].autopilot.parameters["BAT1_CAPACITY"] == pytest.approx(2500.0, rel=0.01)
        fleet.step_to(10.0)
        assert fleet.vehicles[1].autopilot.air.wind_mps == (3.0, 0.0)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (SimulateConfig(faults=("nap:1",)), "kind must be one of"),
        (SimulateConfig(faults=("kill:9",)), "there is no vehicle 9"),
        (SimulateConfig(up="loss"), "--up: 'loss' must look like FIELD=VALUE"),
        (SimulateConfig(down="loss=2"), "loss must be between 0 and 1"),
        (SimulateConfig(weather="rain=1"), "rain"),
        (SimulateConfig(signing_key="abc"), "fromhex"),
        (SimulateConfig(endpoint="tcp://1"), "endpoint must look like"),
    ],
)
def test_an_option_that_cannot_be_is_refused_naming_it(config: SimulateConfig, words: str) -> None:
    with pytest.raises(SimulateError, match=words):
        fleet_of(config)


@pytest.mark.parametrize("example", [None, EXAMPLES["minimal"]()])
def test_vehicles_are_switched_on_with_the_fleet_unless_they_have_been_on(example: Scenario | None) -> None:
    ages = {
        age: fleet_of(SimulateConfig(scenario=example, booted_s_ago=age)).vehicles[1].autopilot.boot_plan.age_s
        for age in (0.0, 60.0)
    }
    assert SimulateConfig().booted_s_ago == 0.0
    assert ages == {0.0: pytest.approx(0.0), 60.0: pytest.approx(60.0)}
    assert fleet_of(SimulateConfig(autopilot="ardupilot")).vehicles[1].autopilot.satellites is False


async def test_it_writes_what_happened_and_all_mavlink(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = plan(EXAMPLES["minimal"]().with_changes(slots=3))
    config = SimulateConfig(
        plan=made,
        speedup=100.0,
        duration_s=10.0,
        endpoint=f"udpout://127.0.0.1:{free_port(socket.SOCK_DGRAM)}",
        faults=("kill:1@2",),
        log=tmp_path / "logs" / "truth.jsonl",
        tlog=tmp_path / "logs" / "flight.tlog",
        as_json=True,
    )
    async with asyncio.timeout(30):
        await run_fleet(config)
    rows = [json.loads(line) for line in (tmp_path / "logs" / "truth.jsonl").read_text().splitlines()]
    assert {row["log"] for row in rows} == {"sample", "event"}
    assert [row["kind"] for row in rows if row["log"] == "event"][:2] == ["fault", "killed"]
    assert (tmp_path / "logs" / "flight.tlog").stat().st_size > 1000
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert printed[0] == {"t_s": pytest.approx(2.0, abs=0.2), "system_id": 1, "kind": "fault", "fault": "kill"}


def test_slots_begin_when_the_last_living_vehicle_flies_its_mission_and_tell_how_far_it_is_off() -> None:
    made = plan(EXAMPLES["minimal"]().with_changes(slots=3))
    fleet = fleet_of(SimulateConfig(plan=made))
    *rest, last = fleet.vehicles.values()
    for vehicle in fleet.vehicles.values():
        item = MissionItem(0, 3, 17, 1, 1, 0.0, 0.0, 0.0, 0.0, 0, 0, made.scenario.altitude_m)
        vehicle.autopilot.runner.load(Mission((item,)), on_ground=True)
    for vehicle in rest:
        vehicle.autopilot.set_mode(Mode.MISSION)
    fleet.step_to(1.0)
    begin_slots(fleet, made)
    before = fleet.slots
    last.autopilot.set_mode(Mode.MISSION)
    begin_slots(fleet, made)
    assert before is None
    assert fleet.slots is not None
    assert fleet.slots.start_s == fleet.now_s
    fleet.step_to(fleet.now_s + 2 * made.scenario.slot_duration_s)
    slots = fleet.truth.happened("slot", last.system_id)
    start, one, two = (made.trajectories_m[made.scenario.uav_ids[-1]][slot] for slot in range(3))
    assert [event.detail["slot"] for event in slots] == [1, 2]
    assert [event.detail["error_m"] for event in slots] == pytest.approx(
        [math.dist(start, one), math.dist(start, two)], abs=0.01
    )
