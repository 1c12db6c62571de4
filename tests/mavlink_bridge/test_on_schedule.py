"""Compiled missions flown by the simulator in virtual time: where is the vehicle when each slot ends?"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import cos, sin
from statistics import mean

import pytest

from skyfolio.api.lab.virtual_flight import Guidance, VirtualFlight
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.planner.plans import Plan

PlanOf = Callable[..., Plan]
Path = list[tuple[float, float]]
PX4, ARDUPILOT = Autopilot.PX4, Autopilot.ARDUPILOT


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


def distances(plan_of: PlanOf, autopilot: Autopilot, guidance: Guidance, hover: float, turn_rad: float) -> list[float]:
    """Metres from the plan at slot ends, over two flights."""
    found: list[float] = []
    for seed in range(2):
        plan = plan_of({"uav-1": wander(seed, hover=hover, turn_rad=turn_rad)}, altitude_m=15.0)
        found += VirtualFlight(plan, "uav-1", autopilot).fly(guidance).distances_m
    return found


@pytest.mark.parametrize(
    ("hover", "turn_rad"),
    [(0.0, 0.0), (0.0, 0.3), (0.0, 1.5), (0.3, 0.3), (0.15, 1.0)],
    ids=["straight", "smooth", "corners", "hovering", "everything"],
)
def test_slot_ends_are_met_within_metres_without_any_keeper(plan_of: PlanOf, hover: float, turn_rad: float) -> None:
    found = distances(plan_of, PX4, "mission", hover, turn_rad)
    assert mean(found) < 2.5  # the first leg is budgeted for a jerk limit that the simulated PX4 does not have
    assert max(found) < 7.5


@pytest.mark.parametrize("autopilot", list(Autopilot))
@pytest.mark.parametrize(("hover", "turn_rad"), [(0.0, 0.3), (0.3, 0.3)], ids=["smooth", "hovering"])
def test_the_keeper_keeps_both_autopilots_on_the_clock(
    plan_of: PlanOf, autopilot: Autopilot, hover: float, turn_rad: float
) -> None:
    found = distances(plan_of, autopilot, "keeper", hover, turn_rad)
    assert mean(found) < 2.0
    assert max(found) < 8.0


def test_a_naive_arducopter_is_late_and_ours_is_not(plan_of: PlanOf) -> None:
    naive = distances(plan_of, ARDUPILOT, "naive", 0.0, 0.3)
    ours = distances(plan_of, ARDUPILOT, "mission", 0.0, 0.3)
    assert mean(naive) > 10.0  # as measured on the real one, which the simulator is calibrated to
    assert mean(ours) < mean(naive) / 4


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_streamed_setpoints_are_met_within_a_metre(plan_of: PlanOf, autopilot: Autopilot) -> None:
    found = distances(plan_of, autopilot, "stream", 0.15, 0.3)
    assert mean(found) < 0.5
    assert max(found) < 3.0


def test_few_orders_are_enough(plan_of: PlanOf) -> None:
    plan = plan_of({"uav-1": wander(1, hover=0.0, turn_rad=0.3)}, altitude_m=15.0)
    flown = VirtualFlight(plan, "uav-1", PX4).fly("keeper")
    assert 0 < flown.orders < 19 * 10  # less than one in each half second
