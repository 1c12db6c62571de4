"""Points and straight lines in the plane, metres east/north of one origin. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from skyfolio.planner.geometry import Point

_GRID_DECIMALS = 9
"""Nanometres. GEOS divides by the square of a length, which is 0 for a segment shorter than 1e-162 m."""
Segment: TypeAlias = tuple[Point, Point]


def segment_distances_m(first_m: Sequence[Segment], second_m: Sequence[Segment]) -> NDArray[np.float64]:
    """Return the least distances between straight segments, pair by pair; 0 where two of them cross.

    first_m, second_m: (n, 2, 2) metres east/north, or (1, 2, 2) to pair one segment with each of the others. A segment
    may be a single point. Returns (n,) metres.
    """
    distances_m: NDArray[np.float64] = shapely.distance(_lines(first_m), _lines(second_m))
    return distances_m


def _lines(segments_m: Sequence[Segment]) -> Any:
    """Return the segments as shapely has them, on a grid on which no length is lost when it is squared."""
    return shapely.linestrings(np.asarray(segments_m, dtype=float).reshape(-1, 2, 2).round(_GRID_DECIMALS))
