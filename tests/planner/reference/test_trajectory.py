"""Eqs. (14)-(21): each surrogate equals the true function where it is expanded and bounds it elsewhere."""

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.planner.arrays import Array
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.reference.trajectory import UNIT_M, _distance_bounds, _separation, steered, surrogate_rates
from skyfolio.planner.sinr import spectral_efficiency

seeds = st.integers(0, 2**32 - 1)


def drawn(seed: int) -> tuple[Problem, Array, Array, Array]:
    """A random problem, an allocation a b (U, K, N), an expansion point and a point elsewhere (U, N, 2)."""
    rng = np.random.default_rng(seed)
    problem = problem_of(scattered(3, 4, 3, seed=seed % 1000))
    problem = replace(problem, snr_gain=problem.snr_gain * 10 ** rng.uniform(-2, 3))
    allocated = rng.uniform(0, 10_000, (3, 4, 3)) * rng.integers(0, 2, (3, 4, 3))
    here = rng.uniform(problem.low_m, problem.high_m, (3, 3, 2))
    there = here + rng.normal(size=here.shape) * 10 ** rng.uniform(-2, 2.5)
    return problem, allocated, here, there


def eq_16(problem: Problem, allocated: Array, snr: Array, lower: Array, upper: Array) -> Array:
    """sum_u a b f_eta in NumPy, term by term as printed; every array (U, K, N), kbit/s."""
    total = np.zeros(allocated.shape[1:])
    for u in range(problem.n_uavs):
        others = [i for i in range(problem.n_uavs) if i != u]
        at_expansion = snr[others].sum(axis=0) + 1
        f = np.log2((snr * lower).sum(axis=0) + 1) - np.log2(at_expansion)
        f -= (snr[others] * (upper[others] - 1)).sum(axis=0) / (at_expansion * np.log(2))
        total += allocated[u] / 1e3 * f
    return total


def cvxpy_eq_16(allocated: Array, snr: Array, lower: Array, upper: Array) -> Array:
    flat = [x.reshape(len(x), -1) for x in (allocated, snr)]
    parameters = [cp.Constant(x.reshape(len(x), -1)) for x in (lower, upper)]
    value: Array = surrogate_rates(flat[0], flat[1], *parameters).value
    return value.reshape(allocated.shape[1:])


@given(seeds)
def test_the_rate_surrogate_is_exact_at_its_expansion_point(seed: int) -> None:
    problem, allocated, here, _ = drawn(seed)
    snr = problem.snr_gain / problem.distances2(here)
    one = np.ones_like(snr)
    true = (allocated * spectral_efficiency(problem, here)).sum(axis=0) / 1e3
    assert cvxpy_eq_16(allocated, snr, one, one) == pytest.approx(true, rel=1e-9, abs=1e-9)


@given(seeds)
def test_the_rate_surrogate_is_below_the_rate_elsewhere_and_cvxpy_agrees_with_numpy(seed: int) -> None:
    problem, allocated, here, there = drawn(seed)
    now2 = problem.distances2(here)
    then2 = problem.distances2(there)
    linear2 = now2 + 2 * np.einsum(
        "uknd,uknd->ukn",
        here[:, None] - problem.user_m,
        np.broadcast_to((there - here)[:, None], (3, 4, 3, 2)),
    )
    allowed = linear2 > 0  # where (20) can hold at all
    lower = np.maximum(2 - then2 / now2, 0.0)  # (19) with equality
    upper = now2 / np.where(allowed, linear2, now2)  # (20) with equality
    assert (lower <= now2 / then2 + 1e-12).all(), "eta_lower is below d^-2 (15)"
    assert (np.where(allowed, upper, np.inf) >= now2 / then2 * (1 - 1e-12)).all(), "eta_upper is above d^-2 (15)"
    snr = problem.snr_gain / now2
    surrogate = eq_16(problem, allocated, snr, lower, upper)
    assert cvxpy_eq_16(allocated, snr, lower, upper) == pytest.approx(surrogate, rel=1e-9, abs=1e-6)
    true = (allocated * spectral_efficiency(problem, there)).sum(axis=0) / 1e3
    usable = allowed.all(axis=0)
    assert (surrogate <= true + 1e-6)[usable].all()


@given(seeds)
def test_the_distance_surrogates_hold_with_equality_at_their_expansion_point_and_imply_eq_15_elsewhere(
    seed: int,
) -> None:
    problem, _, here, there = drawn(seed)
    users, slots = (index.ravel() for index in np.indices((4, 3)))
    now2 = problem.distances2(here)[0, users, slots]
    then2 = problem.distances2(there)[0, users, slots]
    tight = [cp.Constant(np.ones(12)), cp.Constant(np.ones(12))]
    for constraint in _bounds(problem, here, here[0], (users, slots), *tight):
        left, right = (np.broadcast_to(side.value, 12) for side in constraint.args)
        assert left == pytest.approx(right, rel=1e-9), "equal at the expansion point"
    lower = cp.Constant(now2 / then2 * (1 + 1e-6))
    upper = cp.Constant(now2 / then2 * (1 - 1e-6))
    nineteen, twenty = _bounds(problem, here, there[0], (users, slots), lower, upper)
    assert (nineteen.violation() > 0).all(), "no eta_lower above d^-2 satisfies (19)"
    assert (twenty.violation() > 0).all(), "no eta_upper below d^-2 satisfies (20)"


def _bounds(problem: Problem, here: Array, at: Array, pairs: Any, lower: Any, upper: Any) -> list[cp.Constraint]:
    q = cp.Variable(at.shape)
    q.value = at / UNIT_M
    return _distance_bounds(problem, 0, here[0], pairs, q, lower, upper)


@given(seeds)
def test_the_separation_surrogate_is_exact_at_its_expansion_point_and_implies_d_min_elsewhere(seed: int) -> None:
    problem, _, here, there = drawn(seed)
    problem = replace(problem, separation_m=120.0)
    q = [cp.Variable((3, 2)) for _ in range(3)]
    for points, known in ((here, True), (there, False)):
        for variable, path in zip(q, points, strict=True):
            variable.value = path / UNIT_M
        for (u, j), constraint in zip(((0, 1), (0, 2), (1, 2)), _separation(problem, here, q), strict=True):
            apart = np.linalg.norm(points[u] - points[j], axis=1)[1:]
            holds = np.atleast_1d(constraint.violation()) <= 0
            assert (apart[holds] >= problem.separation_m - 1e-6).all()
            if known:
                assert (holds == (apart >= problem.separation_m)).all()


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
def test_one_step_of_a7_does_not_lower_the_true_objective(kind: str) -> None:
    problem = replace(problem_of(scattered(2, 3, 4, seed=3)), kind=kind, mu=-0.1)
    allocated = np.full((2, 3, 4), 10_000 / 3)
    before = allocated * spectral_efficiency(problem, problem.hover())
    paths = steered(problem, allocated, problem.hover())
    after = allocated * spectral_efficiency(problem, paths)
    assert after.sum(axis=0).mean() > before.sum(axis=0).mean()
    assert np.linalg.norm(np.diff(paths, axis=1), axis=2).max() <= 25.0
