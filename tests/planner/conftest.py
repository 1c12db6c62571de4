"""Small problems with an optimum worked by hand, and random ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import settings

from skyfolio.planner import EXAMPLES, Channel, Origin, Plan, Scenario, Uav, User, Utility, plan
from skyfolio.planner.problem import Problem, problem_of

settings.register_profile("planner", deadline=None)  # the first example may wait for a compiler
settings.load_profile("planner")

ProblemOf = Callable[..., Problem]


@pytest.fixture(scope="module")
def flown() -> Plan:
    """The letter's scenario under `per_user`, planned: what replans begin with."""
    scenario = EXAMPLES["paper"]().with_changes(utility=Utility(kind="per_user", mu_per_kbps=-0.1))
    return plan(scenario, n_starts=2)


@pytest.fixture(scope="session")
def two_uavs_four_users() -> Callable[..., Scenario]:
    """An instance to solve by hand: two UAVs that cannot move, 30 m apart and 8 m up, and four users.

    Users 1 and 2 stand 6 m beside the first UAV, 3 and 4 beside the second: 10 m from their own, sqrt(1000) m from the
    other. The SNR gain is 7000/3 m^2, so own and other SNR are 70/3 and 7/3, the SINR (70/3) / (7/3 + 1) = 7, and the
    rate with a UAV's whole band of 10 kHz is 10 log2(1 + 7) = 30 kbit/s: at most 60 kbit/s in each slot, however the
    bands are shared among a UAV's own two users.
    """

    def build(slots: int = 3, kind: str = "sum", mu: float = 0.0, **changes: Any) -> Scenario:
        return Scenario(
            origin=Origin(lat_deg=0.0, lon_deg=0.0),
            area_m=((-50.0, -50.0), (100.0, 50.0)),
            slots=slots,
            slot_duration_s=5.0,
            altitude_m=8.0,
            min_separation_m=4.0,
            uavs=tuple(
                Uav(id=f"uav-{u + 1}", start_m=(30.0 * u, 0.0), max_speed_mps=0.0, transmit_power_w=700 / 3)
                for u in range(2)
            ),
            users=tuple(User(id=f"user-{k + 1}", position_m=(30.0 * (k // 2), 6.0 - 12.0 * (k % 2))) for k in range(4)),
            channel=Channel(reference_gain_db=-20.0, noise_dbm=0.0),
            utility=Utility(kind=kind, mu_per_kbps=mu),
        ).with_changes(**changes)

    return build


@pytest.fixture(scope="session")
def problem_by_hand(two_uavs_four_users: Callable[..., Scenario]) -> ProblemOf:
    """The arrays of `two_uavs_four_users`."""
    return lambda **changes: problem_of(two_uavs_four_users(**changes))
