"""Users that ask for no more than some rate: more is worth nothing to them, and the band goes to others."""

from __future__ import annotations

from itertools import product
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from pydantic import ValidationError

from skyfolio.planner import Plan, Scenario, User, Utility, explain, plan, replan, violations
from skyfolio.planner.arrays import Array
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.examples import minimal
from skyfolio.planner.fast.arena import Arena, arena_of
from skyfolio.planner.fast.enumerating import try_all
from skyfolio.planner.fast.exchange import exchange, share_slot
from skyfolio.planner.fast.market import enter_slot, fill, market_of
from skyfolio.planner.layouts import scattered
from skyfolio.planner.methods import METHODS
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.utility import utility_kbps

pytestmark = pytest.mark.long

KINDS = ("sum", "per_user", "pooled")


def asking(
    seed: int, n_uavs: int, n_users: int, n_slots: int, kind: str = "sum", mu: float = -0.1, **more: Any
) -> Scenario:
    """Return users of whom two of three ask for 1 to 40 kbit/s, some with weights and minimum rates."""
    rng = np.random.default_rng(seed)
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    plain = scattered(n_uavs, n_users, n_slots, seed=seed % 1000, utility=utility)

    def asks(k: int, user: User) -> User:
        demand = {"demand_bps": float(40e3 ** rng.uniform(0.65, 1.0))} if k % 3 else {}
        return user.model_copy(update=demand | ({"weight": 2.0} if k % 4 == 1 else {}) | more)

    return plain.with_changes(users=tuple(asks(k, user) for k, user in enumerate(plain.users)))


def utility_by_hand(made: Plan, before: Array | None = None) -> float:
    users = made.scenario.users
    asked = np.array([np.inf if user.demand_bps is None else user.demand_bps for user in users])[:, None]
    rates = np.array(list(made.user_rates_bps.values()))
    rates = rates if before is None else np.hstack([before, rates])
    weights = np.array([user.weight or 1.0 for user in users])
    utility = made.scenario.utility
    return utility_kbps(np.minimum(rates, asked) / 1e3, utility.kind, utility.mu_per_kbps, weights) * 1e3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", sorted(set(METHODS) - {"areas", "paper"}))
def test_no_band_is_spent_beyond_what_users_ask_for(kind: str, method: str) -> None:
    made = plan(asking(7, 3, 7, 5, kind), method=method, n_starts=2)
    assert violations(made) == []
    if method != "sr_max":
        assert made.summary.utility_bps == pytest.approx(utility_by_hand(made), rel=1e-9)
    if method in {"fast", "static"}:
        assert made.history[-1].utility_bps == pytest.approx(made.summary.utility_bps, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_in_a_wide_fleet_too_what_is_counted_is_what_is_reported(kind: str) -> None:
    made = plan(asking(3, 4, 40, 5, kind), n_starts=2)
    assert violations(made) == []
    assert made.history[-1].utility_bps == pytest.approx(made.summary.utility_bps, rel=1e-9)
    assert made.summary.utility_bps == pytest.approx(utility_by_hand(made), rel=1e-9)


def _best_by_hand(problem: Problem, efficiency: Array, mu: float, weights: Array) -> float:
    """Return the least sum_k w_k exp(mu min(r_k, d_k)), or of -w_k min(r_k, d_k) at mu = 0, over all associations.

    efficiency: (U, K) bit/s/Hz. Bands by Clarabel for each association.
    """
    least = np.inf
    kilohertz = problem.bandwidth_hz / 1e3
    for serving in product(range(problem.n_uavs), repeat=problem.n_users):
        own = efficiency[list(serving), range(problem.n_users)]
        band = cp.Variable(problem.n_users, nonneg=True)
        rate = cp.multiply(own, band)
        limits = [cp.sum(band[np.array(serving) == u]) <= kilohertz[u] for u in range(problem.n_uavs) if u in serving]
        asked = np.flatnonzero(np.isfinite(problem.demand_kbps))
        limits += [rate[k] <= problem.demand_kbps[k] for k in asked]
        worth = -cp.sum(cp.multiply(weights, rate)) if mu == 0.0 else cp.sum(cp.multiply(weights, cp.exp(mu * rate)))
        task = cp.Problem(cp.Minimize(worth), limits)
        task.solve(solver=cp.CLARABEL)
        least = min(least, float(task.value))
    return least


def _slot(arena: Arena, eff: Array, log_weight: Array, serving: Any, khz: Array, every: Any) -> float:
    market = market_of(arena, log_weight)
    market.eff[:] = eff
    enter_slot(arena, market, 0)
    share_slot(market, serving, khz)
    exchange(market, serving, khz)
    if every:
        try_all(market, serving, khz)
    cost = 0.0
    for u in range(eff.shape[1]):
        market.size[u] = 0
        for k in range(serving.shape[0]):
            if serving[k] == u:
                market.member[u, market.size[u]] = k
                market.size[u] += 1
        fill(market, u, khz)
        cost += market.cost[u]
    return cost


slot = njit(_slot)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(6))
def test_one_slot_is_shared_as_well_as_by_trying_every_association(kind: str, seed: int) -> None:
    mu = 0.0 if kind == "sum" else -0.1
    problem = problem_of(asking(seed, 2, 5, 2, kind, mu))
    efficiency = spectral_efficiency(problem, problem.hover())[:, :, 0]
    weights = problem.weight if kind != "per_user" else np.random.default_rng(seed).uniform(0.2, 3.0, 5)
    serving, khz = efficiency.argmax(axis=0).astype(np.int64), np.zeros(5)
    cost = slot(arena_of(problem), np.ascontiguousarray(efficiency.T), np.log(weights), serving, khz, np.bool_(True))
    assert cost == pytest.approx(_best_by_hand(problem, efficiency, mu, weights), rel=1e-5)
    rates = khz * efficiency[serving, range(5)]
    assert (rates <= problem.demand_kbps * (1 + 1e-9)).all()
    for u in range(2):
        assert khz[serving == u].sum() <= problem.bandwidth_hz[u] / 1e3 * (1 + 1e-12)


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.sampled_from(["sum", "pooled"]))
def test_moves_and_exchanges_come_near_the_best_of_all_associations(seed: int, kind: str) -> None:
    problem = problem_of(asking(seed, 2, 6, 2, kind, 0.0 if kind == "sum" else -0.1))
    efficiency = np.ascontiguousarray(spectral_efficiency(problem, problem.hover())[:, :, 0].T)
    arena, log_weight, first = arena_of(problem), np.log(problem.weight), efficiency.argmax(axis=1).astype(np.int64)
    near = slot(arena, efficiency, log_weight, first.copy(), np.zeros(6), np.bool_(False))
    best = slot(arena, efficiency, log_weight, first.copy(), np.zeros(6), np.bool_(True))
    assert best <= near + 1e-9
    assert near - best <= 0.05 * abs(best)


def test_what_one_leaves_the_other_gets() -> None:
    scenario = minimal()
    uav = scenario.uavs[0].model_copy(update={"max_speed_mps": 0.0})
    users = (
        User(id="little", position_m=(40.0, 50.0), demand_bps=2000.0),
        User(id="all", position_m=(60.0, 50.0)),
    )
    for kind in KINDS:
        utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.01})
        made = plan(scenario.with_changes(users=users, uavs=(uav,), utility=utility))
        assert sum(made.bandwidth_hz[user][1] for user in ("little", "all")) == pytest.approx(uav.bandwidth_hz)
        assert made.user_rates_bps["all"][1] > 10 * made.user_rates_bps["little"][1]
        if kind != "sum":  # both are equally near: who of them gets a kilohertz is all the same to a sum
            assert made.user_rates_bps["little"] == pytest.approx([2000.0] * 4, rel=1e-6)


def test_band_that_nobody_asks_for_stays_free() -> None:
    users = tuple(user.model_copy(update={"demand_bps": 1000.0}) for user in minimal().users)
    for kind in KINDS:
        utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.1})
        made = plan(minimal().with_changes(users=users, utility=utility))
        for row in made.user_rates_bps.values():
            assert row == pytest.approx([1000.0] * 4, rel=1e-9)
        assert made.summary.gap == pytest.approx(0.0, abs=1e-9)
        assert sum(row[0] for row in made.bandwidth_hz.values()) < 2_000
        found = explain(made)
        assert {row.level for row in found.users} == {"satisfied"}
        assert all(row.reasons == () for row in found.users)


@pytest.mark.parametrize("kind", KINDS)
def test_a_demand_that_is_never_met_changes_little(kind: str) -> None:
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.1})
    scenario = minimal().with_changes(utility=utility)
    high = tuple(user.model_copy(update={"demand_bps": 1e9}) for user in scenario.users)
    asked, free = plan(scenario.with_changes(users=high)), plan(scenario)
    assert asked.summary.utility_bps == pytest.approx(free.summary.utility_bps, rel=2e-3)


def test_flying_keeps_what_users_asked_for_and_leaves_more_for_the_others() -> None:
    for kind in KINDS:
        still = plan(asking(11, 3, 7, 8, kind), method="static")
        flown = plan(asking(11, 3, 7, 8, kind))
        assert flown.summary.utility_bps > still.summary.utility_bps * 1.02


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from(KINDS), st.integers(1, 5))
def test_no_plan_is_better_than_its_bound(seed: int, kind: str, n_uavs: int) -> None:
    made = plan(asking(seed, n_uavs, 5, 4, kind), n_starts=2)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps * (1 + 1e-9)
    assert made.summary.utility_bps == pytest.approx(utility_by_hand(made), rel=1e-9)
    assert violations(made) == []


@pytest.mark.parametrize("kind", KINDS)
def test_branch_and_bound_proves_at_least_what_is_planned(kind: str) -> None:
    made = plan(asking(5, 2, 4, 4, kind))
    rates = np.array(list(made.user_rates_bps.values())) / 1e3
    proof = certificate(problem_of(made.scenario), rates, tolerance=0.01, max_nodes=100_000)
    assert made.summary.utility_bps / 1e3 <= proof.bound_kbps * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("price", [0.0, 3.0])
def test_replans_cut_the_past_too(kind: str, price: float) -> None:
    first = plan(asking(7, 3, 6, 8, kind))
    achieved = {user: [rate * 1.5 for rate in row[:3]] for user, row in first.user_rates_bps.items()}
    second = replan(first, failed=["uav-3"], at_slot=3, disruption_weight=price, achieved_rates_bps=achieved)
    assert violations(second) == []
    assert second.summary.utility_bps == pytest.approx(
        utility_by_hand(second, np.array(list(achieved.values()))), rel=1e-9
    )


@pytest.mark.parametrize("kind", KINDS)
def test_minimum_rates_and_demands_hold_together(kind: str) -> None:
    made = plan(asking(7, 3, 6, 5, kind, min_rate_bps=1000.0))
    assert made.status == "succeeded"
    assert violations(made) == []
    same = tuple(user.model_copy(update={"min_rate_bps": 1000.0, "demand_bps": 1000.0}) for user in made.scenario.users)
    exact = plan(made.scenario.with_changes(users=same))
    for row in exact.user_rates_bps.values():
        assert row == pytest.approx([1000.0] * 5, rel=1e-7)


def test_the_checker_finds_band_beyond_what_is_asked_for() -> None:
    made = plan(asking(7, 2, 5, 4))
    user = next(one for one in made.scenario.users if one.demand_bps)
    rates = {**made.user_rates_bps, user.id: [(user.demand_bps or 0.0) * 1.001] * 4}
    found = violations(made.model_copy(update={"user_rates_bps": rates}))
    assert {(one.constraint, one.where.split()[0]) for one in found} == {("demand", user.id)}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"demand_bps": 0.0}, "demand_bps"),
        ({"demand_bps": 10.0, "min_rate_bps": 20.0}, r"demand_bps: 10\.0 must be at least min_rate_bps, 20\.0"),
    ],
)
def test_what_is_wrong_with_a_demand_is_said_by_field_and_rule(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        User.model_validate({"id": "u", "position_m": [0.0, 0.0], **fields})
