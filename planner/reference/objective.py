"""The objective of problems (a4), (a5) and (a7) as a cvxpy expression, and the solver call they share."""

from __future__ import annotations

import warnings

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem

Array = NDArray[np.float64]


class SubproblemError(RuntimeError):
    """The interior point method gave no usable answer; the caller keeps the iterate it had."""


def concave_utility(problem: Problem, rates_kbps: cp.Expression) -> cp.Expression:
    """(1/mu) log E_n[exp(mu sum_k R_k[n])] of eq. (9), concave by Lemma 1, for rates (K, N) in kbit/s.

    At mu = 0 it is the mean of the sum rate (SR-Max). Slots flown before are constants inside the expectation.
    """
    per_slot = cp.sum(rates_kbps, axis=0)
    return soft_mean(per_slot, problem.past_kbps.sum(axis=0), problem.mu)


def soft_mean(values: cp.Expression, past: Array, mu: float) -> cp.Expression:
    """(1/mu) log mean exp(mu x) over the planned `values` and the `past` ones."""
    count = values.size + past.size
    if mu == 0.0:
        return (cp.sum(values) + past.sum()) / count
    together = cp.hstack([cp.vec(values, order="C"), past.ravel()]) if past.size else values
    return (cp.log_sum_exp(mu * together) - np.log(count)) / mu


def solve(objective: cp.Expression, constraints: list[cp.Constraint]) -> float:
    """Maximise by Clarabel's interior point method; the value.

    Raises SubproblemError when no (even inaccurate) optimum is found. The caller evaluates the true objective before
    it accepts the point, so an inaccurate one does no harm.
    """
    task = cp.Problem(cp.Maximize(objective), constraints)
    try:
        with warnings.catch_warnings():  # an inaccurate optimum is accepted on purpose, see above
            warnings.filterwarnings("ignore", message="Solution may be inaccurate")
            task.solve(solver=cp.CLARABEL, ignore_dpp=True, canon_backend=cp.SCIPY_CANON_BACKEND)
    except cp.SolverError as error:
        raise SubproblemError(str(error)) from error
    if task.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise SubproblemError(f"Clarabel says {task.status}")
    return float(task.value)
