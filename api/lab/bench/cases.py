"""The planner and other solvers from the same start: times, objectives, and what each part gains."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyfolio.api.lab.bench import channels as of_channels
from skyfolio.api.lab.bench.ablation import variants
from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.extensions import extensions
from skyfolio.api.lab.bench.instances import FLEETS, LETTER, Size
from skyfolio.api.lab.bench.measure import peak_mb, timed
from skyfolio.api.lab.bench.setting import loss_half_way, stop, value_kbps
from skyfolio.planner import Plan, Scenario, Utility, plan
from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import upper_bound_kbps
from skyfolio.planner.branch_and_bound import MAX_UAVS, certificate
from skyfolio.planner.fast import linked, optimise, served_rates_bps
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of

SIZES = (LETTER, *FLEETS)
KINDS = ("sum", "per_user")
SEED = 1
STARTS = 32


def instance(size: Size, kind: str, seed: int = SEED) -> Scenario:
    """Return the benchmark's scenario of this size.

    mu is -0.1 per kbit/s for `per_user`, and for `sum` -0.3/U, because the sum rate grows with the fleet: at the
    letter's size that is -0.1 too.
    """
    mu = -0.3 / size[0] if kind == "sum" else -0.1
    return scattered(*size, seed=seed, utility=Utility(kind=kind, mu_per_kbps=mu))


def fast(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure the product: a cold plan from one start, from several, and a replan after a loss half-way.

    `plan` and `replan` time the optimiser alone from one start, as the yardsticks are timed; `*_call` the whole
    `planner.plan` and `planner.replan` at their defaults, with arrays, certificate, feasibility check and plan object.
    """
    runs, budget_s = effort.runs, effort.budget_s
    scenario = instance(size, kind)
    problem = problem_of(scenario)
    before = peak_mb()
    hover = problem.hover()  # the yardsticks begin there too
    cold, solution = timed(lambda: optimise(problem, stop(), hover, n_starts=1), runs=runs, budget_s=budget_s)
    figures: dict[str, Any] = {"plan": {**cold, "utility_kbps": value_kbps(problem, solution)}}
    if size[0] <= MAX_UAVS:
        many, best = timed(lambda: optimise(problem, stop(), n_starts=STARTS), runs=runs, budget_s=budget_s)
        figures["plan_starts"] = {**many, "starts": STARTS, "utility_kbps": value_kbps(problem, best)}
    call, first_plan = timed(lambda: plan(scenario), runs=runs, budget_s=budget_s / 3)
    figures["plan_call"] = call
    figures["bound_kbps"] = upper_bound_kbps(problem)
    figures["gap"] = figures["bound_kbps"] / figures["plan"]["utility_kbps"] - 1
    figures |= _replanned(first_plan, runs, budget_s)
    return figures | {"peak_mb": peak_mb(), "peak_before_mb": before}


def _replanned(first_plan: Plan, runs: int, budget_s: float) -> dict[str, Any]:
    loss = loss_half_way(first_plan)
    again, solution = timed(
        lambda: optimise(loss.problem, stop(), loss.warm_m, n_starts=1), runs=runs, budget_s=budget_s
    )
    call, _ = timed(loss.replan, runs=runs, budget_s=budget_s / 3)
    return {"replan": {**again, "utility_kbps": value_kbps(loss.problem, solution)}, "replan_call": call}


def reference(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure the letter's own method from the same start: Algorithm 1 on cvxpy and Clarabel, and its replan."""
    from skyfolio.planner.reference import algorithm_1  # noqa: PLC0415 - cvxpy takes a second to load

    scenario, runs = instance(size, kind), effort.runs_of_yardsticks
    problem = problem_of(scenario)
    cold, solution = timed(lambda: algorithm_1(problem, stop()), runs=runs, budget_s=1.0)
    loss = loss_half_way(plan(scenario, n_starts=1))
    again, replanned = timed(lambda: algorithm_1(loss.problem, stop(), loss.warm_m), runs=runs, budget_s=1.0)
    return {
        "plan": {**cold, "utility_kbps": value_kbps(problem, solution), "iterations": len(solution.history)},
        "replan": {**again, "utility_kbps": value_kbps(loss.problem, replanned)},
        "peak_mb": peak_mb(),
    }


def ipopt(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure IPOPT for the trajectories, in turn with the fast path's association and bandwidth.

    `solve_ms` is what IPOPT's own calls took, all passes together; building the program (`build_ms`) is not in it.
    """
    from skyfolio.api.lab.bench.ipopt import alternate  # noqa: PLC0415 - CasADi is a development dependency

    problem = problem_of(instance(size, kind))
    links = size[0] if kind == "sum" else size[1]

    def shares(paths: Array) -> tuple[NDArray[np.intp], Array]:
        links = linked(problem, paths)
        return links.serving, links.bandwidth_hz

    solved = [
        alternate(problem, shares, problem.hover(), links)
        for _ in range(1 if size[0] > MAX_UAVS else effort.runs_of_yardsticks)
    ]
    median = {
        key: float(np.median([solution[key] for solution in solved])) * 1e3
        for key in ("solve_s", "solve_cpu_s", "build_s")
    }
    figures: dict[str, Any] = {
        "plan": {"p50_ms": median["solve_s"], "cpu_p50_ms": median["solve_cpu_s"], "runs": len(solved)},
        "build_ms": median["build_s"],
        "peak_mb": peak_mb(),
    }
    figures["plan"] |= {"utility_kbps": solved[0]["utility_kbps"], "passes": solved[0]["passes"]}
    if size[0] <= MAX_UAVS and kind == "sum" and effort.starts_of_ipopt:
        figures["best_of"] = _best_of(problem, shares, links, effort.starts_of_ipopt)
    return figures


def _best_of(problem: Problem, shares: Any, links: int, starts: int) -> dict[str, Any]:
    """Run IPOPT from many starts: hovering, and straight flights to points drawn uniformly in the area."""
    from skyfolio.api.lab.bench.ipopt import Trajectories, alternate  # noqa: PLC0415
    from skyfolio.planner.fast import flyable  # noqa: PLC0415

    rng = np.random.default_rng(SEED)
    program, values, began = Trajectories(problem, links), [], time.perf_counter()
    for number in range(starts):
        places = rng.uniform(problem.low_m, problem.high_m, (problem.n_uavs, 2))
        starts_m = np.repeat(places[:, None], problem.n_slots, axis=1)
        start = problem.hover() if number == 0 else flyable(problem, starts_m)
        values.append(alternate(problem, shares, start, links, program=program)["utility_kbps"])
    return {"starts": starts, "utility_kbps": max(values), "total_ms": (time.perf_counter() - began) * 1e3}


def ablation(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure what each part gains, mean over layouts: alternation, joint step, one start, many starts."""
    layouts = effort.small_layouts
    totals: dict[str, list[tuple[float, float]]] = {}
    for seed in range(layouts):
        problem = problem_of(instance(size, kind, seed))
        for name, solve in variants(problem, stop, STARTS).items():
            began = time.perf_counter()
            solution = solve()
            totals.setdefault(name, []).append((value_kbps(problem, solution), (time.perf_counter() - began) * 1e3))
    means = {name: np.mean(rows, axis=0) for name, rows in totals.items()}
    return {
        "layouts": layouts,
        "rows": [{"what": name, "utility_kbps": float(mean[0]), "ms": float(mean[1])} for name, mean in means.items()],
    }


def proof(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure the certificate at the letter's size: root and branch-and-bound gap, mean over layouts."""
    rows = []
    for seed in range(effort.small_layouts):
        problem = problem_of(instance(size, kind, seed))
        solution = optimise(problem, stop(), n_starts=STARTS)
        worth = value_kbps(problem, solution)
        began = time.perf_counter()
        proven = certificate(problem, served_rates_bps(problem, solution) / 1e3, tolerance=0.01, max_nodes=1_000_000)
        rows.append(
            (proven.root_kbps / worth - 1, proven.bound_kbps / worth - 1, proven.nodes, time.perf_counter() - began)
        )
    root, bound, nodes, seconds = np.array(rows).T
    return {
        "layouts": len(rows),
        "root_gap_mean": float(root.mean()),
        "root_gap_max": float(root.max()),
        "gap_mean": float(bound.mean()),
        "gap_max": float(bound.max()),
        "nodes_mean": float(nodes.mean()),
        "seconds_mean": float(seconds.mean()),
    }


def users(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure what tracks, windows, weights and demands of users cost."""
    return extensions([instance(size, kind, seed) for seed in range(effort.small_layouts)], effort)


def channels(size: Size, kind: str, effort: Effort) -> dict[str, Any]:
    """Measure what other kinds of channels cost."""
    return of_channels.channels([instance(size, kind, seed) for seed in range(effort.small_layouts)], effort)
