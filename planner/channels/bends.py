"""What the gain of a channel is times an inverse square, as tables over the distance over ground.

The tables are the channel that optimisers see: kernels, rates and bounds all read the same ones, linear between their
entries, so that a bound over them is a bound of every rate. docs/channels.md says how near they come to the formulas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import RadioChannel

PER_HEIGHT = 128
"""Entries of a table for each altitude of distance: what changes with the elevation changes over an altitude."""
LEAST_STEP_M = 0.05
MOST_ENTRIES = 20_000
LEAST_M = 1e-6
"""As in the kernels (`fast.bent`)."""


@dataclass(frozen=True, kw_only=True)
class Bends:
    """R profiles, U UAVs. An SNR is `snr_gain / d^2` times the factor at the distance over ground.

    factor: (R, T), at 0, 1, 2 ... times step_m (R,) metres; constant beyond. height_m: (R,), the altitude of each
    profile. row: (U,), which one each UAV has.
    """

    factor: Array
    step_m: Array
    height_m: Array
    row: NDArray[np.intp]

    def of(self, uavs: NDArray[np.intp]) -> Bends:
        """Return the tables for some UAVs, given by their indices."""
        return replace(self, row=self.row[uavs])

    def at(self, over2: Array) -> Array:
        """Return the factors at squared distances over ground, (U, ...) m^2."""
        return self._look(over2, self._rows(over2))[0]

    def of_uav(self, u: int, over2: Array) -> tuple[Array, Array]:
        """Return the factors of one UAV at squared distances over ground of any shape, m^2, and their slopes, 1/m^2."""
        row = np.full(over2.shape, self.row[u])
        value, at, part = self._look(over2, row)
        rise = (self.factor[row, at + 1] - self.factor[row, at]) / self.step_m[row]
        slope = np.where(part < 1.0, rise / (2.0 * np.maximum(np.sqrt(over2), LEAST_M)), 0.0)
        return value, slope

    def gain_range(self, near2: Array, far2: Array) -> tuple[Array, Array]:
        """Return the greatest and the least factor / d^2 for d^2 from `near2` to `far2`, (U, ...) m^2: bounds of both.

        On a piece of a profile between two entries no gain is above the greater factor at the nearer distance, and
        none below the lesser factor at the farther one.
        """
        row = self._rows(near2)
        height2 = self.height_m[row] ** 2
        near2, far2 = np.broadcast_arrays(near2, np.maximum(near2, far2))
        first, i, _ = self._look(np.maximum(near2 - height2, 0.0), row)
        last, j, _ = self._look(np.maximum(far2 - height2, 0.0), row)
        after, before = self.factor[row, i + 1], self.factor[row, j]
        after2, before2 = ((at * self.step_m[row]) ** 2 + height2 for at in (i + 1, j))
        one = i == j
        most = np.where(one, np.maximum(first, last) / near2, np.maximum(first, after) / near2)
        least = np.where(one, np.minimum(first, last) / far2, np.minimum(first, after) / after2)
        most = np.where(one, most, np.maximum(most, np.maximum(before, last) / before2))
        least = np.where(one, least, np.minimum(least, np.minimum(before, last) / far2))
        between = j - i > 1
        if between.any():
            inner = row[between], i[between] + 1, j[between] - 1
            most[between] = np.maximum(most[between], _over(self._most, *inner, np.maximum))
            least[between] = np.minimum(least[between], _over(self._least, *inner, np.minimum))
        return most * (1.0 + 1e-12), least * (1.0 - 1e-12)

    @cached_property
    def fitted(self) -> tuple[Array, Array]:
        """A factor and a squared height of each profile, (R,) each, of an inverse square that is somewhat like it.

        It has the greatest gain of the profile where it is nearest, and that of its envelope four altitudes away.
        """
        squared = self._squared
        envelope = np.maximum.accumulate((self.factor / squared)[:, ::-1], axis=1)[:, ::-1]
        at = np.minimum((4.0 * self.height_m / self.step_m).astype(int) + 1, self.factor.shape[1] - 1)
        away2 = (at * self.step_m) ** 2
        share = np.clip(envelope[np.arange(len(at)), at] / envelope[:, 0], 1e-6, 1.0 - 1e-6)
        height2 = away2 * share / (1.0 - share)
        return envelope[:, 0] * height2, height2

    def _rows(self, over2: Array) -> NDArray[np.intp]:
        shape = (len(self.row),) + (1,) * (over2.ndim - 1)
        rows: NDArray[np.intp] = np.broadcast_to(self.row.reshape(shape), over2.shape)
        return rows

    def _look(self, over2: Array, row: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp], Array]:
        """Return the factors, after which entries they lie, and which part of the way to the next."""
        place = np.sqrt(over2) / self.step_m[row]
        at = np.minimum(place, self.factor.shape[1] - 2.0).astype(np.intp)
        part = np.minimum(place - at, 1.0)
        low = self.factor[row, at]
        return low + part * (self.factor[row, at + 1] - low), at, part

    @cached_property
    def _squared(self) -> Array:
        """Squared distances at the entries: (R, T) m^2."""
        away = np.arange(self.factor.shape[1]) * self.step_m[:, None]
        squared: Array = away**2 + self.height_m[:, None] ** 2
        return squared

    @cached_property
    def _most(self) -> list[Array]:
        """The greatest gain in 1, 2, 4 ... pieces from each on."""
        pieces = np.maximum(self.factor[:, :-1], self.factor[:, 1:]) / self._squared[:, :-1]
        return _doubling(pieces, np.maximum)

    @cached_property
    def _least(self) -> list[Array]:
        pieces = np.minimum(self.factor[:, :-1], self.factor[:, 1:]) / self._squared[:, 1:]
        return _doubling(pieces, np.minimum)


def _doubling(pieces: Array, of: np.ufunc) -> list[Array]:
    levels = [pieces]
    width = 1
    while 2 * width <= pieces.shape[1]:
        last = levels[-1]
        levels.append(of(last[:, :-width], last[:, width:]))
        width *= 2
    return levels


def _over(
    levels: list[Array], row: NDArray[np.intp], first: NDArray[np.intp], last: NDArray[np.intp], of: np.ufunc
) -> Array:
    """Return the extreme over the pieces [first, last] of each row."""
    level = np.floor(np.log2(last - first + 1)).astype(np.intp)
    found = np.empty(len(row))
    for number in np.unique(level).tolist():
        some = level == number
        table, rows = levels[number], row[some]
        found[some] = of(table[rows, first[some]], table[rows, last[some] - 2**number + 1])
    return found


def bends_of(channel: RadioChannel, altitude_m: Array, longest_m: float) -> Bends | None:
    """Return the profiles of UAVs at these altitudes (U,), metres; None where the gain is an inverse square.

    longest_m: the greatest distance over ground that any link can have.
    """
    if channel.is_inverse_square:
        return None
    heights, row = np.unique(altitude_m, return_inverse=True)
    step_m = np.maximum(np.maximum(heights / PER_HEIGHT, longest_m / MOST_ENTRIES), LEAST_STEP_M)
    entries = int(np.ceil(longest_m / step_m.min())) + 2
    away_m = np.arange(float(entries)) * step_m[:, None]
    factor = channel.factor(away_m, np.broadcast_to(heights[:, None], away_m.shape))
    return Bends(factor=factor, step_m=step_m, height_m=heights, row=row.astype(np.intp))
