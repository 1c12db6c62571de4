"""A number and how sure of it one may be: over layouts, and over draws of the fading."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyfolio.api.lab.reproduce.courses import Flown
from skyfolio.planner.arrays import Array

CONFIDENCE = 0.95
Of = Callable[[str, str], float]
"""A measure of a scheme, by their names: the mean over some cases."""
Statistic = Callable[[Of], float]


@dataclass(frozen=True)
class Estimate:
    """value: of all cases. half: half the 95 % confidence interval over layouts, each of which has draws of its own.

    draws_half: the part of `half` that the draws alone would give. cases: the value of each case, (L, F).
    """

    value: float
    half: float
    draws_half: float
    cases: Array

    @property
    def spread(self) -> float:
        """The standard deviation over cases."""
        return float(self.cases.std())


class Measured:
    """scheme -> measure -> (1 + S, L, F): on L layouts with F losses each; [0] of all draws, [1 + s] without draw s.

    Some schemes may have flown on fewer layouts than others: on the first ones.
    """

    def __init__(self, tables: Mapping[str, Mapping[str, Array]]) -> None:
        self.tables = tables

    def cases(self, scheme: str, measure: str) -> Array:
        """Of all draws: (L, F)."""
        found: Array = self.tables[scheme][measure][0]
        return found

    def estimate(self, of: Statistic) -> Estimate:
        """Return the statistic of the means over the cases that all its schemes have flown, with jackknife intervals.

        Draws of different layouts are independent, so leaving out draw s everywhere leaves out one block of them.
        """
        n_leaves, n_layouts, n_losses = self._common(of)
        layouts = range(n_layouts)
        some = [[one for one in layouts if one != out] for out in layouts] if n_layouts > 1 else []
        each = [[of(self._mean(0, [layout], [lost])) for lost in range(n_losses)] for layout in layouts]
        return Estimate(
            of(self._mean(0, layouts)),
            half([of(self._mean(0, left)) for left in some]),
            half([of(self._mean(leaf, layouts)) for leaf in range(1, n_leaves)]),
            np.array(each),
        )

    def _common(self, of: Statistic) -> tuple[int, ...]:
        """Return the least (1 + S, L, F) of the tables that the statistic asks for."""
        shapes = []

        def asked(scheme: str, measure: str) -> float:
            shapes.append(self.tables[scheme][measure].shape)
            return 1.0

        of(asked)
        return tuple(np.min(shapes, axis=0).tolist())

    def _mean(self, leaf: int, layouts: Sequence[int], losses: Sequence[int] | None = None) -> Of:
        chosen = list(layouts)
        if losses is None:
            return lambda scheme, measure: float(self.tables[scheme][measure][leaf][chosen].mean())
        one = np.ix_(chosen, list(losses))
        return lambda scheme, measure: float(self.tables[scheme][measure][leaf][one].mean())


def half(left_out: Sequence[float]) -> float:
    """Half the confidence interval from a statistic with each of n parts left out; 0 where there are fewer than two.

    The jackknife: for a plain mean it is Student's interval.
    """
    n = len(left_out)
    if n < 2:
        return 0.0
    from scipy.stats import t  # noqa: PLC0415 - half a second of import that only this needs

    values = np.array(left_out)
    error = np.sqrt((n - 1) / n * ((values - values.mean()) ** 2).sum())
    return float(t.ppf((1 + CONFIDENCE) / 2, n - 1) * error)


def measured_of(flown: Mapping[str, Sequence[Flown]]) -> Measured:
    """From the flown layouts of each scheme."""
    return Measured({name: _tables(layouts) for name, layouts in flown.items()})


def _tables(layouts: Sequence[Flown]) -> dict[str, Array]:
    n_draws, n_losses = layouts[0].draws_kbps.shape[:2]
    leaves: list[list[int]] = [list(range(n_draws))]
    if n_draws > 1:
        leaves += [[draw for draw in range(n_draws) if draw != out] for out in range(n_draws)]
    rows = [[[one.course(lost, leaf).measures() for lost in range(n_losses)] for one in layouts] for leaf in leaves]
    keys = rows[0][0][0]
    return {key: np.array([[[case[key] for case in one] for one in leaf] for leaf in rows]) for key in keys}
