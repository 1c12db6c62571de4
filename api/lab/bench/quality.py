"""How good plans are: the share of the best known value that default, double and tenfold budgets reach, and peers."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from skyfolio.api.lab.bench.best_known import Instance, improve, instances, load
from skyfolio.api.lab.bench.measure import timed
from skyfolio.api.lab.bench.peers import peers, value_kbps
from skyfolio.planner import AnyOf, MaxIterations, RelativeGain, plan
from skyfolio.planner.fast import default_starts, optimise
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.remainder import remaining

Row: TypeAlias = dict[str, Any]
BUDGETS = (1, 2, 10)
MIDDLE, LARGE = 15, 40
LAYOUTS_OF_MIDDLE, LAYOUTS_OF_LARGE = 3, 1
"""From 15 and from 40 UAVs on only so many layouts, and from 40 no tenfold budget: the benchmark has to end."""
PEERS_S = 20.0
IPOPT_CELLS = 50_000
"""U K N up to which IPOPT ends in minutes under `sum`; the other utilities have K links a slot, and it does not."""
ASKED = {
    "10x100x50": {"share": 0.99, "sum_ms": 120.0, "other_ms": 500.0, "replan_ms": 30.0},
    "20x300x100": {"share": 0.985, "sum_ms": 400.0, "other_ms": 1500.0, "replan_ms": 100.0},
    "50x1000x100": {"share": 0.98, "sum_ms": 1500.0, "other_ms": 6000.0, "replan_ms": 400.0},
}
REPLAN_SHARE = 0.98
MANY_STARTS = 12


def quality(size: tuple[int, int, int], kind: str, *, quick: bool) -> Row:
    """Return all instances of one size and utility, and the peers on the first of them."""
    chosen = [one for one in instances(size) if one.kind == kind]
    if quick or size[0] >= MIDDLE:
        chosen = chosen[: 1 if quick else LAYOUTS_OF_LARGE if size[0] >= LARGE else LAYOUTS_OF_MIDDLE]
    budgets = BUDGETS[:1] if quick else BUDGETS[:2] if size[0] >= LARGE else BUDGETS
    rows = [_measured(one, budgets, note=not quick) for one in chosen]
    figures: Row = {
        "instances": rows,
        "share": _mean(rows, "1"),
        "shares": {str(b): _mean(rows, str(b)) for b in budgets},
    }
    figures["plan_cpu_ms"] = float(np.mean([row["plan"]["cpu_p50_ms"] for row in rows]))
    figures["replan_cpu_ms"] = float(np.mean([row["replan"]["cpu_p50_ms"] for row in rows]))
    figures["replan_share"] = float(np.mean([row["replan"]["share"] for row in rows]))
    if not quick:
        problem = problem_of(chosen[0].scenario())
        with_ipopt = kind == "sum" and int(np.prod(size)) <= IPOPT_CELLS
        figures["peers"] = peers(problem, PEERS_S, with_ipopt=with_ipopt)
        for name, found in figures["peers"].items():
            improve(chosen[0], found["utility_kbps"], f"peer {name}", found["cpu_s"])
            found["share"] = found["utility_kbps"] / load()[chosen[0].name]["utility_kbps"]
    return figures


def _mean(rows: list[Row], budget: str) -> float:
    return float(np.mean([row["shares"][budget] for row in rows]))


def _rule() -> AnyOf:
    return AnyOf(MaxIterations(50), RelativeGain(1e-4))


def _measured(instance: Instance, budgets: tuple[int, ...], *, note: bool) -> Row:
    """One instance: values and shares by budget, the time of a default plan, and a replan after a loss half-way.

    note: whether values that beat what is known are written to the file.
    """
    scenario = instance.scenario()
    problem = problem_of(scenario)
    starts = default_starts(problem)
    time_of_plan, found = timed(lambda: optimise(problem, _rule()), runs=5, budget_s=2.0)
    values = {"1": value_kbps(problem, found)}
    for budget in budgets[1:]:
        values[str(budget)] = value_kbps(problem, optimise(problem, _rule(), n_starts=budget * starts))
    for times, value in values.items() if note else ():
        improve(instance, value, f"planner, {times}x the default budget", time_of_plan["best_ms"] * int(times) / 1e3)
    best = max(load().get(instance.name, {}).get("utility_kbps", -np.inf), *values.values(), values["1"])
    return {
        "name": instance.name,
        "best_known_kbps": best,
        "values_kbps": values,
        "shares": {budget: value / best for budget, value in values.items()},
        "plan": time_of_plan,
        "replan": _replanned(instance),
    }


def _replanned(instance: Instance) -> Row:
    """Return the last UAV is lost half-way: the default replan beside the best of this and many more starts."""
    scenario = instance.scenario()
    made, half = plan(scenario), scenario.slots // 2
    rest, past = remaining(made, [scenario.uav_ids[-1]], half)
    problem = problem_of(rest, past)
    warm = np.array([made.trajectories_m[uav][half:] for uav in rest.uav_ids])
    times, found = timed(lambda: optimise(problem, _rule(), warm), runs=5, budget_s=1.0)
    value = value_kbps(problem, found)
    return times | {"utility_kbps": value, "share": value / max(value, *_others(problem, warm))}


def _others(problem: Problem, warm: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    cold = optimise(problem, _rule(), n_starts=max(2, default_starts(problem)))
    longer = optimise(problem, _rule(), warm, n_starts=MANY_STARTS)
    return [value_kbps(problem, one) for one in (cold, longer)]


def targets(figures: Row) -> list[Row]:
    """Return what was asked of `figures["quality"]` beside what was measured."""
    found: list[Row] = []
    for size, by_kind in figures["quality"].items():
        asked = ASKED.get(size)
        for kind, case in by_kind.items():
            if asked is None or "share" not in case:
                continue
            limit = asked["sum_ms"] if kind == "sum" else asked["other_ms"]
            name = f"{size} {kind}"
            found += [
                _at_least(f"{name}: share of best known", case["share"], asked["share"]),
                _at_most(f"{name}: default plan, ms", case["plan_cpu_ms"], limit),
                _at_most(f"{name}: default replan, ms", case["replan_cpu_ms"], asked["replan_ms"]),
                _at_least(f"{name}: replan, share of more searching", case["replan_share"], REPLAN_SHARE),
            ]
    return found


def _at_most(what: str, measured: float, limit: float) -> Row:
    return {"what": what, "measured": measured, "at_most": limit, "met": measured <= limit}


def _at_least(what: str, measured: float, limit: float) -> Row:
    return {"what": what, "measured": measured, "at_least": limit, "met": measured >= limit}
