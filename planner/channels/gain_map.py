"""Measured or ray-traced gains: of each of some receivers on the ground a map over the places of a UAV, by height.

A map has the gain of a link at places of a grid. Between them, and for a user who is not quite where the receiver is,
what is interpolated is by how many dB the link is better than free space: the distance itself is known exactly.
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.excess import Excess, Frame, Indices, looked_up
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.parts import Point

MAX_GAINS = 250_000
"""In all: 100 receivers with 50 x 50 places at one height, or one with 250 x 250 at four."""
PER_DB = float(np.log(10.0) / 10.0)

GainDb = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-300, le=100)]
Level = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.5, le=20_000)]
Row = Annotated[tuple[GainDb, ...], Field(min_length=2)]
Grid = Annotated[tuple[Row, ...], Field(min_length=2)]


class GainMap(RadioChannel):
    """`kind: map`: gains at places of UAVs, for receivers on the ground; a user has the map of the nearest one.

    receivers_m: where receivers are, metres east/north of the origin. levels_m: heights of UAVs above receivers,
    rising; linear in dB between them. south_west_m, spacing_m: the grid of UAV places, which covers the flying area.
    gains_db: by receiver and level, rows from south to north, each from west to east: the mean power gain in dB from a
    UAV there to the receiver, below 0. Bilinear in dB over free space between the places.
    """

    kind: Literal["map"] = "map"
    receivers_m: Annotated[tuple[Point, ...], Field(min_length=1, max_length=10_000)]
    levels_m: Annotated[tuple[Level, ...], Field(min_length=1, max_length=100)]
    south_west_m: Point
    spacing_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.1, le=10_000)]
    gains_db: Annotated[tuple[Annotated[tuple[Grid, ...], Field(min_length=1)], ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if any(above <= below for below, above in zip(self.levels_m, self.levels_m[1:], strict=False)):
            raise ValueError(f"levels_m: {list(self.levels_m)} must rise")
        if len(self.gains_db) != len(self.receivers_m):
            raise ValueError(f"gains_db: it has {len(self.gains_db)} maps for {len(self.receivers_m)} receivers_m")
        rows, columns = len(self.gains_db[0][0]), len(self.gains_db[0][0][0])
        for number, levels in enumerate(self.gains_db):
            if len(levels) != len(self.levels_m):
                raise ValueError(f"gains_db.{number}: it has {len(levels)} grids for {len(self.levels_m)} levels_m")
            for level, grid in enumerate(levels):
                if len(grid) != rows or any(len(row) != columns for row in grid):
                    raise ValueError(f"gains_db.{number}.{level}: it must have {rows} x {columns} gains, as the first")
        require_few(len(self.receivers_m), len(self.levels_m), rows, columns)
        return self

    def __eq__(self, other: object) -> bool:
        """Return whether both say the same; what is worked out once, and kept, has no say in it."""
        if not isinstance(other, GainMap):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    def __hash__(self) -> int:
        """Return the same for the same map."""
        return hash((self.receivers_m, self.levels_m, self.south_west_m, self.spacing_m, self.gains_db))

    @property
    def heights_m(self) -> tuple[float, float]:
        """From the lowest level to the highest."""
        return self.levels_m[0], self.levels_m[-1]

    @property
    def frame(self) -> Frame:
        """Where the grid lies."""
        return Frame(*self.south_west_m, self.spacing_m)

    @cached_property
    def logs(self) -> Array:
        """The logarithm of each gain over that of free space from one metre on: (levels, rows, columns, receivers)."""
        gains_db = np.array(self.gains_db, dtype=float).transpose(1, 2, 3, 0)
        rows, columns = gains_db.shape[1:3]
        east = self.south_west_m[0] + np.arange(columns) * self.spacing_m
        north = self.south_west_m[1] + np.arange(rows) * self.spacing_m
        at_m = np.array(self.receivers_m)
        over2 = (east[None, :, None] - at_m[:, 0]) ** 2 + (north[:, None, None] - at_m[:, 1]) ** 2
        squared = over2[None] + np.square(self.levels_m)[:, None, None, None]
        logs: Array = np.ascontiguousarray(gains_db * PER_DB + np.log(squared))
        return logs

    def refusal_of_area(self, area_m: tuple[Point, Point]) -> str | None:
        """Return why UAVs cannot fly in an area with this map, or None."""
        rows, columns = len(self.gains_db[0][0]), len(self.gains_db[0][0][0])
        west, south = self.south_west_m
        east, north = west + (columns - 1) * self.spacing_m, south + (rows - 1) * self.spacing_m
        (low_east, low_north), (high_east, high_north) = area_m
        if west <= low_east and south <= low_north and high_east <= east and high_north <= north:
            return None
        return f"gains_db: places from {(west, south)} to {(east, north)} m must cover area_m {area_m}"

    def power_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:  # noqa: ARG002 - in space alone
        """Return what the map's values are over: free space, with a gain of 1 at one metre."""
        gain: Array = 1.0 / distance_m**2
        return gain

    def excess(self, user_m: Array, uav_m: Array, height_m: Array) -> Array:
        """Return by what the map differs from `power_gain` at places, (..., 2) metres, and heights over users."""
        below, above, share = self._between(height_m)
        reads = self.nearest(user_m)
        low, high = (looked_up(self.logs, self.frame, level, reads, uav_m).value for level in (below, above))
        factor: Array = np.exp(low + share * (high - low))
        return factor

    def tables(self, altitude_m: Array, user_m: Array) -> Excess:
        """Return what optimisers see of the map: for altitudes (U,) and users (K, S, 2), metres."""
        heights, row = np.unique(self.known_height_m(altitude_m), return_inverse=True)
        below, above, share = self._between(heights)
        low, high = self.logs[below], self.logs[above]
        logs = low + share[:, None, None, None] * (high - low)
        return Excess(logs=logs, frame=self.frame, row=row.astype(np.intp), reads=self.nearest(user_m))

    def _between(self, height_m: Array) -> tuple[Indices, Indices, Array]:
        """Return the levels below and above heights, and the share of the way from one to the other, 0 to 1."""
        levels = np.array(self.levels_m)
        above = np.clip(np.searchsorted(levels, height_m, side="right"), 1, len(levels))
        below, above = above - 1, np.minimum(above, len(levels) - 1)
        gap = np.where(above > below, levels[above] - levels[below], 1.0)
        return below, above, np.where(above > below, np.clip((height_m - levels[below]) / gap, 0.0, 1.0), 0.0)

    def nearest(self, user_m: Array) -> Indices:
        """Return which receiver is nearest to users (..., 2), metres; the first of several."""
        away: Array = np.square(user_m[..., None, :] - np.array(self.receivers_m)).sum(axis=-1)
        nearest: Indices = away.argmin(axis=-1)
        return nearest

    def gain_bounds(
        self,
        least_away2: Array,
        most_away2: Array,
        near2: Array,
        far2: Array,
        lowest_m: Array,
        highest_m: Array,
        *,
        hills: bool = False,
    ) -> tuple[Array, Array]:
        """Return the same as for all kinds, times the greatest and the least of what all maps say anywhere."""
        limits = least_away2, most_away2, near2, far2, lowest_m, highest_m
        most, least = super().gain_bounds(*limits, hills=hills)
        return most * np.exp(self.logs.max()), least * np.exp(self.logs.min())


def require_few(receivers: int, levels: int, rows: int, columns: int) -> None:
    """Raise ValueError for more gains than a scenario may have."""
    total = receivers * levels * rows * columns
    if total > MAX_GAINS:
        raise ValueError(
            f"gains_db: {receivers} receivers x {levels} levels x {rows} x {columns} places are {total} gains; at most "
            f"are {MAX_GAINS}: use fewer receivers or levels, a smaller area or a wider spacing_m"
        )
