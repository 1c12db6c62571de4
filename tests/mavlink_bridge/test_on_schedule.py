"""Compiled missions flown by the simulator in virtual time: where is the vehicle when each slot ends?"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import cos, hypot, sin
from statistics import mean

import pytest

from mavlink_bridge import Mission, OnEnd, compile_mission, east_north_to_geodetic, geodetic_to_east_north
from planner.plans import Plan
from sim import Fleet, Mode, VehicleSpec, VirtualClock
from sim import Mission as SimMission
from sim import MissionItem as SimItem

PlanOf = Callable[..., Plan]
Path = list[tuple[float, float]]


def wander(seed: int, *, hover: float, turn_rad: float, slots: int = 20, reach_m: float = 25.0) -> Path:
    """Legs of 5 to 25 m that turn by a normal deviate of `turn_rad`, hovering with probability `hover`."""
    chance = random.Random(seed)
    path, heading = [(0.0, 0.0)], 0.0
    for _ in range(slots - 1):
        east, north = path[-1]
        if chance.random() >= hover:
            heading += chance.gauss(0, turn_rad)
            leg = chance.uniform(0.2, 1.0) * reach_m
            east, north = east + leg * sin(heading), north + leg * cos(heading)
        path.append((east, north))
    return path


def distances_at_slot_ends(plan: Plan, mission: Mission) -> list[float]:
    """Metres from the plan's point at the beginning of slots 1, 2, ..., flown from a hover at the slot-0 point."""
    origin = plan.scenario.origin
    (path,) = plan.trajectories_m.values()
    clock = VirtualClock()
    fleet = Fleet([VehicleSpec(1, *east_north_to_geodetic(origin, *path[0]))], clock=clock)
    vehicle = fleet.vehicles[1]
    autopilot = vehicle.autopilot
    autopilot.arm()
    autopilot.takeoff(plan.scenario.altitude_m)
    fleet.step_to(clock.advance(40.0))
    items = tuple(SimItem(**{name: getattr(item, name) for name in FIELDS}) for item in mission.items)
    autopilot.runner.load(SimMission(items), on_ground=False)
    autopilot.jump(1)
    autopilot.set_mode(Mode.MISSION)
    distances = []
    for east, north in path[1:]:
        fleet.step_to(clock.advance(plan.scenario.slot_duration_s))
        lat_deg, lon_deg, _ = vehicle.position
        at = geodetic_to_east_north(origin, lat_deg, lon_deg)
        distances.append(hypot(at[0] - east, at[1] - north))
    return distances


FIELDS = (
    *("seq", "frame", "command", "current", "autocontinue"),
    *("param1", "param2", "param3", "param4", "x", "y", "z"),
)


@pytest.mark.parametrize(
    ("hover", "turn_rad"),
    [(0.0, 0.0), (0.0, 0.3), (0.0, 1.5), (0.3, 0.3), (0.15, 1.0)],
    ids=["straight", "smooth", "corners", "hovering", "everything"],
)
def test_slot_ends_are_met_within_metres(plan_of: PlanOf, hover: float, turn_rad: float) -> None:
    distances = []
    for seed in range(5):
        plan = plan_of({"uav-1": wander(seed, hover=hover, turn_rad=turn_rad)})
        distances += distances_at_slot_ends(plan, compile_mission(plan, "uav-1", on_end=OnEnd.HOLD))
    assert mean(distances) < 2.0
    assert max(distances) < 7.5
