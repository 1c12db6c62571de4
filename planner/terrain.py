"""The ground as a grid of heights: bilinear between them, and its highest point under straight lines, exactly.

Heights are metres above mean sea level at places on a square grid in metres east/north of the scenario's origin. Inside
a cell the ground is bilinear; beyond the grid it goes on as it is at the edge. On a straight line through a cell the
height is a quadratic of the way, so its maximum has a closed form, and inside of a cell a bilinear surface has no
maximum at all: the highest point of a triangle is on its edges or at a place of the grid.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from skyfolio.planner.arrays import Array
from skyfolio.planner.parts import Frozen, Point

MAX_HEIGHTS = 40_000
"""Of one grid: 6 km by 6 km at the 30 m of a global tile."""
_AT_ONCE = 400_000
"""So many crossings of grid lines are looked at together, which bounds the memory."""
_ROUNDING = 1e-9
"""In grid units: what places that count as inside of a triangle may be outside of it."""

Height = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-500, le=9_000)]


class Terrain(Frozen):
    """Ground heights over a scenario's frame.

    south_west_m: the place of the first height, metres east/north of the origin. spacing_m: between neighbouring
    heights. heights_m: rows from south to north, each from west to east, metres above mean sea level.
    """

    south_west_m: Point
    spacing_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.1, le=10_000)]
    heights_m: Annotated[
        tuple[Annotated[tuple[Height, ...], Field(min_length=2, max_length=MAX_HEIGHTS)], ...],
        Field(min_length=2, max_length=MAX_HEIGHTS),
    ]

    @model_validator(mode="after")
    def _check(self) -> Self:
        rows, columns = len(self.heights_m), len(self.heights_m[0])
        uneven = next((number for number, row in enumerate(self.heights_m) if len(row) != columns), None)
        if uneven is not None:
            raise ValueError(
                f"heights_m.{uneven}: it has {len(self.heights_m[uneven])} heights, but every row must have as many as "
                f"the first, {columns}"
            )
        if rows * columns > MAX_HEIGHTS:
            raise ValueError(
                f"heights_m: {rows} x {columns} heights are more than {MAX_HEIGHTS}; use a smaller area or a wider "
                "spacing_m"
            )
        return self

    def __eq__(self, other: object) -> bool:
        """Return whether both are the same ground; what is worked out once, and kept, has no say in it."""
        if not isinstance(other, Terrain):
            return NotImplemented
        mine, others = ((one.south_west_m, one.spacing_m, one.heights_m) for one in (self, other))
        return mine == others

    def __hash__(self) -> int:
        """Return the same for the same ground."""
        return hash((self.south_west_m, self.spacing_m, self.heights_m))

    @classmethod
    def flat(cls, height_m: float = 0.0) -> Self:
        """Return level ground everywhere."""
        row = (height_m, height_m)
        return cls(south_west_m=(0.0, 0.0), spacing_m=1.0, heights_m=(row, row))

    @cached_property
    def grid_m(self) -> Array:
        """The heights as (rows, columns), metres above mean sea level."""
        return np.array(self.heights_m, dtype=float)

    @property
    def bounds_m(self) -> tuple[Point, Point]:
        """The south-western and the north-eastern corner of the grid, metres east/north."""
        rows, columns = self.grid_m.shape
        west, south = self.south_west_m
        return (west, south), (west + (columns - 1) * self.spacing_m, south + (rows - 1) * self.spacing_m)

    def height_m(self, points_m: Array) -> Array:
        """Return the ground height at points (..., 2), metres east/north: (...) metres above mean sea level."""
        heights: Array = self._at(self._in_cells(points_m))
        return heights

    def height_at(self, east_m: float, north_m: float) -> float:
        """Return the ground height at one point, metres above mean sea level, much faster than `height_m` does."""
        rows, columns = len(self.heights_m), len(self.heights_m[0])
        east = min(max((east_m - self.south_west_m[0]) / self.spacing_m, 0.0), columns - 1.0)
        north = min(max((north_m - self.south_west_m[1]) / self.spacing_m, 0.0), rows - 1.0)
        column, row = min(int(east), columns - 2), min(int(north), rows - 2)
        x, y = east - column, north - row
        south, above = self.heights_m[row], self.heights_m[row + 1]
        low = (1.0 - x) * south[column] + x * south[column + 1]
        high = (1.0 - x) * above[column] + x * above[column + 1]
        return (1.0 - y) * low + y * high

    def highest_on_segments(self, start_m: Array, end_m: Array) -> Array:
        """Return the greatest ground height on straight segments, exact: (L,) metres above mean sea level.

        start_m, end_m: (L, 2) metres east/north; a segment may be a point.
        """
        start, end = self._in_cells(start_m), self._in_cells(end_m)
        crossings = int(np.abs(np.floor(end) - np.floor(start)).sum(axis=-1).max(initial=0)) + 4
        parts = max(1, ceil(len(start) * crossings / _AT_ONCE))
        pieces = zip(np.array_split(start, parts), np.array_split(end, parts), strict=True)
        return np.concatenate([self._highest(a, b) for a, b in pieces])

    def crossings(self, start_m: Array, end_m: Array) -> Array:
        """Return at which shares of straight ways, from (L, 2) to (L, 2), they cross a line of the grid: (L, M).

        Strictly between 0 and 1; 1 where a way has fewer than M of them.
        """
        start, end = self._in_cells(start_m), self._in_cells(end_m)
        return np.concatenate([_crossings(start[:, axis], end[:, axis]) for axis in (0, 1)], axis=1)

    def highest_in_triangles(self, a_m: Array, b_m: Array, c_m: Array) -> Array:
        """Return the greatest ground height in triangles, exact: (L,) metres above mean sea level.

        a_m, b_m, c_m: (L, 2), the corners, metres east/north; a triangle may be a segment or a point.
        """
        a, b, c = np.broadcast_arrays(a_m, b_m, c_m)
        starts, ends = np.concatenate([a, b, c]), np.concatenate([b, c, a])
        edges = self.highest_on_segments(starts, ends).reshape(3, -1).max(axis=0)
        highest: Array = np.maximum(edges, self.highest_places_in(a, b, c))
        return highest

    def highest_places_in(self, a_m: Array, b_m: Array, c_m: Array) -> Array:
        """Return the greatest height of the grid's places in triangles (L, 2), metres: (L,); -inf without any.

        With those on the three edges it is the greatest height in the triangle.
        """
        corners = np.stack([self._in_cells(a_m), self._in_cells(b_m), self._in_cells(c_m)], axis=1)
        in_rows = int((corners[:, :, 1].max(axis=1) - corners[:, :, 1].min(axis=1)).sum()) + 2 * len(corners)
        pieces = np.array_split(corners, max(1, ceil(in_rows / _AT_ONCE)))
        return np.concatenate([self._highest_places_in(piece) for piece in pieces])

    def cells_in(self, low_m: Array, high_m: Array) -> tuple[Array, Array, Array]:
        """Return the cells that meet a box: corners south-west and north-east (C, 2), metres, and least heights (C,).

        Those at the edge of the grid reach as far as the ground goes on.
        """
        rows, columns = self._rows_and_columns(low_m, high_m)
        cells = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        near: Array = cells * self.spacing_m + np.array(self.south_west_m)
        far: Array = near + self.spacing_m
        near[cells == 0] = -np.inf
        far[cells == np.array(self.grid_m.shape[::-1]) - 2] = np.inf
        quads = [self.grid_m[np.ix_(rows + up, columns + right)] for up in (0, 1) for right in (0, 1)]
        least: Array = np.min(quads, axis=0).reshape(-1)
        return near, far, least

    def heights_around(self, low_m: Array, high_m: Array) -> Array:
        """Return the heights at all corners of the cells that meet a box, metres above mean sea level."""
        rows, columns = self._rows_and_columns(low_m, high_m)
        heights: Array = self.grid_m[rows[0] : rows[-1] + 2, columns[0] : columns[-1] + 2]
        return heights

    def _rows_and_columns(self, low_m: Array, high_m: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the numbers of the rows and columns of cells that meet a box; at least one of each."""
        most = np.array(self.grid_m.shape[::-1]) - 2
        first = np.clip(np.floor(self._in_cells(low_m)).astype(np.intp), 0, most)
        last = np.clip(np.floor(self._in_cells(high_m)).astype(np.intp), 0, most)
        return np.arange(first[1], last[1] + 1), np.arange(first[0], last[0] + 1)

    def _in_cells(self, points_m: Array) -> Array:
        """Return points in grid units: 0 is the first column or row."""
        cells: Array = (np.asarray(points_m, dtype=float) - np.array(self.south_west_m)) / self.spacing_m
        return cells

    def _at(self, cells: Array) -> Array:
        grid = self.grid_m
        rows, columns = grid.shape
        east, north = np.clip(cells[..., 0], 0.0, columns - 1.0), np.clip(cells[..., 1], 0.0, rows - 1.0)
        column = np.minimum(east.astype(np.intp), columns - 2)
        row = np.minimum(north.astype(np.intp), rows - 2)
        x, y = east - column, north - row
        low = (1.0 - x) * grid[row, column] + x * grid[row, column + 1]
        high = (1.0 - x) * grid[row + 1, column] + x * grid[row + 1, column + 1]
        heights: Array = (1.0 - y) * low + y * high
        return heights

    def _highest(self, start: Array, end: Array) -> Array:
        """Return the greatest height on segments (L, 2) in grid units: (L,)."""
        shares = np.sort(
            np.concatenate(
                [
                    np.zeros((len(start), 1)),
                    _crossings(start[:, 0], end[:, 0]),
                    _crossings(start[:, 1], end[:, 1]),
                    np.ones((len(start), 1)),
                ],
                axis=1,
            ),
            axis=1,
        )
        middles = (shares[:, :-1] + shares[:, 1:]) / 2
        way = (end - start)[:, None]
        at = self._at(start[:, None] + shares[..., None] * way)  # (L, M + 1)
        amid = self._at(start[:, None] + middles[..., None] * way)  # (L, M)
        curve = 2.0 * (at[:, :-1] + at[:, 1:] - 2.0 * amid)
        slope = at[:, 1:] - at[:, :-1] - curve
        is_arch = (curve < 0.0) & (slope > 0.0) & (slope < -2.0 * curve)
        rise = np.where(is_arch, slope * slope / (-4.0 * np.where(is_arch, curve, -1.0)), 0.0)
        highest: Array = np.maximum(at.max(axis=1), (at[:, :-1] + rise).max(axis=1))
        return highest

    def _highest_places_in(self, triangles: Array) -> Array:
        """Return the greatest height of the grid's places in each triangle (L, 3, 2) in grid units: (L,).

        Without any it is -inf. Places that are outside by no more than rounding count too.
        """
        rows, columns = self.grid_m.shape
        y = triangles[:, :, 1]
        first = np.clip(np.ceil(y.min(axis=1) - _ROUNDING), 0.0, rows).astype(np.intp)
        last = np.clip(np.floor(y.max(axis=1) + _ROUNDING), -1.0, rows - 1.0).astype(np.intp)
        count = np.maximum(last - first + 1, 0)
        of = np.repeat(np.arange(len(triangles)), count)
        row = first[of] + np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
        west, east = _spans(triangles[of], row)
        start = np.clip(np.ceil(west - _ROUNDING), 0.0, columns).astype(np.intp)
        end = np.clip(np.floor(east + _ROUNDING), -1.0, columns - 1.0).astype(np.intp)
        some = start <= end
        highest = np.full(len(triangles), -np.inf)
        np.maximum.at(highest, of[some], self._highest_in_rows(row[some], start[some], end[some]))
        return highest

    def _highest_in_rows(self, row: NDArray[np.intp], start: NDArray[np.intp], end: NDArray[np.intp]) -> Array:
        """Return the greatest height of some rows between columns `start` and `end`, both counted: (n,)."""
        level = np.frexp(end - start + 1.0)[1] - 1
        over = self._over_columns
        highest: Array = np.maximum(over[level, row, start], over[level, row, end - (1 << level) + 1])
        return highest

    @cached_property
    def _over_columns(self) -> Array:
        """The greatest of 2^l heights from each place on eastwards: (l, rows, columns); beyond the edge none count."""
        levels = [self.grid_m]
        for level in range(int(self.grid_m.shape[1]).bit_length() - 1):
            reach, last = 1 << level, levels[-1]
            levels.append(np.concatenate([np.maximum(last[:, :-reach], last[:, reach:]), last[:, -reach:]], axis=1))
        return np.array(levels)


def _spans(triangles: Array, row: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return between which columns each triangle (n, 3, 2) meets its row, (n,) each; where it does not, in no order."""
    here, there = triangles, np.roll(triangles, -1, axis=1)
    y, rise = row[:, None] - here[..., 1], there[..., 1] - here[..., 1]
    share = np.clip(y / np.where(rise == 0.0, np.inf, rise), 0.0, 1.0)
    east = here[..., 0] + share * (there[..., 0] - here[..., 0])
    meets = np.abs(here[..., 1] + share * rise - row[:, None]) <= 2.0 * _ROUNDING
    ends = np.where(np.abs(y) <= _ROUNDING, here[..., 0], east)  # of a level edge both corners count
    west_of = np.where(meets, np.minimum(east, ends), np.inf)
    east_of = np.where(meets, np.maximum(east, ends), -np.inf)
    return west_of.min(axis=1), east_of.max(axis=1)


def _crossings(start: Array, end: Array) -> Array:
    """Return the shares of the way at which whole numbers are passed, from (L,) to (L,): (L, most), padded with 1."""
    first = np.ceil(np.minimum(start, end))
    most = int((np.floor(np.maximum(start, end)) - first).max(initial=-1.0)) + 1
    lines = first[:, None] + np.arange(max(most, 0))
    way = end - start
    shares = (lines - start[:, None]) / np.where(way == 0.0, np.inf, way)[:, None]
    return np.where((way[:, None] != 0.0) & (shares > 0.0) & (shares < 1.0), shares, 1.0)
