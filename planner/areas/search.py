"""Rounds over the areas until the joint utility stops improving."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from skyfolio.planner.areas.blocks import Improve, Task
from skyfolio.planner.areas.joint import (
    Ints,
    Joint,
    Runner,
    area_problem,
    bound_for_m,
    joint_of,
    nearest_uavs,
    users_around,
    worth,
)
from skyfolio.planner.areas.partition import Area, cut, waves
from skyfolio.planner.areas.sketch import sketched
from skyfolio.planner.areas.together import clashing
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import arena_of, plain
from skyfolio.planner.fast.blocked import who_is_blocked
from skyfolio.planner.fast.routes import with_routes
from skyfolio.planner.fast.seeds import bound_for, flown, hovering
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Observer, Solution, ignore
from skyfolio.planner.stopping import MaxIterations, StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError

ROUNDS = 3
LEAST_GAIN = 2e-3
"""Relative: a round that gains less is the last one."""
FIRST_STARTS, STARTS = 4, 2
"""Starts of each area in the first round and in each of the others, unless the caller says otherwise."""
PASSES = 50
"""Of a climb in an area, at most."""


@dataclass
class Search:
    """The best plan so far of the whole fleet."""

    problem: Problem
    stop: StoppingRule
    observer: Observer
    run: Runner
    seed: int
    best: Joint | None = None
    history: list[Iteration] = field(default_factory=list)

    def interrupted(self) -> bool:
        """Return whether an interrupting rule speaks."""
        return self.stop([]) and self.stop.interrupts

    def take(self, joint: Joint) -> bool:
        """Keep a plan if it is better than the best; return whether it is."""
        if self.best is not None and joint.rank <= self.best.rank:
            return False
        if self.best is not None and joint.unmet < self.best.unmet:
            self.history.clear()  # more minimum rates are met now: another count begins
        self.best = joint
        number = len(self.history) + 1
        mean = float(joint.rates_kbps.sum(axis=0).mean())
        self.history.append(
            Iteration(iteration=number, utility_bps=joint.utility_kbps * 1e3, mean_sum_rate_bps=mean * 1e3)
        )
        self.observer(self.history[-1], partial(_solution, joint, list(self.history)))
        return True


def optimise(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None = None,
    observer: Observer = ignore,
    *,
    n_starts: int | None = None,
    seed: int = 0,
    run: Callable[[Sequence[Task]], list[Solution | None]] | None = None,
) -> Solution:
    """Return the best plan that rounds over the areas find from a sketch, or from `start_m`, (U, N, 2) metres.

    n_starts: of each area in the first round. run: runs the tasks of areas that can be planned at the same time
    (default: one after the other, here). The result does not depend on it, but for interruptions. Raises
    UnreachableEndError when no paths to all ends are found, and ValueError for sampled fading and for pins.
    """
    _require_able(problem)
    search = Search(problem, stop, observer, run or partial(_one_by_one, stop), seed)
    search.take(joint_of(problem, _first_paths(search, start_m), search.run))
    for number in range(ROUNDS):
        if search.interrupted() or not _round(search, number, n_starts or (STARTS if number else FIRST_STARTS)):
            break
    assert search.best is not None  # noqa: S101 - the first plan was taken
    return _solution(search.best, search.history)


def _require_able(problem: Problem) -> None:
    if problem.n_users > 1 and problem.snr_gain.strides[1] != 0:
        raise ValueError("channel.fading: the method 'areas' plans the mean channel, not a sampled one")
    if problem.pinned_m.size or problem.pinned_to.size:
        raise ValueError("pins: the method 'areas' keeps no pins")


def _one_by_one(stop: StoppingRule, tasks: Sequence[Task]) -> list[Solution | None]:
    return [task.run(_within(stop)) for task in tasks]


def _within(stop: StoppingRule) -> StoppingRule:
    """Return the rule for the climbs of an area: the caller's."""
    return stop


def _first_paths(search: Search, start_m: Array | None) -> Array:
    """Return flyable paths (U, N, 2): those given, straight flights to the sketched places, or hovering."""
    problem = search.problem
    arena = with_routes(problem, arena_of(problem))
    if start_m is not None:
        path = flown(arena, plain(start_m.transpose(1, 2, 0)), chase=True)
    else:
        path = bound_for(arena, plain(sketched(problem, search.seed, search.interrupted).T))
    path = hovering(arena) if path is None else path
    if path is None:
        raise UnreachableEndError(who_is_blocked(problem))
    return np.ascontiguousarray(path.transpose(2, 0, 1))


def _round(search: Search, number: int, n_starts: int) -> bool:
    """Plan every area anew once; return whether the joint utility grew enough for another round."""
    assert search.best is not None  # noqa: S101 - a round begins from a plan
    before, problem = search.best, search.problem
    areas = cut(bound_for_m(problem, before.solution.paths_m), turn=number)
    near = nearest_uavs(problem, before.solution.paths_m)
    now = before
    for wave in waves(areas):
        if search.interrupted():
            break
        now = _wave(search, now, wave, near, n_starts, seed=search.seed + number)
    if now is before:
        return False
    after = joint_of(problem, now.solution.paths_m, search.run)
    if not search.take(after):
        return False
    gain = after.utility_kbps - before.utility_kbps
    return after.unmet < before.unmet or gain > LEAST_GAIN * abs(before.utility_kbps)


def _wave(search: Search, joint: Joint, wave: list[Area], near: Ints, n_starts: int, seed: int) -> Joint:
    """Return the plan with new paths and links in these areas."""
    problem, tasks, members = search.problem, [], []
    for area in wave:
        users = users_around(problem, joint, near, area)
        if len(users):
            start_m = joint.solution.paths_m[area.uavs]
            inner = area_problem(problem, joint, area, users)
            tasks.append(Improve(area=inner, start_m=start_m, n_starts=n_starts, seed=seed))
            members.append((area, users))
    found = search.run(tasks)
    paths_m = joint.solution.paths_m.copy()
    for (area, _), solution in zip(members, found, strict=True):
        if solution is not None:
            paths_m[area.own] = solution.paths_m[: len(area.own)]
    refused = clashing(problem, joint.solution.paths_m, paths_m, [area.own for area, _ in members])
    serving, hertz = joint.solution.serving.copy(), joint.solution.bandwidth_hz.copy()
    for number, ((area, users), solution) in enumerate(zip(members, found, strict=True)):
        if solution is None:
            continue
        if number in refused:
            paths_m[area.own] = joint.solution.paths_m[area.own]
            continue
        _relink(area, users, solution, serving, hertz)
    return worth(problem, replace(joint.solution, paths_m=paths_m, serving=serving, bandwidth_hz=hertz))


def _relink(area: Area, users: Ints, solution: Solution, serving: Ints, hertz: Array) -> None:
    """Write an area's links into those of all; they may clash with others until the whole fleet is linked anew."""
    rows = slice(0, len(users))
    serving[users] = area.uavs[np.minimum(solution.serving[rows], len(area.uavs) - 1)]
    hertz[users] = solution.bandwidth_hz[rows]


def _solution(joint: Joint, history: list[Iteration]) -> Solution:
    return replace(joint.solution, history=history)
