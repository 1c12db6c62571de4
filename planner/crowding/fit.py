"""Which kappa proves most: steps of linear programs over mixtures of Bessel functions.

What a slot is worth at most under kappa is the greatest, over mixes of assignments, of a function that is linear in the
weights of kappa; each mix that the steps of a field come to is a cut below it. The next weights are the best ones under
the last cuts, not far from the best so far (a bundle method with a trust region).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog
from scipy.special import k0

from skyfolio.planner.arrays import Array
from skyfolio.planner.crowding.field import Field
from skyfolio.planner.crowding.repulsion import STEP, frequencies, phi, repulsion_of, waves_of
from skyfolio.planner.crowding.slots import Slot

CUTS = 12
TRUST, DISTRUST = 0.3, 0.6
"""How far a weight may move, as a share of the greatest, and what becomes of that when nothing was gained."""
AGE = 20
"""Of a field whose kappa is a new one: its steps are neither long nor short."""


def sharpened(
    field: Field, slot: Slot, rounds: int, steps: int, *, stop: Callable[[], bool] = lambda: False
) -> tuple[float, Field]:
    """Return the least bound of the slot that is found under this and `rounds` more kappas, and the field of the best.

    steps: of the field under each.
    """
    ground = field.ground
    looked_at = _looked_at(ground.span)
    waves, ceiling = waves_of(ground.span)[looked_at], 1.0 / phi(looked_at * STEP)
    least, best = field.improve(slot, steps), field
    radius = TRUST * float(field.repulsion.weight.max())
    slopes: list[Array] = []
    offsets: list[float] = []
    for _ in range(rounds):
        if stop():
            break
        slopes = [*slopes, field.half_square - 0.5 * _norm2(field)][-CUTS:]
        offsets = [*offsets, field.bare][-CUTS:]
        weight = _best_weight(slopes, offsets, waves, ceiling, best.repulsion.weight, radius)
        field = field.under(repulsion_of(weight, ground.span), AGE)
        found = field.improve(slot, steps)
        if found < least:
            least, best = found, field
        else:
            radius *= DISTRUST
    return least, best


def bell(width2: float, span: float) -> Array:
    """Return weights (W,) of about 1 / (width2 + D^2), which is positive definite and a kappa to begin with."""
    frequency = frequencies(span)
    apart = float(frequency[1])
    argument = np.sqrt(width2) * np.maximum(frequency, apart / 4)  # the first one stands for half as much
    weight: Array = k0(argument) * np.maximum(frequency, apart / 8) * apart
    return weight


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


def _norm2(field: Field) -> Array:
    """Return what each frequency has of the field's square: (W,), from how much mass is how far from how much."""
    sources = np.flatnonzero(field.mass)
    at, mass = field.ground.user[sources], field.mass[sources]
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    waves = waves_of(field.ground.span)
    both = np.bincount(np.rint(apart / STEP).astype(np.int64).ravel(), np.outer(mass, mass).ravel(), len(waves))
    norm2: Array = both @ waves
    return norm2


def _looked_at(span: float) -> np.ndarray:
    """Return entries of the tables at which a linear program keeps kappa low enough; between them, scaling it does."""
    distance = np.concatenate([np.arange(0, min(8.0, span), 0.1), np.arange(8.0, span + 0.3, 0.3)])
    return np.minimum(np.rint(distance / STEP).astype(np.int64), len(waves_of(span)) - 1)
