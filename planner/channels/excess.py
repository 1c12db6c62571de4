"""By how much links are better than free space, on a grid of places of the UAV: what `gain_map.py` makes of a map.

Values are natural logarithms, bilinear between the places of the grid; beyond it they go on as they are at the edge.
Optimisers see one table for each altitude of the fleet. Kernels, rates and bounds all read the same ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array

BLOCKS = 24
"""Bounds look at so many blocks of cells in each direction at most."""

Indices = NDArray[np.intp]


class Frame(NamedTuple):
    """Where a grid lies: its south-western place, metres east and north, and how far places are apart, metres."""

    west_m: float
    south_m: float
    spacing_m: float


class Looked(NamedTuple):
    """Values at places, and their slopes to the east and to the north, 1/m."""

    value: Array
    east: Array
    north: Array


def looked_up(grid: Array, frame: Frame, table: Indices, reader: Indices, places_m: Array) -> Looked:
    """Return what a grid (T, Y, X, M) says at places (..., 2), metres.

    table, reader: which T and which M, of shapes that broadcast to that of the places.
    """
    rows, columns = grid.shape[1:3]
    row, y, rises = _cells(places_m[..., 1], frame.south_m, frame.spacing_m, rows)
    column, x, goes_east = _cells(places_m[..., 0], frame.west_m, frame.spacing_m, columns)
    south_west, south_east = grid[table, row, column, reader], grid[table, row, column + 1, reader]
    north_west, north_east = grid[table, row + 1, column, reader], grid[table, row + 1, column + 1, reader]
    south, north = south_west + x * (south_east - south_west), north_west + x * (north_east - north_west)
    east = (1.0 - y) * (south_east - south_west) + y * (north_east - north_west)
    return Looked(
        south + y * (north - south), goes_east * east / frame.spacing_m, rises * (north - south) / frame.spacing_m
    )


def _cells(at_m: Array, first_m: float, spacing_m: float, count: int) -> tuple[Indices, Array, NDArray[np.bool_]]:
    """Return in which cells of one axis places are, how far in, 0 to 1, and whether they are on the grid at all."""
    place = (at_m - first_m) / spacing_m
    inside = (place >= 0.0) & (place <= count - 1.0)
    place = np.clip(place, 0.0, count - 1.0)
    cell = np.minimum(place.astype(np.intp), count - 2)
    return cell, place - cell, inside


@dataclass(frozen=True, kw_only=True)
class Excess:
    """R altitudes, U UAVs, K users, M receivers. An SNR is multiplied by the exponential of what is here.

    logs: (R, Y, X, M). row: (U,), which altitude each UAV has. reads: (K, S), which receiver's map each user has, S as
    in `Problem.user_m`.
    """

    logs: Array
    frame: Frame
    row: Indices
    reads: Indices

    def of(self, uavs: Indices) -> Excess:
        """Return the tables for some UAVs, given by their indices."""
        return replace(self, row=self.row[uavs])

    def for_users(self, users: Indices) -> Excess:
        """Return the tables for some users, given by their indices."""
        return replace(self, reads=self.reads[users])

    def on_paths(self, paths_m: Array) -> Array:
        """Return the factors of all links on paths (U, N, 2), metres: (U, K, N)."""
        looked = looked_up(self.logs, self.frame, self.row[:, None, None], self.reads[None], paths_m[:, None])
        factors: Array = np.exp(looked.value)
        return factors

    def of_uav(self, u: int, places_m: Array, users: Indices | slice = slice(None)) -> tuple[Array, Array, Array]:
        """Return the factors (K, N) of one UAV at places (N, 2), metres, and the slopes of their logarithms, 1/m."""
        looked = looked_up(self.logs, self.frame, self.row[u], self.reads[users], places_m[None])
        return np.exp(looked.value), looked.east, looked.north

    def range_in(self, low_m: Array, high_m: Array, slots: Indices) -> tuple[Array, Array]:
        """Return bounds of the factors of UAVs that are in boxes, (U, S, 2) metres each: an upper, a lower, (U, K, S).

        slots: (S,), in which.
        """
        most, least, wide_m = self._blocks
        reads = self.reads[:, slots] if self.reads.shape[1] > 1 else np.repeat(self.reads, len(slots), axis=1)
        upper, lower = np.empty((2, len(self.row), *reads.shape))
        south_west = np.array([self.frame.west_m, self.frame.south_m])
        last = np.array(most.shape[1:3])[::-1] - 1
        first = np.clip(np.floor((low_m - south_west) / wide_m), 0, last).astype(np.intp)
        final = np.clip(np.floor((high_m - south_west) / wide_m), 0, last).astype(np.intp)
        known: dict[tuple[int, ...], tuple[Array, Array]] = {}
        for u, altitude in enumerate(self.row.tolist()):
            for s in range(len(slots)):
                (west, south), (east, north) = first[u, s].tolist(), final[u, s].tolist()
                key = altitude, west, south, east, north
                if key not in known:
                    box = altitude, slice(south, north + 1), slice(west, east + 1)
                    known[key] = most[box].max(axis=(0, 1)), least[box].min(axis=(0, 1))
                upper[u, :, s], lower[u, :, s] = (one[reads[:, s]] for one in known[key])
        return np.exp(upper) * (1.0 + 1e-12), np.exp(lower) * (1.0 - 1e-12)

    def most(self) -> Array:
        """Return the greatest factors anywhere: (U, K, S)."""
        greatest: Array = np.exp(self._blocks[0].max(axis=(1, 2))[self.row[:, None, None], self.reads[None]])
        return greatest

    @cached_property
    def _blocks(self) -> tuple[Array, Array, float]:
        """The greatest and the least value in blocks of cells, (R, I, J, M) each, and how wide blocks are, metres."""
        wide = max(1, int(np.ceil((max(self.logs.shape[1:3]) - 1) / BLOCKS)))
        most, least = self.logs, self.logs
        for axis in (1, 2):
            most, least = _in_blocks(most, axis, wide, np.maximum), _in_blocks(least, axis, wide, np.minimum)
        return most, least, wide * self.frame.spacing_m


def _in_blocks(values: Array, axis: int, wide: int, of: np.ufunc) -> Array:
    """Return the extremes of `wide` cells each along an axis: of one place more than that, since cells share them."""
    starts = np.arange(0, values.shape[axis] - 1, wide)
    ends = np.minimum(starts + wide, values.shape[axis] - 1)
    inside: Array = of.reduceat(values, starts, axis=axis)
    return np.asarray(of(inside, np.take(values, ends, axis=axis)))
