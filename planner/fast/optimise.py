"""The fast path: look for good places, fly there, climb, vary the best; anytime and always flyable."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import SUM, Arena, Links, arena_of, copy_of, links_of, plain
from skyfolio.planner.fast.blocked import who_is_blocked
from skyfolio.planner.fast.climb import climb as climb_on
from skyfolio.planner.fast.climb import tables
from skyfolio.planner.fast.placement import FEW, effort_of, places
from skyfolio.planner.fast.routes import with_routes
from skyfolio.planner.fast.seeds import bound, bound_for, flown, hovering, scattered, varied
from skyfolio.planner.fast.served import as_asked
from skyfolio.planner.gradient import log_weights
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Observer, Solution, ignore
from skyfolio.planner.stopping import StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError

STEPS, STEPS_WITH_DEMANDS = 30, 8
TOLERANCE, TOLERANCE_WITH_DEMANDS = 3e-6, 1e-5
"""Of one pass. Under `sum` a met demand sends its UAV on to others: links are out of date after a few steps."""
HOPELESS = 3.0
"""A further climb is given up when so many passes as good as its last one would not reach the best."""
WORK_OF_ALL_STARTS = 3.0e5
MOST_STARTS, MOST_STARTS_OF_SUMS = 32, 26
"""By default as many starts as keep `starts x U K N` below the first number, at least 2 and at most so many."""
SCATTERED = 4
"""Small fleets also begin at so many places drawn at random."""
VARIATIONS, FEWER_VARIATIONS = 26, 4
"""So many variations of the best plan (fewer in large fleets) before places are looked for anew, with more effort."""


@dataclass
class Climb:
    """One ascent: its paths (N, 2, U), its links, and what they are worth. A pass makes new ones and keeps the old."""

    path: Array
    links: Links
    unmet: int
    utility_kbps: float
    sum_rate_kbps: float
    settled: bool
    history: list[Iteration] = field(default_factory=list)
    waits: bool = False

    @property
    def rank(self) -> tuple[int, float]:
        """Greater is better: first fewer minimum rates unmet, then utility."""
        return -self.unmet, self.utility_kbps


@dataclass(frozen=True)
class Start:
    """Paths (N, 2, U) to begin from, None where they cannot be flown; `climbed` or only kept, if nothing is better.

    passes: after so many the climb waits for what others come to; the best one is climbed to its end at last.
    """

    path: Array | None
    climbed: bool = True
    passes: int | None = None


@dataclass
class Search:
    """The best plan so far, and how it came about. `climbs` counts the starts, flyable or not."""

    problem: Problem
    arena: Arena
    stop: StoppingRule
    observer: Observer
    best: Climb | None = None
    history: list[Iteration] = field(default_factory=list)
    climbs: int = 0

    def interrupted(self) -> bool:
        """Return whether an interrupting rule speaks."""
        return self.stop([]) and self.stop.interrupts

    def take(self, start: Start) -> None:
        """Climb from there until a rule says stop, it is hopeless, or it has to wait; and keep what is best."""
        self.climbs += start.climbed
        if start.path is None:
            return
        climb = _begin(self.arena, start.path, None if self.best is None else self.best.links.log_weight)
        if start.climbed:
            self._go_on(climb, start.passes)
        if self.best is None or climb.rank > self.best.rank:
            self.best = climb

    def finish(self) -> None:
        """Climb on from the best, if it still waits."""
        if self.best is not None and self.best.waits:
            self._go_on(self.best, None)

    def _go_on(self, climb: Climb, passes: int | None) -> None:
        until = None if passes is None else len(climb.history) + passes
        climb.waits = False
        while not (climb.settled or self.stop(climb.history) or _is_hopeless(climb, self.best)):
            if len(climb.history) == until:
                climb.waits = True
                return
            least = None if self.best is None else self.best.rank
            _advance(self.arena, climb)
            if least is None or climb.rank > least:
                self._note(climb)

    def _note(self, climb: Climb) -> None:
        if self.history and climb.utility_kbps * 1e3 < self.history[-1].utility_bps:
            self.history.clear()  # more least rates are met now: another count begins
        self.history.append(_iteration(len(self.history) + 1, climb))
        reached = partial(_solution, self.problem, self.arena, replace(climb), list(self.history))
        self.observer(self.history[-1], reached)


def default_starts(problem: Problem, *, warm: bool = False) -> int:
    """32 at the letter's size, 26 under `sum`, fewer for larger fleets, and few for a `warm` start of a fleet."""
    work = problem.n_uavs * problem.n_users * problem.n_slots
    is_sum = problem.kind == "sum" or problem.mu == 0.0
    if warm and problem.n_uavs > FEW:
        return 4 if is_sum else 2
    return int(np.clip(WORK_OF_ALL_STARTS / work, 2, MOST_STARTS_OF_SUMS if is_sum else MOST_STARTS))


def _affordable_starts(arena: Arena, starts: int) -> int:
    """Return so many starts, or half of them (at least 2) where energy is short: each climb takes twice as long."""
    return max(2, starts // 2) if arena.has_energy else starts


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
    hovering, from which large fleets do not climb. `stop` sees the passes of one climb; when an interrupting rule
    speaks, the best plan so far is returned. The history holds the passes that raised the utility.
    Raises UnreachableEndError when no start reaches every end position.
    """
    arena = with_routes(problem, arena_of(problem))
    search = Search(problem, arena, stop, observer)
    warm = start_m is not None
    most = _affordable_starts(arena, default_starts(problem, warm=warm)) if n_starts is None else n_starts
    brief = n_starts is None and warm and arena.kind != SUM and problem.n_uavs > FEW
    for start in _starts(search, start_m, np.random.default_rng(seed), brief=brief):
        search.take(start)
        if search.climbs >= most or search.interrupted():
            break
    search.finish()
    if search.best is None:
        raise UnreachableEndError(who_is_blocked(problem))
    return _solution(problem, arena, search.best, search.history)


def _starts(search: Search, start_m: Array | None, rng: np.random.Generator, *, brief: bool = False) -> Iterator[Start]:
    """Return where to begin, one after the other, as long as the search goes on: each may depend on the best so far.

    A large fleet that flies already makes one pass of its climb, and one from where else it might go; only the better
    climb goes on. brief: that is all.
    """
    arena = search.arena
    small, warm = arena.gain.shape[1] <= FEW, start_m is not None
    passes = 1 if warm and not small else None
    yield _first(arena, start_m, passes) if start_m is not None else Start(hovering(arena), climbed=small)
    for number in count():
        effort = effort_of(arena, number, warm=warm)
        given = None if search.best is None or not warm else bound(arena, search.best.path)
        for place in places(arena, rng, effort, given, halted=search.interrupted):
            yield Start(bound_for(arena, place), passes=passes)
        for _ in range(SCATTERED if small else 0):
            yield Start(scattered(arena, rng))
        if search.best is None or brief:
            return
        search.finish()
        for _ in range(VARIATIONS if small else FEWER_VARIATIONS):
            yield Start(varied(arena, rng, search.best.path))


def _first(arena: Arena, start_m: Array, passes: int | None) -> Start:
    """Return the given paths (U, N, 2) as far as they can be flown, else hovering."""
    path = flown(arena, plain(start_m.transpose(1, 2, 0)), chase=True)
    return Start(hovering(arena) if path is None else path, passes=passes)


def flyable(problem: Problem, wanted_m: Array | None = None) -> Array:
    """Return the flyable paths that follow `wanted_m`, (U, N, 2) metres, from the starts.

    Without it, or if those miss an end, UAVs hover as long as the ends allow. Raises UnreachableEndError when
    no such paths are found.
    """
    arena = with_routes(problem, arena_of(problem))
    path = None if wanted_m is None else flown(arena, plain(wanted_m.transpose(1, 2, 0)), chase=True)
    path = hovering(arena) if path is None else path
    if path is None:
        raise UnreachableEndError(who_is_blocked(problem))
    return np.ascontiguousarray(path.transpose(2, 0, 1))


def linked(
    problem: Problem, paths_m: Array, *, near_kbps: Array | None = None, tolerance: float = TOLERANCE
) -> Solution:
    """Return the best association and bandwidth at flyable paths (U, N, 2), metres.

    Exact for `sum` without minimum rates. near_kbps: rates (K, N) that are near to the best, to begin from. tolerance:
    links are taken anew until that gains no more than this share of the utility.
    """
    arena = arena_of(problem)
    log_weight = None if near_kbps is None or arena.kind == SUM else log_weights(problem, near_kbps)
    still = _begin(arena, plain(paths_m.transpose(1, 2, 0)), log_weight)
    before = -np.inf
    while still.utility_kbps - before > tolerance * abs(still.utility_kbps):
        before = still.utility_kbps
        _, still.utility_kbps, _, _ = climb_on(arena, still.path, still.links, 0, 0.0)
    return _solution(problem, arena, still, [])


def _is_hopeless(climb: Climb, best: Climb | None) -> bool:
    """Return whether the climb is so far below the best, and so slow, that it will not get there."""
    if best is None or best is climb or len(climb.history) < 2 or climb.unmet < best.unmet:
        return False
    gain = climb.utility_kbps - climb.history[-2].utility_bps / 1e3
    return climb.utility_kbps + HOPELESS * gain < best.utility_kbps


def _begin(arena: Arena, path: Array, log_weight: Array | None = None) -> Climb:
    """Return the paths with the best links; log_weight: (K,), of a minorant that was good at other paths."""
    links = links_of(arena)
    if log_weight is not None:
        links.log_weight[:] = log_weight
    return Climb(path, links, *climb_on(arena, path, links, 0, 0.0))


def _advance(arena: Arena, climb: Climb) -> None:
    """One pass; undone when it made things worse, which only minimum rates and rounding can bring about."""
    path, links = climb.path.copy(), copy_of(climb.links)
    brief = arena.has_demand and arena.kind == SUM
    pace = (STEPS_WITH_DEMANDS, TOLERANCE_WITH_DEMANDS) if brief else (STEPS, TOLERANCE)
    unmet, utility, sum_rate, climb.settled = climb_on(arena, path, links, *pace)
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
    reached = Solution(np.ascontiguousarray(best.path.transpose(2, 0, 1)), serving, hertz, history)
    return as_asked(problem, reached)
