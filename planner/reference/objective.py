"""The objective of problems (a4), (a5) and (a7) as a cvxpy expression, and the solver call they share."""

from __future__ import annotations

import warnings

import cvxpy as cp
import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.utilities import Expectation, kind_of

SHORTFALL_PRICE = 1e3
"""What a kbit/s below a minimum rate costs in kbit/s of utility: more than it can ever gain."""
MIN_RATE_MARGIN = 1e-6
"""Minimum rates are asked for this much (relatively) above what is wanted, for the interior point method's rounding."""


ATTEMPTS: tuple[dict[str, float], ...] = ({}, {"max_step_fraction": 0.9})
"""Clarabel's settings, and those for a second try where it loses its footing."""


class SubproblemError(RuntimeError):
    """The interior point method returned no usable solution; the caller keeps its iterate."""


def concave_utility(problem: Problem, rates_kbps: cp.Expression) -> cp.Expression:
    """Return the utility of rates (K, N) in kbit/s; concave by Lemma 1, and at mu = 0 the mean sum rate (SR-Max).

    `sum` is (1/mu) log E_n[exp(mu sum_k R_k[n])] of eq. (9); `per_user` and `pooled` as in `planner.utility`. Slots
    flown before are constants inside the expectation.
    """
    past = problem.past_kbps
    counted = rates_kbps[:, problem.counted_from :]
    expectation = kind_of(problem.kind).expectation
    if expectation == Expectation.SLOT_SUMS or problem.mu == 0.0:
        per_slot = cp.reshape(cp.sum(counted, axis=0), (1, counted.shape[1]), order="C")
        return cp.sum(_soft_means(per_slot, np.nansum(past, axis=0, keepdims=True), problem.mu))
    if expectation == Expectation.EACH_USER:
        return cp.sum(_soft_means(counted, past, problem.mu))
    flat = cp.reshape(counted, (1, counted.size), order="C")
    return problem.n_users * cp.sum(_soft_means(flat, past.reshape(1, -1), problem.mu))


def _soft_means(values: cp.Expression, past: Array, mu: float) -> cp.Expression:
    """Return (1/mu) log mean exp(mu x) of each row over the planned `values` (R, N) and the `past` ones (R, M).

    NaN in the past means that the user was not there, as in `planner.utility.soft_means`.
    """
    count = values.shape[1] + np.isfinite(past).sum(axis=1)
    everything = values.shape[1] + past.shape[1]
    if mu == 0.0:
        return (cp.sum(values, axis=1) + np.nansum(past, axis=1)) / everything
    gone = np.where(np.isfinite(past), past, -1e3 / mu)  # exp(mu x) is 0
    together = cp.hstack([values, gone]) if past.size else values
    return cp.multiply(count / everything, cp.log_sum_exp(mu * together, axis=1) - np.log(count)) / mu


def maximise_with_least_rates(
    problem: Problem, rates_kbps: cp.Expression, least_kbps: Array, constraints: list[cp.Constraint]
) -> None:
    """Maximise the utility of `rates_kbps` (K, N); rates fall below `least_kbps` (K, N) only where unavoidable.

    The exact penalty of the shortfall keeps the problem solvable where not every minimum can be met. Raises
    SubproblemError as `solve` does.
    """
    utility = concave_utility(problem, rates_kbps)
    users = np.flatnonzero(least_kbps.max(axis=1) > 0)
    if len(users):
        shortfall = cp.Variable((len(users), problem.n_slots), nonneg=True)
        constraints = [*constraints, rates_kbps[users] + shortfall >= least_kbps[users] * (1 + MIN_RATE_MARGIN)]
        utility = utility - SHORTFALL_PRICE * cp.sum(shortfall)
    solve(utility, constraints)


def least_rates(problem: Problem) -> Array:
    """Return the minimum rate of each user in each slot: (K, N) kbit/s."""
    return np.repeat(problem.min_kbps[:, None], problem.n_slots, axis=1)


def solve(objective: cp.Expression, constraints: list[cp.Constraint]) -> float:
    """Maximise by Clarabel's interior point method, and return the value.

    Raises SubproblemError when no (even inaccurate) optimum is found. The caller evaluates the true objective before
    it accepts the point, so an inaccurate one does no harm.
    """
    task = cp.Problem(cp.Maximize(objective), constraints)
    said = ""
    for settings in ATTEMPTS:
        try:
            with warnings.catch_warnings():  # an inaccurate optimum is accepted on purpose, see above
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                task.solve(solver=cp.CLARABEL, ignore_dpp=True, canon_backend=cp.SCIPY_CANON_BACKEND, **settings)
        except cp.SolverError as error:
            said = str(error)
            continue
        if task.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
            return float(task.value)
        said = f"Clarabel says {task.status}"
    raise SubproblemError(said)
