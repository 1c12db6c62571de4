"""How good plans are and what they take at their defaults: `plan()` and `replan()` on instances whose best is known.

Only what is measured is kept here: shares of best known values are taken when a report is written, because those grow.
"""

from __future__ import annotations

from functools import partial
from typing import Any, TypeAlias

from skyfolio.api.lab.bench.effort import LARGE, Effort
from skyfolio.api.lab.bench.instances import Instance, Size
from skyfolio.api.lab.bench.measure import timed
from skyfolio.api.lab.bench.setting import Loss, loss_half_way, stop, value_kbps
from skyfolio.planner import Plan, plan
from skyfolio.planner.fast import default_starts, optimise
from skyfolio.planner.problem import problem_of
from skyfolio.planner.rehearsal import rehearse

Row: TypeAlias = dict[str, Any]
BUDGET_S = 2.0
"""Of each timing."""
MANY_STARTS = 12
"""Of the longer search beside a replan."""
WEIGHTS_KBPS = (0.0, 1.0, 10.0)
"""Of replans that change little; with 0 everything may change, to compare with."""


def quality(size: Size, kind: str, effort: Effort) -> Row:
    """Measure plan, gap and a replan after a loss half-way on every instance of one size and utility."""
    rehearse()
    chosen = effort.instances(size, kind)
    return {"instances": [_measured(one, effort, compare=size[0] < LARGE or not i) for i, one in enumerate(chosen)]}


def _limits(size: Size, effort: Effort) -> Row:
    """Return how often calls are timed: those of large fleets once, after everything was compiled and called."""
    if size[0] >= LARGE:
        return {"runs": 1, "budget_s": BUDGET_S, "warm": False}
    return {"runs": effort.plan_runs, "budget_s": BUDGET_S}


def _measured(instance: Instance, effort: Effort, *, compare: bool) -> Row:
    """Measure one instance: the whole call of `plan`, the optimiser in it alone, and a replan.

    compare: whether the replan is set beside what more searching finds.
    """
    scenario, limits = instance.scenario(), _limits(instance.size, effort)
    problem = problem_of(scenario)
    call, made = timed(lambda: plan(scenario), **limits)
    alone, _ = timed(lambda: optimise(problem, stop()), **limits)
    return {
        **described(instance),
        "utility_kbps": made.summary.utility_bps / 1e3,
        "bound_kbps": made.summary.upper_bound_bps / 1e3,
        "plan": call,
        "optimiser": alone,
        "replan": _replanned(made, limits, compare=compare),
    }


def _replanned(made: Plan, limits: Row, *, compare: bool) -> Row:
    loss = loss_half_way(made)
    call, again = timed(loss.replan, **limits)
    alone, _ = timed(lambda: optimise(loss.problem, stop(), loss.warm_m), **limits)
    value = again.summary.utility_bps / 1e3
    more = {"best_of_more_kbps": max(value, *_others(loss))} if compare else {}
    return {"call": call, "optimiser": alone, "utility_kbps": value, **more}


def _others(loss: Loss) -> list[float]:
    """Return what a cold plan and a longer search find for what is left."""
    cold = optimise(loss.problem, stop(), n_starts=max(2, default_starts(loss.problem)))
    longer = optimise(loss.problem, stop(), loss.warm_m, n_starts=MANY_STARTS)
    return [value_kbps(loss.problem, one) for one in (cold, longer)]


def budgets(size: Size, kind: str, effort: Effort) -> Row:
    """Measure what multiples of the default budget find."""
    rows = []
    for instance in effort.with_multiples(size, kind):
        problem = problem_of(instance.scenario())
        starts = default_starts(problem)
        for times in effort.multiples_of(size):
            search = partial(optimise, problem, stop(), n_starts=times * starts)
            taken, found = timed(search, runs=1, budget_s=BUDGET_S, warm=False)
            value = value_kbps(problem, found)
            rows.append({**described(instance), "times": times, "utility_kbps": value, "plan": taken})
    return {"instances": rows}


def disruption(size: Size, kind: str, effort: Effort) -> Row:
    """Measure replans after a loss half-way at a price for changes, and how much they change."""
    rehearse()
    rows = []
    for instance in effort.disrupted(size, kind):
        loss = loss_half_way(plan(instance.scenario()))
        for weight in WEIGHTS_KBPS:
            asked = partial(loss.replan, disruption_weight=weight)
            call, made = timed(asked, runs=3, budget_s=BUDGET_S, least=1, warm=False)
            rows.append({**described(instance), "weight_kbps": weight, "call": call, **_changed(made)})
    return {"instances": rows}


def _changed(made: Plan) -> Row:
    if made.disruption is None:
        raise ValueError("a replan must say what it changes")
    changes = made.disruption.model_dump(include={"user_slots_changed", "path_changed_m"})
    return {"utility_kbps": made.summary.utility_bps / 1e3, **changes}


def described(instance: Instance) -> Row:
    """Return what an instance is, for tables."""
    return {"name": instance.name, "mu_per_kbps": instance.mu_per_kbps, "noise_dbm": instance.noise_dbm}
