"""Other ways to plan the same instance, for the quality benchmark; each gets about the same processor time.

`k_means`: hover over the centres of k-means, one climb. `evolution`: SciPy's differential evolution over hover points,
flown straight, with the best links. `ipopt_starts`: IPOPT from hovering and random flights, as many as the time allows.
`ipopt_from_ours`: IPOPT from the straight flights to the places that the planner finds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, linear_sum_assignment

from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.instances import Size, standard
from skyfolio.api.lab.bench.setting import value_kbps
from skyfolio.planner import MaxIterations
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import flyable, linked, optimise
from skyfolio.planner.fast.arena import arena_of
from skyfolio.planner.fast.placement import effort_of, places
from skyfolio.planner.problem import Problem, problem_of

IPOPT_STARTS = 50
IPOPT_CELLS = 50_000
"""U K N up to which IPOPT ends in minutes under `sum`; the other utilities have K links a slot, and it does not."""
KMEANS_RUNS, KMEANS_PASSES = 20, 30


def on_first_layout(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Return what each peer finds on the first layout of one size and utility."""
    instance = standard(size, kind)[0]
    with_ipopt = kind == "sum" and prod(size) <= IPOPT_CELLS
    found = peers(problem_of(instance.scenario()), effort.peers_s, with_ipopt=with_ipopt)
    return {"name": instance.name, "seconds_each": effort.peers_s, "peers": found}


def peers(problem: Problem, seconds: float, *, with_ipopt: bool) -> dict[str, dict[str, Any]]:
    """Return what each peer finds, kbit/s, and in what processor time; `seconds` is what each may begin new work in."""
    ways: dict[str, Callable[[Problem, float], float]] = {"k_means": k_means, "evolution": evolution}
    if with_ipopt:
        ways |= {"ipopt_starts": ipopt_starts, "ipopt_from_ours": ipopt_from_ours}
    found = {}
    for name, way in ways.items():
        began = time.process_time()
        found[name] = {"utility_kbps": way(problem, seconds), "cpu_s": time.process_time() - began}
    return found


def k_means(problem: Problem, seconds: float) -> float:  # noqa: ARG001
    """Hover over the tightest of several k-means clusterings of the users, and climb once."""
    runs = [_clusters(problem, seed) for seed in range(KMEANS_RUNS)]
    place = min(runs, key=lambda one: one[0])[1]
    found = optimise(problem, MaxIterations(50), _flights(problem, place), n_starts=1)
    return value_kbps(problem, found)


def _clusters(problem: Problem, seed: int) -> tuple[float, Array]:
    """(mean squared distance, centres (U, 2)) of one run."""
    rng = np.random.default_rng(seed)
    centres = rng.permutation(np.resize(problem.mean_user_m, (max(problem.n_uavs, problem.n_users), 2)))[
        : problem.n_uavs
    ]
    for _ in range(KMEANS_PASSES):
        label = _away2(problem, centres).argmin(axis=1)
        for u in np.unique(label):  # an empty cluster keeps its centre
            centres[u] = problem.mean_user_m[label == u].mean(axis=0)
    return float(_away2(problem, centres).min(axis=1).mean()), centres


def _away2(problem: Problem, centres: Array) -> Array:
    """Squared metres from each user to each centre: (K, U)."""
    away2: Array = ((problem.mean_user_m[:, None] - centres[None]) ** 2).sum(axis=2)
    return away2


def evolution(problem: Problem, seconds: float) -> float:
    """Differential evolution over hover points (2 U numbers), by the true utility of the straight flights."""
    until = time.process_time() + seconds

    def cost(flat: Array) -> float:
        return -value_kbps(problem, linked(problem, _flights(problem, flat.reshape(-1, 2))))

    def enough(*_: Any, **__: Any) -> bool:
        return time.process_time() > until

    limits = np.tile(np.stack([problem.low_m, problem.high_m], axis=1), (problem.n_uavs, 1))
    result = differential_evolution(
        cost, limits, x0=problem.start_m.ravel(), popsize=2, maxiter=10**6, polish=False, rng=1, callback=enough
    )
    return -float(result.fun)


def ipopt_starts(problem: Problem, seconds: float) -> float:
    """Return the best of up to 50 IPOPT plans, from hovering and from straight flights to random points."""
    rng = np.random.default_rng(1)

    def starts() -> Iterator[Array]:
        yield problem.hover()
        for _ in range(IPOPT_STARTS - 1):
            yield _flights(problem, rng.uniform(problem.low_m, problem.high_m, (problem.n_uavs, 2)))

    return _ipopt(problem, starts(), seconds)


def ipopt_from_ours(problem: Problem, seconds: float) -> float:
    """IPOPT from the straight flights to the best places that one round of the planner's own search finds."""
    arena = arena_of(problem)
    place = places(arena, np.random.default_rng(0), effort_of(arena))[0]
    return _ipopt(problem, iter([_flights(problem, place.T)]), seconds)


def _ipopt(problem: Problem, starts: Iterator[Array], seconds: float) -> float:
    from skyfolio.api.lab.bench.ipopt import Trajectories, alternate  # noqa: PLC0415 - CasADi is a development dependency

    links = problem.n_uavs if problem.kind == "sum" or problem.mu == 0.0 else problem.n_users
    program, until, best = Trajectories(problem, links), time.process_time() + seconds, -np.inf

    def shares(paths: Array) -> tuple[NDArray[np.intp], Array]:
        found = linked(problem, paths)
        return found.serving, found.bandwidth_hz

    for start in starts:
        best = max(best, alternate(problem, shares, start, links, program=program)["utility_kbps"])
        if time.process_time() > until:
            break
    return best


def _flights(problem: Problem, place_m: Array) -> Array:
    """Straight flights (U, N, 2) to places (U, 2), each UAV to the one that makes the way of all shortest."""
    away = np.linalg.norm(problem.start_m[:, None] - place_m[None], axis=2)
    mine = place_m[linear_sum_assignment(away)[1]]
    return flyable(problem, np.repeat(mine[:, None], problem.n_slots, axis=1))
