"""What a kind of utility is made of: exponential expectations (eq. 7) of the rates, arranged in its own way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from skyfolio.planner.arrays import Array


class Expectation(IntEnum):
    """Over what an expectation is taken. The kernels, cvxpy and IPOPT's program each know these and no others."""

    SLOT_SUMS = 0
    EACH_USER = 1
    ALL_USERS = 2


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A utility G = sum over rows of scale (1/mu) log mean exp(mu x): concave and increasing in every rate.

    A user of weight w counts as w users who get the same rate, whatever the kind. weights: (K,), those of the users.
    rows: from a (K, M) rate table in kbit/s, NaN where a user was not there, and the weights to one row for each
    expectation (R, M'). spread: from the slope in each entry of the rows, the table's shape and the weights to that in
    each rate (K, M). scale: what each row counts, from the weights, (R,).
    counts: how often each entry counts in its row's mean, from the shape and the weights, of (R, M') or broadcast.
    """

    expectation: Expectation
    rows: Callable[[Array, Array], Array]
    spread: Callable[[Array, tuple[int, ...], Array], Array]
    scale: Callable[[Array], Array]
    counts: Callable[[tuple[int, ...], Array], Array] = lambda shape, weights: np.ones((1, 1))  # noqa: ARG005
