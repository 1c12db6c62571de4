"""What a kind of utility is made of: exponential expectations (eq. 7) of the rates, arranged in its own way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from skyfolio.planner.arrays import Array


class Expectation(IntEnum):
    """Over what an expectation is taken. The kernels, cvxpy and IPOPT's program each know these and no others."""

    SLOT_SUMS = 0
    EACH_USER = 1
    ALL_USERS = 2


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A utility G = scale(K) sum over rows of (1/mu) log mean exp(mu x): concave and increasing in every rate.

    rows: from a (K, M) rate table in kbit/s, NaN where a user was not there, to one row for each expectation (R, M').
    spread: from the weight of each entry of the rows, and the table's shape, to the weight of each rate (K, M).
    """

    expectation: Expectation
    rows: Callable[[Array], Array]
    spread: Callable[[Array, tuple[int, ...]], Array]
    scale: Callable[[int], float] = lambda n_users: 1.0  # noqa: ARG005
