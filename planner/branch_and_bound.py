"""Branch and bound over UAV positions, slot by slot: the certificate made tight, offline, for up to three UAVs.

Slots are bounded independently, each over the positions reachable by then (a relaxation: consecutive positions need
not be one flight). A node is one rectangle per UAV. Its bound takes, for each pair, the nearest own and the farthest
interfering position in rectangle and reach; the best node of a slot is split until the budget is spent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import best_step, lifted_kbps, reachability_bound_kbps
from skyfolio.planner.cells import split_cells
from skyfolio.planner.fast.arena import plain
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import Reach, reach_of

MAX_UAVS = 3
CHUNK = 4096
"""Nodes split between two looks at the stopping rule."""
PLANES = 8
"""Tangent planes tried for a concave utility; the first may take half of the budget."""


@dataclass(frozen=True)
class Certificate:
    """A proven bound. bound_kbps: no feasible plan has a higher utility. root_kbps: the bound before branching.

    slot_bounds_kbps, slot_best_kbps: (N,), bound and best value found of each slot's weighted sum rate (weights are 1
    for `sum`), positions free within reach, of the tangent plane that gave the bound. nodes: rectangles split.
    finished: every slot of it is closed to the tolerance. Of a fleet
    that is not branched (`planner.certificate`), nodes are assignments, and finished says that nothing was left to try.
    """

    bound_kbps: float
    root_kbps: float
    slot_bounds_kbps: Array
    slot_best_kbps: Array
    nodes: int
    finished: bool


def certificate(
    problem: Problem,
    rates_kbps: Array,
    *,
    tolerance: float = 0.005,
    max_nodes: int = 2_000_000,
    stop: Callable[[], bool] = lambda: False,
) -> Certificate:
    """Bound the utility of every feasible plan by branch and bound; valid whenever it is stopped.

    rates_kbps: (K, N), those of a good plan: the first tangent plane of a concave utility touches it there, the next
    ones at the Frank-Wolfe iterates that follow. tolerance: relative gap at which a slot is closed. max_nodes: for all
    planes together. Raises ValueError for more than three UAVs, and for channels
    that are no inverse square.
    """
    if problem.n_uavs > MAX_UAVS:
        raise ValueError(f"uavs: branch and bound takes at most {MAX_UAVS} UAVs, not {problem.n_uavs}")
    if problem.bends is not None:
        raise ValueError("channel.kind, channel.antenna: branch and bound knows inverse squares alone")
    root = reachability_bound_kbps(problem)
    if problem.kind == "sum" or problem.mu == 0.0:
        slots, nodes = _branched(problem, problem.weight[:, None] * problem.there, tolerance, max_nodes, stop)
        bounds = np.array([slot.bound for slot in slots])
        return _certificate(slots, root, min(root, lifted_kbps(problem, bounds)), nodes, tolerance)
    return _by_tangent_planes(problem, rates_kbps, root, tolerance, max_nodes, stop)


def _by_tangent_planes(
    problem: Problem, point: Array, root: float, tolerance: float, max_nodes: int, stop: Callable[[], bool]
) -> Certificate:
    """Return the least bound of the planes that the budget allows for.

    `point` (K, N) is where the first one touches.
    """
    best: Certificate | None = None
    spent = 0
    for plane in range(PLANES):
        share = max_nodes // 2 if plane == 0 else (max_nodes - spent) // (PLANES - plane)
        weights = rate_weights(problem, point)
        slots, nodes = _branched(problem, weights, tolerance, share, stop)
        spent += nodes
        value = problem.utility_kbps(point)
        proven = value + sum(slot.bound for slot in slots) - float((weights * point).sum())
        if best is None or proven < best.bound_kbps:
            best = _certificate(slots, root, min(root, proven), spent, tolerance)
        if stop():
            break
        vertex = np.stack([slot.found for slot in slots], axis=1)
        point = point + best_step(problem, point, vertex) * (vertex - point)
    assert best is not None  # noqa: S101 - PLANES is at least 1
    return replace(best, nodes=spent)


def _certificate(slots: list[_Slot], root: float, proven: float, nodes: int, tolerance: float) -> Certificate:
    bounds, best = np.array([slot.bound for slot in slots]), np.array([slot.best for slot in slots])
    return Certificate(proven, root, bounds, best, nodes, bool(((bounds - best) <= tolerance * bounds).all()))


def _branched(
    problem: Problem, weights: Array, tolerance: float, max_nodes: int, stop: Callable[[], bool]
) -> tuple[list[_Slot], int]:
    """Return the slots with their nodes split, the widest gap first, until all are closed or the budget is spent."""
    slots = [_Slot(problem, weights, n) for n in range(problem.n_slots)]
    nodes = 0
    while nodes < max_nodes and not stop():
        widest = max(slots, key=lambda slot: slot.gap if slot.gap > tolerance * slot.bound else 0.0)
        if widest.gap <= tolerance * widest.bound:
            break
        nodes += widest.split(min(CHUNK, max_nodes - nodes), tolerance)
    return slots, nodes


class _Slot:
    """The open nodes of one slot: a binary heap in arrays, which grows as needed."""

    def __init__(self, problem: Problem, weights: Array, n: int) -> None:
        reach: Reach = reach_of(problem)
        centres = np.stack([problem.start_m, np.where(np.isnan(problem.end_m), 0.0, problem.end_m)])
        radii = np.stack([reach.from_start_m[:, n], np.minimum(reach.to_end_m[:, n], 1e9)])
        scale = problem.bandwidth_hz / (1e3 * np.log(2))
        gain = problem.snr_gain[:, :, n]
        moment = min(n, problem.user_m.shape[1] - 1)
        user_m, height2 = problem.user_m[:, moment], problem.altitude_m[:, None] ** 2 + problem.spread_m2[:, moment]
        fixed = (centres, radii, problem.discs, user_m, height2, gain, scale, weights[:, n])
        self._fixed = tuple(plain(array) for array in fixed)
        cell = np.concatenate([problem.low_m, problem.high_m])
        self._cells = np.empty((CHUNK * 4, problem.n_uavs, 4))
        self._cells[0] = cell
        self._keys = np.empty(len(self._cells))
        self._keys[0] = np.inf
        self._open = 1
        self.best = 0.0
        self.found = np.zeros(problem.n_users)
        self.split(1, 0.0)

    @property
    def bound(self) -> float:
        """Nothing in this slot is better."""
        return max(self.best, float(self._keys[0])) if self._open else self.best

    @property
    def gap(self) -> float:
        """What is still unproven."""
        return self.bound - self.best

    def split(self, count: int, tolerance: float) -> int:
        """Split up to `count` of the best nodes; how many."""
        if self._open + count + 1 > len(self._keys):
            more = len(self._keys) + 4 * count
            self._cells, self._keys = (
                np.resize(self._cells, (more, *self._cells.shape[1:])),
                np.resize(self._keys, more),
            )
        self._open, self.best, done = split_cells(
            self._cells, self._keys, self._open, self.best, count, tolerance, *self._fixed, self.found
        )
        return int(done)
