"""Plans written by hand: tracks that never rest."""

from __future__ import annotations

import random
from math import cos, sin

from skyfolio.planner import EXAMPLES, Plan, Scenario, Uav, User, plan
from skyfolio.planner.geometry import Point


def moving_plan(uavs: int = 3, slots: int = 12, slot_s: float = 5.0) -> Plan:
    """Tracks with legs of 5 to 25 m that turn by about 20 degrees at each slot, hovering now and then."""
    paths = {f"uav-{n}": _track(n, slots) for n in range(1, uavs + 1)}
    scenario = EXAMPLES["paper"]().with_changes(
        slots=slots,
        slot_duration_s=slot_s,
        area_m=((-5000.0, -5000.0), (5000.0, 5000.0)),
        uavs=tuple(Uav(id=uav, start_m=path[0], max_speed_mps=5.0) for uav, path in paths.items()),
        users=(User(id="user-1", position_m=(0.0, 0.0)),),
    )
    return by_hand(scenario, paths)


def _track(seed: int, slots: int) -> list[Point]:
    chance = random.Random(seed)  # noqa: S311
    path, heading = [(400.0 * seed, 0.0)], 0.0
    for _ in range(slots - 1):
        east, north = path[-1]
        if chance.random() >= 0.15:
            heading += chance.gauss(0, 0.35)
            leg = chance.uniform(5.0, 25.0)
            east, north = east + leg * sin(heading), north + leg * cos(heading)
        path.append((east, north))
    return path


def by_hand(scenario: Scenario, paths: dict[str, list[Point]]) -> Plan:
    """Return a plan that flies these paths: the planned paper scenario with the paths replaced."""
    planned = plan(EXAMPLES["paper"]())
    return planned.model_copy(update={"scenario": scenario, "trajectories_m": paths})
