"""Small plans made by hand: what the bridge needs of a plan is its scenario and its trajectories."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from planner.plans import Plan, Summary
from planner.scenario import Origin, Scenario, Uav, User

Path = Sequence[tuple[float, float]]
PlanOf = Callable[..., Plan]

ZURICH = Origin(lat_deg=47.397742, lon_deg=8.545594)


def plan_of(
    paths: dict[str, Path], *, slot_s: float = 5.0, altitude_m: float = 60.0, min_separation_m: float = 4.0
) -> Plan:
    """A plan that flies `paths` (uav id -> (n_slots, 2) metres east/north) and serves nobody in particular."""
    ids = list(paths)
    slots = len(paths[ids[0]])
    scenario = Scenario(
        origin=ZURICH,
        area_m=((-90_000.0, -90_000.0), (90_000.0, 90_000.0)),
        slots=slots,
        slot_duration_s=slot_s,
        altitude_m=altitude_m,
        min_separation_m=min_separation_m,
        uavs=tuple(Uav(id=uav, start_m=paths[uav][0], max_speed_mps=100.0) for uav in ids),
        users=(User(id="user-1", position_m=(0.0, 0.0)),),
    )
    return Plan(
        id="by-hand",
        method="by hand",
        scenario=scenario,
        trajectories_m={uav: list(path) for uav, path in paths.items()},
        association={"user-1": [ids[0]] * slots},
        bandwidth_hz={"user-1": [10_000.0] * slots},
        user_rates_bps={"user-1": [1.0] * slots},
        summary=Summary(
            utility_bps=1.0,
            mean_sum_rate_bps=1.0,
            sum_rate_variance_kbps2=0.0,
            mean_variance_eq5_bps=1.0,
            jain=1.0,
            upper_bound_bps=1.0,
            gap=0.0,
        ),
    )


@pytest.fixture(name="plan_of", scope="session")
def _plan_of() -> PlanOf:
    return plan_of


@pytest.fixture
def line_and_hover() -> Plan:
    """uav-1: two legs straight east, two hovering slots, then north, then east again; 7 slots."""
    east_then_north = [(0.0, 0.0), (20.0, 0.0), (42.0, 0.0), (42.0, 0.0), (42.0, 0.0), (42.0, 15.0), (60.0, 15.0)]
    return plan_of({"uav-1": east_then_north})
