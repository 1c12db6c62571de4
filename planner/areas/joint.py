"""The whole fleet: what its paths are worth, and what an area's problem is cut out of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from skyfolio.planner.areas.blocks import AreaProblem, Link, Outside, Runner
from skyfolio.planner.areas.matching import Match
from skyfolio.planner.areas.partition import Area, cut
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import served_rates_bps
from skyfolio.planner.feasibility import MIN_RATE_ROUNDING
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Solution

Ints: TypeAlias = NDArray[np.int64]
LOOKS = (0.0, 0.15, 0.5, 1.0)
"""When it is looked at who is near whom, as shares of the plan."""
LATE = 0.9
PARTS = 8
"""Tasks that links are made in."""


@dataclass(frozen=True)
class Joint:
    """A plan of the whole fleet: its solution, rates (K, N), how many minimum rates it misses, and its utility."""

    solution: Solution
    rates_kbps: Array
    unmet: int
    utility_kbps: float

    @property
    def rank(self) -> tuple[int, float]:
        """Greater is better."""
        return -self.unmet, self.utility_kbps


def joint_of(problem: Problem, paths_m: Array, run: Runner) -> Joint:
    """Return what flyable paths (U, N, 2) are worth, with links made for the whole fleet.

    For `sum` without minimum rates they are the best there are to users near each UAV. Else each user belongs to one
    area, whose UAVs alone can serve it, and areas make their links apart.
    """
    made = _matched if is_assignment(problem) else _linked_by_areas
    return worth(problem, made(problem, paths_m, run))


def is_assignment(problem: Problem) -> bool:
    """Return whether links are a linear assignment in each slot."""
    return (problem.kind == "sum" or problem.mu == 0.0) and not (problem.min_kbps > 0.0).any()


def worth(problem: Problem, solution: Solution) -> Joint:
    """Return the solution with its rates, eqs. (1)-(4), and what they are worth."""
    rates_kbps = served_rates_bps(problem, solution) / 1e3
    unmet = int((rates_kbps < problem.min_kbps[:, None] * (1.0 - MIN_RATE_ROUNDING)).sum())
    return Joint(solution, rates_kbps, unmet, problem.utility_kbps(rates_kbps))


def bound_for_m(problem: Problem, paths_m: Array) -> Array:
    """Return where UAVs are late in their flights, (U, 2) metres."""
    late = (LATE * (np.minimum(problem.n_flying, problem.n_slots) - 1)).astype(int)
    places_m: Array = paths_m[np.arange(problem.n_uavs), late]
    return places_m


def nearest_uavs(problem: Problem, paths_m: Array) -> Ints:
    """Return which UAV is nearest to each user, at a few moments: (K, L)."""
    moments = {int(share * (problem.n_slots - 1)) for share in LOOKS}
    near = []
    for n in sorted(moments):
        flying = np.flatnonzero(problem.flying[:, n])
        near.append(flying[KDTree(paths_m[flying, n]).query(problem.mean_user_m)[1]])
    return np.stack(near, axis=1)


def users_around(problem: Problem, joint: Joint, near: Ints, area: Area) -> Ints:
    """Return the users who matter to an area.

    Those are nearest to one of its own UAVs at some moment, or served by a UAV in its problem. Where links are no
    assignment, who is served more by UAVs that are not in its problem is left to those.
    """
    inside, own = np.zeros(problem.n_uavs, dtype=bool), np.zeros(problem.n_uavs, dtype=bool)
    inside[area.uavs] = own[area.own] = True
    hertz = joint.solution.bandwidth_hz
    by_us = inside[joint.solution.serving]
    ours, theirs = (hertz * by_us).sum(axis=1), (hertz * ~by_us).sum(axis=1)
    wanted = (ours > 0.0) | own[near].any(axis=1)
    return np.flatnonzero(wanted if is_assignment(problem) else wanted & (ours >= theirs))


def area_problem(problem: Problem, joint: Joint, area: Area, users: Ints) -> AreaProblem:
    """Return the problem of an area and these users, with the others on the paths of `joint`."""
    uavs, paths_m = area.uavs, joint.solution.paths_m
    others = np.setdiff1d(np.arange(problem.n_uavs), uavs)
    alike = problem.snr_gain[:, 0]
    pinned = paths_m[uavs].copy()
    pinned[: len(area.own)] = np.nan
    inner = replace(
        problem.only(uavs, users),
        snr_gain=alike[uavs][:, None],
        past_kbps=_past(problem, users),
        pinned_m=pinned if len(area.around) else np.zeros((0, 0, 2)),
    )
    serves = (joint.solution.bandwidth_hz[users] > 0.0) & np.isin(joint.solution.serving[users], others)
    if not is_assignment(problem):
        serves[:] = False
    rest_kbps = joint.rates_kbps.sum(axis=0) - (joint.rates_kbps[users] * ~serves).sum(axis=0)
    outside = Outside(
        gain=alike[others],
        paths_m=paths_m[others],
        altitude_m=problem.altitude_m[others],
        serves=serves,
        sum_kbps=rest_kbps,
        decayed=_decayed(problem, joint, users),
    )
    return AreaProblem(problem=inner, outside=outside)


def _decayed(problem: Problem, joint: Joint, users: Ints) -> float:
    """Return the sum of exp(mu rate) of all but these users; only `pooled` needs it."""
    if problem.kind != "pooled" or problem.mu == 0.0:
        return 0.0
    counted = np.delete(problem.counted_kbps(joint.rates_kbps), users, axis=0)
    return float(np.nansum(np.exp(problem.mu * counted)))


def _past(problem: Problem, users: Ints) -> Array:
    """Return the past of these users; for `sum` past slots only add a constant inside the logarithm."""
    return problem.past_kbps[users] if problem.kind != "sum" else np.zeros((len(users), 0))


def _matched(problem: Problem, paths_m: Array, run: Runner) -> Solution:
    """Return the links of all slots, some slots a task."""
    slots = [part for part in np.array_split(np.arange(problem.n_slots), PARTS) if len(part)]
    tasks = [
        Match(
            gain=problem.snr_gain[:, 0, part],
            paths_m=paths_m[:, part],
            altitude_m=problem.altitude_m,
            bandwidth_hz=problem.bandwidth_hz,
            user_m=problem.mean_user_m,
        )
        for part in slots
    ]
    found: list[tuple[Ints, Array]] = run(tasks)
    serving = np.concatenate([one for one, _ in found], axis=1)
    return Solution(paths_m, serving, np.concatenate([hertz for _, hertz in found], axis=1), [])


def _linked_by_areas(problem: Problem, paths_m: Array, run: Runner) -> Solution:
    """Return the links of areas apart, put together; each user belongs to the area of the UAV that is nearest most."""
    areas = [replace(area, around=np.zeros(0, dtype=np.int64)) for area in cut(bound_for_m(problem, paths_m))]
    area_of = np.empty(problem.n_uavs, dtype=np.int64)
    for number, area in enumerate(areas):
        area_of[area.own] = number
    near = area_of[nearest_uavs(problem, paths_m)]
    owner = np.array([np.bincount(row).argmax() for row in near])
    shape = (problem.n_users, problem.n_slots)
    blank = Solution(paths_m, np.zeros(shape, dtype=np.int64), np.zeros(shape), [])
    nobody = Joint(blank, np.zeros(shape), 0, 0.0)
    members = [(area, np.flatnonzero(owner == number)) for number, area in enumerate(areas)]
    members = [(area, users) for area, users in members if len(users)]
    tasks = [
        Link(area=area_problem(problem, nobody, area, users), paths_m=paths_m[area.own]) for area, users in members
    ]
    for (area, users), found in zip(members, run(tasks), strict=True):
        if found is None:
            raise RuntimeError("areas: links were not made")
        blank.serving[users] = area.own[found.serving[: len(users)]]
        blank.bandwidth_hz[users] = found.bandwidth_hz[: len(users)]
    return blank
