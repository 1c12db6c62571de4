"""Users that change places: what is not tried could not have helped."""

from itertools import product
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, arena_of
from skyfolio.planner.fast.exchange import _charge, exchange, share_slot
from skyfolio.planner.fast.market import Market, fill, join, market_of
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import Utility


def _charged(arena: Arena, eff: Array, log_weight: Array, serving: Any, charge: Array, price: Array) -> Array:
    """The cost of each UAV's users; into `charge` and `price` what belongs to it."""
    market: Market = market_of(arena, log_weight)
    khz = np.zeros(eff.shape[0])
    market.eff[:] = eff
    market.size[:] = 0
    for k in range(len(serving)):
        join(market, k, serving[k])
    for u in range(eff.shape[1]):
        fill(market, u, khz)
        _charge(market, u)
    charge[:], price[:] = market.charge, market.price
    return market.cost


def _exchanged(arena: Arena, eff: Array, log_weight: Array, serving: Any) -> None:
    market, khz = market_of(arena, log_weight), np.zeros(eff.shape[0])
    market.eff[:] = eff
    share_slot(market, serving, khz)
    exchange(market, serving, khz)


charged, exchanged = njit(_charged, error_model="numpy"), njit(_exchanged, error_model="numpy")


SLOTS = st.sampled_from([("per_user", False), ("per_user", True), ("sum", True)])
"""Utilities, and whether users ask for no more than some rate; under `sum` they are only exchanged where some do."""


def slot_of(seed: int, uavs: int, users: int, kind: Any, *, asking: bool) -> tuple[Arena, Array, Array, Any]:
    """A fleet's bands, and efficiencies, weights and links drawn at random; most users ask for little or much."""
    rng = np.random.default_rng(seed)
    utility = Utility(kind=kind, mu_per_kbps=float(-(10.0 ** rng.uniform(-2, 0))))
    scenario = scattered(uavs, users, 2, seed=seed % 1000, utility=utility)
    if asking:
        demands = rng.choice([1e3, 1e4, 1e5, None], users)  # type: ignore[arg-type]
        changes = [{"weight": float(rng.uniform(0.5, 3.0)), "demand_bps": demand} for demand in demands]
        asked = zip(scenario.users, changes, strict=True)
        scenario = scenario.with_changes(users=tuple(user.model_copy(update=change) for user, change in asked))
    arena = arena_of(problem_of(scenario))
    arena.khz[:] *= rng.uniform(0.1, 3.0, uavs)
    eff = rng.exponential(size=(users, uavs)) ** 2 + 1e-6
    return arena, eff, rng.normal(0.0, 2.0, users), rng.integers(0, uavs, users)


def costs(arena: Arena, eff: Array, log_weight: Array, serving: Any) -> tuple[Array, Array, Array]:
    charge, price = np.empty(eff.shape), np.empty(eff.shape[1])
    return charged(arena, eff, log_weight, serving, charge, price), charge, price


@settings(max_examples=60)
@given(st.integers(0, 2**31), st.integers(2, 4), st.integers(2, 7), SLOTS)
def test_a_change_costs_at_least_what_the_charges_say(seed: int, uavs: int, users: int, of: tuple[str, bool]) -> None:
    arena, eff, log_weight, serving = slot_of(seed, uavs, users, of[0], asking=of[1])
    cost, charge, price = costs(arena, eff, log_weight, serving)
    for u in np.unique(serving):
        lagrangian = charge[serving == u, u].sum() - price[u] * arena.khz[u]
        np.testing.assert_allclose(cost[u], lagrangian, rtol=1e-9, atol=1e-12)
    least = cost.sum() - 1e-9 * np.abs(cost).sum()
    for k, to in product(range(users), range(uavs)):
        moved = serving.copy()
        moved[k] = to
        said = charge[k, to] - charge[k, serving[k]]
        assert costs(arena, eff, log_weight, moved)[0].sum() >= least + said
    for k, other in product(range(users), repeat=2):
        u, to, swapped = serving[k], serving[other], serving.copy()
        swapped[k], swapped[other] = to, u
        said = charge[k, to] - charge[k, u] + charge[other, u] - charge[other, to]
        assert costs(arena, eff, log_weight, swapped)[0].sum() >= least + said


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(2, 3), st.integers(2, 6), SLOTS)
def test_no_move_and_no_exchange_is_left_that_helps(seed: int, uavs: int, users: int, of: tuple[str, bool]) -> None:
    arena, eff, log_weight, serving = slot_of(seed, uavs, users, of[0], asking=of[1])
    exchanged(arena, eff, log_weight, serving)
    cost = costs(arena, eff, log_weight, serving)[0]
    least = cost.sum() - 1e-9 * np.abs(cost).sum()
    for k, to in product(range(users), range(uavs)):
        moved = serving.copy()
        moved[k] = to
        assert costs(arena, eff, log_weight, moved)[0].sum() >= least
    for k, other in product(range(users), repeat=2):
        swapped = serving.copy()
        swapped[k], swapped[other] = serving[other], serving[k]
        assert costs(arena, eff, log_weight, swapped)[0].sum() >= least
