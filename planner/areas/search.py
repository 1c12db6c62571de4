"""Rounds over the areas until the joint utility stops improving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from skyfolio.planner.areas.blocks import AreaProblem, Improve, Runner, Task
from skyfolio.planner.areas.joint import (
    Ints,
    Joint,
    area_problem,
    bound_for_m,
    joint_of,
    nearest_uavs,
    users_around,
    worth,
)
from skyfolio.planner.areas.partition import Area, cut, nearby, waves
from skyfolio.planner.areas.sketch import REGION, USERS, Place, coarse_places, drawn
from skyfolio.planner.areas.together import together
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.arena import Arena, arena_of, plain
from skyfolio.planner.fast.blocked import who_is_blocked
from skyfolio.planner.fast.routes import with_routes
from skyfolio.planner.fast.seeds import bound_for, flown, hovering
from skyfolio.planner.plans import Iteration
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Observer, Solution, ignore
from skyfolio.planner.stopping import StoppingRule
from skyfolio.planner.unreachable import UnreachableEndError
from skyfolio.planner.unsuited import UnsuitedError

ROUNDS = 3
LEAST_GAIN = 1e-3
"""Relative: a round that gains less is the last one."""
FIRST_STARTS, STARTS = 4, 2
"""Starts of each area in the first round and in each of the others, unless the caller says otherwise."""
NOBODY = np.zeros(0, dtype=np.int64)


@dataclass
class Search:
    """The best plan so far of the whole fleet. among: the UAVs that are planned anew, all of them if None."""

    problem: Problem
    stop: StoppingRule
    observer: Observer
    run: Runner
    seed: int
    among: Ints | None = None
    best: Joint | None = None
    history: list[Iteration] = field(default_factory=list)

    def interrupted(self) -> bool:
        """Return whether an interrupting rule speaks."""
        return self.stop([]) and self.stop.interrupts

    def take(self, joint: Joint) -> bool:
        """Keep a plan if it is better than the best; return whether it is."""
        if self.best is not None and joint.rank <= self.best.rank:
            return False
        if self.best is not None and joint.utility_kbps < self.best.utility_kbps:
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
    run: Runner | None = None,
    around_m: Array | None = None,
) -> Solution:
    """Return the best plan that rounds over the areas find from a sketch, or from `start_m`, (U, N, 2) metres.

    n_starts: of each area in the first round. run: runs the tasks of areas that can be planned at the same time
    (default: one after the other, here). The result does not depend on it, but for interruptions. around_m: (P, 2),
    metres, with `start_m`: only areas around these points are planned anew, the other UAVs fly on as in `start_m`.
    Raises UnreachableEndError when no paths to all ends are found, and ValueError for fading other than `mean`, for
    pins, and for users who move, come and go, have a weight or ask for no more than some rate.
    """
    _require_able(problem)
    search = Search(problem, stop, observer, run or partial(_one_by_one, stop), seed)
    first = joint_of(problem, _first_paths(search, start_m), search.run)
    search.take(first)
    if around_m is not None and start_m is not None:
        search.among = nearby(bound_for_m(problem, first.solution.paths_m), around_m)
    for number in range(ROUNDS):
        if search.interrupted() or not _round(search, number, n_starts or (STARTS if number else FIRST_STARTS)):
            break
    assert search.best is not None  # noqa: S101 - the first plan was taken
    return _solution(search.best, search.history)


def _require_able(problem: Problem) -> None:
    if problem.draws.size or (problem.n_users > 1 and problem.snr_gain.strides[1] != 0):
        raise UnsuitedError(
            "channel.fading, corrections_db: 'areas' plans the 'mean' channel, with corrections of UAVs ('*') but none "
            "of single links; use 'fast'"
        )
    if problem.bends is not None:
        raise UnsuitedError(
            "channel.kind, channel.antenna: 'areas' plans the letter's channel without an antenna; use 'fast'"
        )
    if problem.pinned_m.size or problem.pinned_to.size:
        raise UnsuitedError("pins: the method 'areas' keeps no pins")
    if not problem.has_plain_users:
        raise UnsuitedError("users: the method 'areas' knows no tracks, windows, weights or demands; use 'fast'")


def _one_by_one(stop: StoppingRule, tasks: Sequence[Task]) -> list[Any]:
    return [task.run(stop) for task in tasks]


def _first_paths(search: Search, start_m: Array | None) -> Array:
    """Return flyable paths (U, N, 2): those given, straight flights to the sketched places, or hovering."""
    problem = search.problem
    arena = with_routes(problem, arena_of(problem))
    if start_m is not None:
        path = flown(arena, plain(start_m.transpose(1, 2, 0)), chase=True)
    else:
        path = _sketched(search, arena)
    path = hovering(arena) if path is None else path
    if path is None:
        raise UnreachableEndError(who_is_blocked(problem))
    return np.ascontiguousarray(path.transpose(2, 0, 1))


def _sketched(search: Search, arena: Arena) -> Array | None:
    """Return straight flights (N, 2, U) to places that are good for each region, None where they cannot be flown."""
    problem = search.problem
    places_m = coarse_places(problem, search.seed, search.interrupted)
    path = bound_for(arena, plain(places_m.T))
    if path is None or search.interrupted():
        return path
    blank = np.zeros((problem.n_users, problem.n_slots))
    paths_m = np.ascontiguousarray(path.transpose(2, 0, 1))
    coarse = Joint(Solution(paths_m, blank.astype(np.int64), blank, []), blank, 0, 0.0)
    regions = [replace(area, around=NOBODY) for area in cut(places_m, most=REGION)]
    near = nearest_uavs(problem, paths_m)
    tasks, members = [], []
    for region in regions:
        users = np.flatnonzero(np.isin(near, region.own).any(axis=1))
        users = users[drawn(len(users), USERS * len(region.own), search.seed)]
        if len(users):
            inner = area_problem(problem, coarse, region, users)
            tasks.append(Place(area=inner, given_m=places_m[region.own], seed=search.seed))
            members.append(region)
    for region, found in zip(members, search.run(tasks), strict=True):
        if found is not None:
            places_m[region.own] = found
    finer = bound_for(arena, plain(places_m.T))
    return path if finer is None else finer


def _round(search: Search, number: int, n_starts: int) -> bool:
    """Plan every area anew once; return whether the joint utility grew enough for another round."""
    assert search.best is not None  # noqa: S101 - a round begins from a plan
    before, problem = search.best, search.problem
    places_m = bound_for_m(problem, before.solution.paths_m)
    areas = cut(places_m, turn=number, among=search.among)
    near = nearest_uavs(problem, before.solution.paths_m)
    for wave in waves(areas):
        if search.interrupted():
            return False
        _wave(search, wave, near, n_starts, search.seed + number)
    after = search.best
    if after is not before and not search.interrupted():
        search.take(joint_of(problem, after.solution.paths_m, search.run))
        after = search.best
    gain = after.utility_kbps - before.utility_kbps
    return after.unmet < before.unmet or gain > LEAST_GAIN * abs(before.utility_kbps)


def _wave(search: Search, wave: list[Area], near: Ints, n_starts: int, seed: int) -> None:
    """Plan these areas anew at the same time, and keep what makes the whole plan better, area by area."""
    assert search.best is not None  # noqa: S101 - a round begins from a plan
    problem, joint = search.problem, search.best
    asked = []
    for area in wave:
        users = users_around(problem, joint, near, area)
        if len(users):
            asked.append((area, users, area_problem(problem, joint, area, users)))
    paths_m = joint.solution.paths_m
    tasks = [Improve(area=one, start_m=paths_m[area.uavs], n_starts=n_starts, seed=seed) for area, _, one in asked]
    for (area, users, inner), found in zip(asked, search.run(tasks), strict=True):
        if found is not None:
            changed = _with_area(search.best.solution, area, users, inner, found)
            if together(problem, changed.paths_m, area.own):
                search.take(worth(problem, changed))


def _with_area(whole: Solution, area: Area, users: Ints, inner: AreaProblem, found: Solution) -> Solution:
    """Return the plan of the whole fleet with an area's new paths and links.

    The bands of all UAVs in its problem are shared anew, so that no user outside it keeps any of them. Who was given a
    band by another UAV meanwhile keeps it, unless the area serves that user now.
    """
    paths_m, serving, hertz = whole.paths_m.copy(), whole.serving.copy(), whole.bandwidth_hz.copy()
    paths_m[area.own] = found.paths_m[: len(area.own)]
    inside = np.zeros(len(paths_m), dtype=bool)
    inside[area.uavs] = True
    hertz[inside[serving]] = 0.0
    rows = slice(0, len(users))
    by = area.uavs[np.minimum(found.serving[rows], len(area.uavs) - 1)]
    real = found.serving[rows] < len(area.uavs)  # and not the UAV that stands for the others
    given = np.where(real & ~inner.outside.serves, found.bandwidth_hz[rows], 0.0)
    ours = (given > 0.0) | ((hertz[users] == 0.0) & ~inner.outside.serves)
    serving[users] = np.where(ours, by, serving[users])
    hertz[users] = np.where(ours, given, hertz[users])
    return replace(whole, paths_m=paths_m, serving=serving, bandwidth_hz=hertz)


def _solution(joint: Joint, history: list[Iteration]) -> Solution:
    return replace(joint.solution, history=history)
