"""Users that are there only for some time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from skyfolio.planner import Plan, Scenario, User, Utility, explain, plan, replan, violations
from skyfolio.planner.arrays import Array
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.examples import minimal
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of

KINDS = ("sum", "per_user", "pooled")


def coming_and_going(
    seed: int, n_uavs: int, n_users: int, n_slots: int, kind: str = "sum", mu: float = -0.1, **more: Any
) -> Scenario:
    """Return users with windows drawn at random; some are there all the time."""
    rng = np.random.default_rng(seed)
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    plain = scattered(n_uavs, n_users, n_slots, seed=seed % 1000, utility=utility)

    def window(user: User) -> User:
        came = int(rng.integers(0, n_slots))
        gone = int(rng.integers(came + 1, n_slots + 2))
        sort = rng.integers(0, 4)
        return user.model_copy(
            update=more
            | ({"arrives_at_slot": came} if sort % 2 else {})
            | ({"leaves_at_slot": gone} if sort > 1 else {})
        )

    return plain.with_changes(users=tuple(map(window, plain.users)))


def utility_by_hand(made: Plan, before: dict[str, list[float]] | None = None) -> float:
    """Return the utility of a plan in bit/s, written out user by user and slot by slot; before: rates of the past."""
    scenario, mu = made.scenario, made.scenario.utility.mu_per_kbps / 1e3
    table: dict[str, list[float]] = {}
    for user in scenario.users:
        past = (before or {}).get(user.id, [])
        table[user.id] = [rate for n, rate in enumerate(past, start=-len(past)) if user.is_there(n)]
        table[user.id] += [made.user_rates_bps[user.id][n] for n in range(scenario.slots) if user.is_there(n)]
    everything = scenario.slots + max((len(row) for row in (before or {}).values()), default=0)
    if scenario.utility.kind == "sum":
        sums = np.array([*np.array(list((before or {"": []}).values())).sum(axis=0), *_sums(made)])
        return float(np.log(np.exp(mu * sums).mean()) / mu)
    if scenario.utility.kind == "per_user":
        return sum(
            len(row) / everything * float(np.log(np.exp(mu * np.array(row)).mean()) / mu)
            for row in table.values()
            if row
        )
    pooled = np.concatenate([np.array(row) for row in table.values()])
    return float(len(pooled) / everything * np.log(np.exp(mu * pooled).mean()) / mu)


def _sums(made: Plan) -> Array:
    sums: Array = np.array(list(made.user_rates_bps.values())).sum(axis=0)
    return sums


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("n_uavs", "n_users"), [(2, 5), (3, 2), (3, 40)])
def test_nobody_is_served_before_it_arrives_or_after_it_left(kind: str, n_uavs: int, n_users: int) -> None:
    made = plan(coming_and_going(7, n_uavs, n_users, 6, kind), n_starts=2)
    assert violations(made) == []
    for user in made.scenario.users:
        for n in range(6):
            if not user.is_there(n):
                assert made.bandwidth_hz[user.id][n] == made.user_rates_bps[user.id][n] == 0.0
    assert made.summary.utility_bps == pytest.approx(utility_by_hand(made), rel=1e-9)
    assert made.history[-1].utility_bps == pytest.approx(made.summary.utility_bps, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_window_that_holds_all_slots_changes_no_bit_of_a_plan(kind: str) -> None:
    scenario = minimal().with_changes(utility=Utility.model_validate({"kind": kind, "mu_per_kbps": -0.1}))
    always = {"arrives_at_slot": 0, "leaves_at_slot": 4}
    widened = scenario.with_changes(users=tuple(user.model_copy(update=always) for user in scenario.users))
    with_windows, without = plan(widened), plan(scenario)
    assert with_windows.trajectories_m == without.trajectories_m
    assert with_windows.bandwidth_hz == without.bandwidth_hz
    assert with_windows.summary == without.summary


def test_a_uav_goes_on_to_who_arrives_when_the_first_has_left() -> None:
    scenario = minimal().with_changes(slots=8)
    users = (
        User(id="first", position_m=(50.0, 50.0), leaves_at_slot=3),
        User(id="second", position_m=(150.0, 50.0), arrives_at_slot=5),
    )
    made = plan(scenario.with_changes(users=users, uavs=scenario.uavs[:1]))
    assert all(rate > 0 for rate in made.user_rates_bps["first"][:3])
    assert made.trajectories_m["uav-1"][7][0] > 140.0
    assert all(rate > 0 for rate in made.user_rates_bps["second"][5:])


def test_a_minimum_rate_is_owed_only_while_a_user_is_there() -> None:
    scenario = minimal()
    late = User(id="late", position_m=(60.0, 60.0), arrives_at_slot=2, min_rate_bps=1000.0)
    for kind in KINDS:
        utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.1})
        made = plan(scenario.with_changes(users=(late, *scenario.users[1:]), utility=utility))
        assert made.status == "succeeded"
        assert made.unmet_min_rate_slots == {}
        assert made.user_rates_bps["late"][:2] == [0.0, 0.0]
        assert min(made.user_rates_bps["late"][2:]) >= 1000.0 * (1 - 1e-9)


def test_the_checker_finds_who_is_served_while_it_is_not_there() -> None:
    made = plan(coming_and_going(7, 2, 5, 6))
    user = next(one for one in made.scenario.users if one.arrives_at_slot)
    served = {**made.user_rates_bps, user.id: [1.0] * 6}
    found = violations(made.model_copy(update={"user_rates_bps": served}))
    assert {one.constraint for one in found} == {"window"}
    assert found[0].where == f"{user.id} slot 0"


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from(KINDS), st.integers(1, 5))
def test_no_plan_is_better_than_its_bound(seed: int, kind: str, n_uavs: int) -> None:
    made = plan(coming_and_going(seed, n_uavs, 4, 4, kind), n_starts=2)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps * (1 + 1e-9)
    assert made.summary.utility_bps == pytest.approx(utility_by_hand(made), rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_branch_and_bound_proves_at_least_what_is_planned(kind: str) -> None:
    made = plan(coming_and_going(5, 2, 4, 4, kind))
    rates = np.array(list(made.user_rates_bps.values())) / 1e3
    proof = certificate(problem_of(made.scenario), rates, tolerance=0.01, max_nodes=100_000)
    assert made.summary.utility_bps / 1e3 <= proof.bound_kbps * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("weight", [0.0, 3.0])
def test_a_replan_counts_the_past_of_those_who_were_there(kind: str, weight: float) -> None:
    first = plan(coming_and_going(7, 3, 5, 8, kind))
    second = replan(first, failed=["uav-3"], at_slot=3, disruption_weight=weight)
    third = replan(second, at_slot=5)
    assert violations(second) == violations(third) == []
    before = {user: row[:3] for user, row in first.user_rates_bps.items()}
    assert second.summary.utility_bps == pytest.approx(utility_by_hand(second, before), rel=1e-9)
    before = {user: [*row, *second.user_rates_bps[user][:2]] for user, row in before.items()}
    assert third.summary.utility_bps == pytest.approx(utility_by_hand(third, before), rel=1e-9)
    for user, was in zip(third.scenario.users, first.scenario.users, strict=True):
        assert [user.is_there(n) for n in range(3)] == [was.is_there(n + 5) for n in range(3)]


def test_reasons_are_means_over_the_time_that_a_user_is_there() -> None:
    made = plan(coming_and_going(7, 2, 5, 6))
    for row in explain(made).users:
        user = next(one for one in made.scenario.users if one.id == row.user_id)
        there = [rate for n, rate in enumerate(made.user_rates_bps[user.id]) if user.is_there(n)]
        assert row.mean_rate_bps == pytest.approx(np.mean(there) if there else 0.0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"arrives_at_slot": 3, "leaves_at_slot": 3}, "leaves_at_slot: 3 must be greater than arrives_at_slot, 3"),
        ({"arrives_at_slot": 1.5}, "arrives_at_slot"),
    ],
)
def test_what_is_wrong_with_a_window_is_said_by_field_and_rule(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        User.model_validate({"id": "u", "position_m": [0.0, 0.0], **fields})


def test_the_letters_algorithm_refuses_what_it_does_not_know() -> None:
    with pytest.raises(ValueError, match=r"users\.\d\.\w+_at_slot: the method 'paper' does not know it"):
        plan(coming_and_going(7, 2, 5, 6), method="paper")
