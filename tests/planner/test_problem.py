"""The arrays of a planning problem, and parts of them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from skyfolio.planner import Past, Scenario, Uav, User, Utility
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of

UAVS, USERS = [2, 0], [1, 4, 3]


def all_different(fading: str) -> Scenario:
    """Return four UAVs and five users of which no two are alike in anything."""
    plain = scattered(4, 5, 3, seed=1, utility=Utility(kind="per_user", mu_per_kbps=-0.1))

    def uav(u: int, one: Uav) -> Uav:
        east, north = one.start_m
        changes: dict[str, Any] = {
            "max_speed_mps": 5.0 + u,
            "bandwidth_hz": 1e4 + u,
            "transmit_power_w": 0.1 + 0.01 * u,
        }
        changes |= {"altitude_m": 60.0 + u, "end_m": (east + u, north), "leaves_at_slot": None if u == 2 else 2 + u % 2}
        return one.model_copy(update=changes)

    def user(k: int, one: User) -> User:
        changes: dict[str, Any] = {"velocity_mps": (1.0 + k, 0.0), "uncertainty_m": 1.0 + k, "min_rate_bps": 10.0 * k}
        changes |= {"weight": 1.0 + k, "demand_bps": 1e4 + k, "leaves_at_slot": 1 + k % 3}
        return one.model_copy(update=changes)

    return plain.with_changes(
        uavs=tuple(uav(u, one) for u, one in enumerate(plain.uavs)),
        users=tuple(user(k, one) for k, one in enumerate(plain.users)),
        channel=plain.channel.model_copy(update={"fading": fading, "draws": 4}),
    )


def parts(scenario: Scenario, uavs: list[int], users: list[int]) -> Problem:
    """Return the arrays of the scenario with these UAVs and users alone, after two slots."""
    past = Past(first_slot=2, rates_bps=np.arange(10.0).reshape(5, 2)[users])
    chosen = scenario.with_changes(
        uavs=tuple(scenario.uavs[u] for u in uavs), users=tuple(scenario.users[k] for k in users)
    )
    return problem_of(chosen, past)


@pytest.mark.parametrize("fading", ["mean", "sampled", "expected"])
@pytest.mark.parametrize(("uavs", "users"), [(UAVS, None), (None, USERS), (UAVS, USERS)])
def test_a_part_of_a_problem_is_the_problem_of_a_part(
    fading: str, uavs: list[int] | None, users: list[int] | None
) -> None:
    scenario = all_different(fading)
    whole = parts(scenario, [0, 1, 2, 3], [0, 1, 2, 3, 4])
    some = whole.only(
        None if uavs is None else np.array(uavs),
        None if users is None else np.array(users),
    )
    alone = parts(scenario, uavs or [0, 1, 2, 3], users or [0, 1, 2, 3, 4])
    for field in fields(Problem):
        np.testing.assert_array_equal(getattr(some, field.name), getattr(alone, field.name), err_msg=field.name)
    assert (some.snr_gain.strides[1] == 0) == (alone.snr_gain.strides[1] == 0)


def test_pins_follow_whom_they_pin_and_to_whom() -> None:
    whole = problem_of(scattered(3, 4, 2, seed=1))
    pinned_m = np.arange(12.0).reshape(3, 2, 2)
    pinned_to = np.array([[0, 2], [1, -1], [2, 2], [-1, 0]])
    some = replace(whole, pinned_m=pinned_m, pinned_to=pinned_to).only(np.array([2, 0]), np.array([0, 1, 2]))
    assert some.pinned_m.tolist() == pinned_m[[2, 0]].tolist()
    assert some.pinned_to.tolist() == [[1, 0], [-1, -1], [0, 0]]
