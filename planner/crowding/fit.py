"""Which kappa proves most: steps of linear programs over mixtures of Bessel functions.

What a slot is worth at most under kappa is the greatest, over mixes of assignments, of a function that is linear in the
weights of kappa; each mix that the steps of a field come to is a cut below it. The next weights are the best ones under
the last cuts, not far from the best so far (a bundle method with a trust region).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog
from scipy.special import j0

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.repulsion import repulsion_of
from skyfolio.planner.crowding.slots import Slot

FREQUENCIES = 24
SPACING = 0.8
"""Of the frequencies, so that pi / SPACING spans are the period of the slowest."""
CUTS = 12
TRUST, DISTRUST = 0.3, 0.6
"""How far a weight may move, as a share of the greatest, and what becomes of that when nothing was gained."""
AGE = 20
"""Of a field whose kappa is a new one: its steps are neither long nor short."""


def sharpened(
    field: Field,
    slot: Slot,
    rounds: int,
    steps: int,
    *,
    close: bool = False,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[float, Field]:
    """Return the least bound of the slot that is found under this and `rounds` more kappas, and the field of the best.

    steps: of the field under each.
    """
    ground = field.ground
    frequency, distance = frequencies(ground.span), looked_at(ground.span)
    waves, ceiling = j0(np.outer(distance, frequency)), 1.0 / (1.0 + distance**2)
    least, best = field.improve(slot, steps, close=close), field
    radius = TRUST * float(field.repulsion.weight.max())
    slopes: list[Array] = []
    offsets: list[float] = []
    for _ in range(rounds):
        if stop():
            break
        slopes = [*slopes, field.half_square - 0.5 * _norm2(field, frequency)][-CUTS:]
        offsets = [*offsets, field.bare][-CUTS:]
        weight = _best_weight(slopes, offsets, waves, ceiling, best.repulsion.weight, radius)
        field = field.under(repulsion_of(frequency, weight, ground.span, ground.rings), AGE)
        found = field.improve(slot, steps, close=close)
        if found < least:
            least, best = found, field
        else:
            radius *= DISTRUST
    return least, best


def frequencies(span: float) -> Array:
    """Return the frequencies of the Bessel functions that kappa is mixed of: (W,)."""
    return np.asarray(np.arange(FREQUENCIES) * (np.pi / (SPACING * span)), dtype=float)


def _best_weight(
    slopes: list[Array], offsets: list[float], waves: Array, ceiling: Array, centre: Array, radius: float
) -> Array:
    """Return the weights about `centre` under which the greatest cut is least, or the centre itself."""
    n = len(centre)
    found = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=np.vstack(
            [np.column_stack([waves, np.zeros(len(waves))]), np.column_stack([np.array(slopes), -np.ones(len(slopes))])]
        ),
        b_ub=np.concatenate([ceiling, -np.array(offsets)]),
        bounds=[*((max(0.0, one - radius), one + radius) for one in centre), (None, None)],
        method="highs",
    )
    if found.x is None or not (found.x[:n] > 0.0).any():
        return centre
    weight: Array = np.maximum(np.asarray(found.x[:n], dtype=float), 0.0)
    return weight


def _norm2(field: Field, frequency: Array) -> Array:
    """Return what each frequency has of the field's square: (W,)."""
    sources = np.flatnonzero(field.mass)
    at, mass = field.ground.user[sources], field.mass[sources]
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    return np.array([mass @ j0(apart * one) @ mass for one in frequency])


def looked_at(span: float) -> Array:
    """Return distances at which a linear program keeps kappa low enough; between them, scaling it does."""
    return np.concatenate([np.arange(0, min(8.0, span), 0.1), np.arange(8.0, span + 0.3, 0.3)])
