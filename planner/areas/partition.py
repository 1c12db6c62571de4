"""Which UAVs make an area, who its neighbours are, and which areas can be planned at the same time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from skyfolio.planner.arrays import Array

Ints: TypeAlias = NDArray[np.int64]
MOST = 16
"""UAVs in an area."""
NEIGHBOURS = 1.5
"""UAVs around an area that are in its problem with pinned paths, for each of its own."""
TOUCHED = 2 * MOST
"""UAVs that are planned anew around a place where something has changed: an area and its neighbours."""
TURN = 0.6
"""Radians: each cut into areas is turned by so much against the last, so that borders lie elsewhere."""


@dataclass(frozen=True)
class Area:
    """own: indices of the UAVs that are planned; around: of the nearest others, which fly as before."""

    own: Ints
    around: Ints

    @property
    def uavs(self) -> Ints:
        """All UAVs of its problem, its own first."""
        return np.concatenate([self.own, self.around])


def cut(places_m: Array, *, turn: int = 0, most: int = MOST, among: Ints | None = None) -> list[Area]:
    """Return areas of at most `most` UAVs by where they hover, (U, 2) metres: as equal as can be.

    among: the UAVs that belong to areas (default: all); the others are only around them.
    """
    angle = TURN * turn
    turned = places_m @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    chosen = np.arange(len(places_m)) if among is None else among
    owners = _split(turned, chosen, -(-len(chosen) // most)) if len(chosen) else []
    tree = KDTree(places_m)
    return [Area(own, _around(tree, places_m, own)) for own in owners]


def nearby(places_m: Array, around_m: Array) -> Ints:
    """Return the UAVs that hover nearest to each of these points, (P, 2) metres: two areas' worth for each."""
    some = min(len(places_m), TOUCHED)
    near = KDTree(places_m).query(around_m, k=some)[1]
    return np.unique(near).astype(np.int64)


def _split(at: Array, uavs: Ints, parts: int) -> list[Ints]:
    if parts == 1:
        return [np.sort(uavs)]
    axis = int(np.argmax(np.ptp(at[uavs], axis=0)))
    ranked = uavs[np.argsort(at[uavs, axis], kind="stable")]
    first = len(ranked) * (parts // 2) // parts
    return [*_split(at, ranked[:first], parts // 2), *_split(at, ranked[first:], parts - parts // 2)]


def _around(tree: KDTree, places_m: Array, own: Ints) -> Ints:
    """Return the others that hover nearest to any of `own`."""
    some = min(len(places_m) - len(own), int(np.ceil(NEIGHBOURS * len(own))))
    if some <= 0:
        return np.zeros(0, dtype=np.int64)
    away, near = tree.query(places_m[own], k=min(len(places_m), len(own) + some))
    nearest: dict[int, float] = {}
    mine = set(own.tolist())
    for distance, uav in zip(np.ravel(away).tolist(), np.ravel(near).tolist(), strict=True):
        if uav not in mine:
            nearest[uav] = min(distance, nearest.get(uav, np.inf))
    chosen = sorted(nearest, key=lambda uav: (nearest[uav], uav))[:some]
    return np.array(sorted(chosen), dtype=np.int64)


def waves(areas: list[Area]) -> list[list[Area]]:
    """Return the areas in groups to be planned at the same time: no UAV is in two problems of a group."""
    groups: list[list[Area]] = []
    for area in areas:
        for group in groups:
            if not any(np.isin(area.uavs, other.uavs).any() for other in group):
                group.append(area)
                break
        else:
            groups.append([area])
    return groups
