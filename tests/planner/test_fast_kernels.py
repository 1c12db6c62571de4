"""The kernels of the fast path against scipy, cvxpy, finite differences and brute force."""

from itertools import product
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from scipy.optimize import linear_sum_assignment

from skyfolio.planner import Channel, Origin, Scenario, Uav, User, Utility
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import optimise
from skyfolio.planner.fast.arena import Arena, Links, arena_of, links_of
from skyfolio.planner.fast.climb import climb
from skyfolio.planner.fast.elementary import exp, log
from skyfolio.planner.fast.market import water_fill
from skyfolio.planner.fast.rates import gradient, link_rates, value
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solution import Solution
from skyfolio.planner.stopping import MaxIterations
from skyfolio.planner.utility import utility_kbps


def _water_fill(decay: Array, first: Array, left: float, place: Any, khz: Array) -> float:
    return water_fill(decay, first, left, place, len(place), khz)


def _value_and_slope(arena: Arena, path: Array, links: Links, slope: Array) -> float:
    rate, weight = np.empty(links.khz.shape), np.empty(links.khz.shape)
    link_rates(arena, path, links, rate)
    worth = value(arena, links, rate, np.bool_(False), weight)
    gradient(arena, path, links, weight, slope)
    return worth


def _exp(x: Array, y: Array) -> None:
    for i in range(len(x)):
        y[i] = exp(x[i])


def _log(x: Array, y: Array) -> None:
    for i in range(len(x)):
        y[i] = log(x[i])


filled = njit(_water_fill)
LOOSE = {"nnan", "reassoc", "contract", "nsz", "arcp"}
"""As the kernels that use them: what may be added up in any order must not spoil them."""
value_and_slope = njit(_value_and_slope)


def layout(
    seed: int, uavs: int, users: int, slots: int = 3, kind: str = "sum", mu: float = -0.1, **changes: Any
) -> Scenario:
    rng = np.random.default_rng(seed)
    return Scenario(
        origin=Origin(lat_deg=0.0, lon_deg=0.0),
        area_m=((0.0, 0.0), (300.0, 300.0)),
        slots=slots,
        slot_duration_s=5.0,
        altitude_m=50.0,
        min_separation_m=0.0,
        uavs=tuple(
            Uav(id=f"uav-{u}", start_m=(float(e), float(n)), bandwidth_hz=float(rng.uniform(5e3, 2e4)))
            for u, (e, n) in enumerate(rng.uniform(0, 300, (uavs, 2)))
        ),
        users=tuple(
            User(id=f"user-{k}", position_m=(float(e), float(n)))
            for k, (e, n) in enumerate(rng.uniform(0, 300, (users, 2)))
        ),
        channel=Channel(noise_dbm=-55.0, fading="sampled", seed=seed % 1000),
        utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu}),
    ).with_changes(**changes)


def rates_kbps(problem: Problem, solution: Solution) -> Array:
    efficiency = spectral_efficiency(problem, solution.paths_m)
    served: Array = np.take_along_axis(efficiency, solution.serving[None], axis=0)[0]
    return solution.bandwidth_hz * served / 1e3


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 6), st.integers(1, 6))
def test_sum_gives_each_slot_the_best_assignment_there_is(seed: int, uavs: int, users: int) -> None:
    problem = problem_of(layout(seed, uavs, users))
    solution = optimise(problem, MaxIterations(1), n_starts=1)
    pairs = problem.bandwidth_hz[:, None, None] / 1e3 * spectral_efficiency(problem, solution.paths_m)
    got = rates_kbps(problem, solution).sum(axis=0)
    for n in range(problem.n_slots):
        best = pairs[:, :, n][linear_sum_assignment(pairs[:, :, n], maximize=True)].sum()
        assert got[n] == pytest.approx(best, rel=1e-12)


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(1, 6))
def test_water_filling_is_what_cvxpy_finds(seed: int, users: int) -> None:
    rng = np.random.default_rng(seed)
    decay, log_weight, left = rng.uniform(0.05, 0.5, users), rng.normal(0, 1, users), float(rng.uniform(1, 20))
    khz = np.zeros(users)
    level = filled(decay, log_weight + np.log(decay), left, np.arange(users), khz)
    b = cp.Variable(users, nonneg=True)
    task = cp.Problem(cp.Minimize(np.exp(log_weight) @ cp.exp(cp.multiply(-decay, b))), [cp.sum(b) <= left])
    task.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    reached = float(np.exp(log_weight) @ np.exp(-decay * khz))
    assert khz.sum() == pytest.approx(left, rel=1e-12)
    assert (khz >= 0).all()
    assert reached == pytest.approx(task.value, rel=1e-6)
    worth_of_the_next = log_weight + np.log(decay) - decay * khz  # equal where there is band, no greater elsewhere
    assert worth_of_the_next[khz > 0] == pytest.approx(level, abs=1e-9)
    assert (worth_of_the_next[khz == 0] <= level + 1e-9).all()


@pytest.mark.parametrize("fastmath", [False, LOOSE])
def test_exponential_and_logarithm_are_those_of_numpy(fastmath: Any) -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-700.0, 700.0, 1000), rng.normal(0.0, 1.0, 1000), [0.0, -708.0, 709.0, 1e-9]])
    y = np.empty(len(x))
    njit(_exp, error_model="numpy", fastmath=fastmath)(x, y)
    assert y == pytest.approx(np.exp(x), rel=1e-13)
    near = np.abs(x) < 30
    assert y[near] == pytest.approx(np.exp(x[near]), rel=2e-15)
    z = np.concatenate([np.exp(x), 1.0 + rng.uniform(-1e-6, 1e-6, 1000), [1.0, 1e-300, 1e300]])
    y = np.empty(len(z))
    njit(_log, error_model="numpy", fastmath=fastmath)(z, y)
    assert y == pytest.approx(np.log(z), rel=1e-15, abs=1e-18)


def test_an_exponential_far_below_what_a_float_can_hold_is_next_to_nothing() -> None:
    y = np.empty(1)
    njit(_exp, error_model="numpy")(np.array([-1e6]), y)
    assert 0.0 <= y[0] < 1e-300


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
@pytest.mark.parametrize("mu", [0.0, -0.05])
def test_the_slope_is_that_of_the_utility(kind: str, mu: float) -> None:
    problem = problem_of(layout(5, uavs=3, users=6, kind=kind, mu=mu))
    arena = arena_of(problem)
    path = np.ascontiguousarray(problem.hover().transpose(1, 2, 0))
    links = links_of(arena)
    climb(arena, path, links, 0, 0.0)
    slope, unused = np.empty(path.shape), np.empty(path.shape)
    value_and_slope(arena, path, links, slope)
    for index in np.ndindex(path[1:].shape):
        at = (index[0] + 1, *index[1:])
        moved, step = path.copy(), 1e-4
        moved[at] += step
        above = value_and_slope(arena, moved, links, unused)
        moved[at] -= 2 * step
        below = value_and_slope(arena, moved, links, unused)
        assert slope[at] == pytest.approx((above - below) / (2 * step), abs=1e-6)
    assert (slope[0] == 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_bands_and_users_of_a_slot_are_those_of_brute_force(seed: int) -> None:
    """One slot, so `pooled` has no weights to iterate: every association, each with the best bands by cvxpy."""
    problem = problem_of(layout(seed, uavs=2, users=4, slots=1, kind="pooled", mu=-0.2))
    solution = optimise(problem, MaxIterations(1), n_starts=1)
    got = utility_kbps(rates_kbps(problem, solution), "pooled", problem.mu)
    per_khz = spectral_efficiency(problem, problem.hover())[:, :, 0]
    best = -np.inf
    share = cp.Variable(4, nonneg=True)
    served = cp.Parameter(4, nonneg=True)
    member = cp.Parameter((2, 4), nonneg=True)
    task = cp.Problem(
        cp.Minimize(cp.log_sum_exp(problem.mu * cp.multiply(served, share))),
        [member @ share <= problem.bandwidth_hz / 1e3],
    )
    for serving in product(range(2), repeat=4):
        served.value = per_khz[list(serving), range(4)]
        member.value = np.eye(2)[:, list(serving)]
        task.solve(solver=cp.CLARABEL)
        best = max(best, 4 * (task.value - np.log(4)) / problem.mu)
    assert got == pytest.approx(best, rel=1e-5)


def test_mu_0_of_every_kind_is_the_sum_rate() -> None:
    plans = [
        optimise(problem_of(layout(3, 3, 6, kind=kind, mu=0.0)), MaxIterations(5))
        for kind in ("sum", "per_user", "pooled")
    ]
    assert (plans[0].paths_m == plans[1].paths_m).all()
    assert (plans[0].bandwidth_hz == plans[2].bandwidth_hz).all()
