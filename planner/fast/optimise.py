"""The fast path: climb from several starts, keep the best; anytime and always flyable."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from planner.fast.arena import Arena, Array, Links, arena_of, copy_of, links_of
from planner.fast.ascent import ascend
from planner.fast.climb import relink, tables, worth
from planner.fast.seeds import flights, flown, hovering
from planner.plans import Iteration
from planner.problem import Problem
from planner.solution import Observer, Solution, ignore
from planner.stopping import StoppingRule

STEPS = 40
TOLERANCE = 1e-5
WORK_OF_ALL_STARTS = 1.0e6
"""By default as many starts as keep `starts x U K N` below this, at least 2 and at most 32."""


class UnreachableEndError(ValueError):
    """No path found that brings every UAV to its `end_m` by its last slot."""


@dataclass
class Climb:
    """One ascent: its paths (N, 2, U), its links, and what they are worth."""

    path: Array
    links: Links
    unmet: int = 0
    utility_kbps: float = -np.inf
    sum_rate_kbps: float = 0.0
    history: list[Iteration] = field(default_factory=list)

    @property
    def rank(self) -> tuple[int, float]:
        """Greater is better: first fewer least rates unmet, then utility."""
        return -self.unmet, self.utility_kbps


def default_starts(problem: Problem) -> int:
    """32 at the letter's size, fewer for larger fleets: the choice depends on the size alone."""
    work = problem.n_uavs * problem.n_users * problem.n_slots
    return int(np.clip(WORK_OF_ALL_STARTS / work, 2, 32))


def optimise(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None = None,
    observer: Observer = ignore,
    *,
    n_starts: int | None = None,
    seed: int = 0,
) -> Solution:
    """Climb from `n_starts` starts (default: by size) and return the best end; the same for the same inputs.

    The first start is `start_m`, (U, N, 2) metres, made flyable from the problem's start positions; without it,
    hovering. `stop` sees the passes of one climb; when an interrupting rule speaks, the best plan so far is returned.
    The history holds the passes that raised the utility.
    Raises UnreachableEndError when no start reaches every end position.
    """
    arena = arena_of(problem)
    best: Climb | None = None
    history: list[Iteration] = []
    for path in _starts(arena, start_m, default_starts(problem) if n_starts is None else n_starts, seed):
        climb = _begin(arena, path)
        while not stop(climb.history):
            _advance(arena, climb)
            if best is None or climb.rank > best.rank:
                history.append(_iteration(len(history) + 1, climb))
                observer(history[-1])
        if best is None or climb.rank > best.rank:
            best = climb
        if stop.interrupts:
            break
    if best is None:
        raise UnreachableEndError("uavs: no path found that brings every UAV to its end_m in time")
    return _solution(problem, arena, best, history)


def _starts(arena: Arena, start_m: Array | None, n_starts: int, seed: int) -> Iterator[Array]:
    found = 0
    if start_m is not None:
        warm = flown(arena, np.ascontiguousarray(start_m.transpose(1, 2, 0)), chase=True)
        if warm is not None:
            found += 1
            yield warm
    if found < n_starts:
        hover = hovering(arena)
        if hover is not None:
            found += 1
            yield hover
    if found < n_starts and arena.step_m.max() > 0.0:
        yield from flights(arena, n_starts - found, seed)


def _begin(arena: Arena, path: Array) -> Climb:
    links = links_of(arena)
    relink(arena, path, links, np.empty(links.khz.shape))
    climb = Climb(path, links)
    climb.unmet, climb.utility_kbps, climb.sum_rate_kbps = worth(arena, path, links)
    return climb


def _advance(arena: Arena, climb: Climb) -> None:
    """One pass; undone when it made things worse, which only least rates and rounding can bring about."""
    path, links = climb.path.copy(), copy_of(climb.links)
    ascend(arena, links, path, STEPS, TOLERANCE)
    relink(arena, path, links, np.empty(links.khz.shape))
    unmet, utility, sum_rate = worth(arena, path, links)
    if (-unmet, utility) >= climb.rank:
        climb.path, climb.links = path, links
        climb.unmet, climb.utility_kbps, climb.sum_rate_kbps = unmet, utility, sum_rate
    climb.history.append(_iteration(len(climb.history) + 1, climb))


def _iteration(number: int, climb: Climb) -> Iteration:
    return Iteration(
        iteration=number, utility_bps=climb.utility_kbps * 1e3, mean_sum_rate_bps=climb.sum_rate_kbps * 1e3
    )


def _solution(problem: Problem, arena: Arena, best: Climb, history: list[Iteration]) -> Solution:
    serving = np.zeros((problem.n_users, problem.n_slots), dtype=np.int64)
    hertz = np.zeros((problem.n_users, problem.n_slots))
    tables(arena, best.path, best.links, serving, hertz)
    return Solution(np.ascontiguousarray(best.path.transpose(2, 0, 1)), serving, hertz, history)
