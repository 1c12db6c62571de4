"""Ablations that the letter does not show: the contribution of each part, and the value of foresight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from skyfolio.api.lab.reproduce.courses import FAILURE_SLOT, Choices, Course, fly, table, utility_of
from skyfolio.planner import Utility, fast, plan
from skyfolio.planner.arrays import Array
from skyfolio.planner.baselines import nearest_uav
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.sinr import spectral_efficiency

Rule = Literal["equal", "best"]
SUM = Utility(kind="sum", mu_per_kbps=0.0)


@dataclass(frozen=True)
class Layout:
    """One layout to take apart; runs in a worker process."""

    choices: Choices


def parts(job: Layout) -> dict[str, float]:
    """Mean sum rate, kbit/s, with each of trajectories Q, association A and bandwidth B planned or by rule of thumb."""
    scenario = job.choices.scenario(SUM)
    problem = problem_of(scenario)
    first_plan = plan(scenario, method="fast")
    planned = np.array([first_plan.trajectories_m[uav] for uav in scenario.uav_ids])
    found = {}
    for name, paths in (("static", problem.hover()), ("planned", planned)):
        found[f"Q {name}, A nearest, B equal"] = _nearest(problem, paths, "equal")
        found[f"Q {name}, A nearest, B planned"] = _nearest(problem, paths, "best")
        found[f"Q {name}, A and B planned"] = _joint(problem, paths)
    return found


def solvers(job: Layout) -> dict[str, float]:
    """Mean sum rate, kbit/s: alternation as printed, the exact joint step from one start and many; and the bound."""
    scenario = job.choices.scenario(SUM)
    many = plan(scenario, method="fast")
    return {
        "Algorithm 1 as printed, from hover": plan(scenario, method="paper").summary.mean_sum_rate_bps / 1e3,
        "exact joint A and B, one start": plan(scenario, method="fast", n_starts=1).summary.mean_sum_rate_bps / 1e3,
        "exact joint A and B, many starts": many.summary.mean_sum_rate_bps / 1e3,
        "upper bound (reachability)": many.summary.upper_bound_bps / 1e3,
    }


@dataclass(frozen=True)
class Foresight:
    """One layout, one loss, one utility; runs in a worker process."""

    choices: Choices
    failed: str
    utility: Utility


def foresight(job: Foresight) -> dict[str, float]:
    """Return the utility of all slots, kbit/s: the loss ignored, replanned, and known from the start."""
    scenario = job.choices.scenario(job.utility)
    first = plan(scenario, method="fast")
    served = table(first)
    lost = np.array([[uav == job.failed for uav in first.association[user]] for user in scenario.user_ids])
    deaf = served * ~(lost & (np.arange(scenario.slots) >= FAILURE_SLOT))
    known = scenario.with_changes(
        uavs=tuple(
            uav.model_copy(update={"leaves_at_slot": FAILURE_SLOT}) if uav.id == job.failed else uav
            for uav in scenario.uavs
        )
    )
    clairvoyant = plan(known, method="fast")
    replanned = fly(scenario, "fast", job.failed)
    return {
        "loss ignored": utility_of(Course(deaf, 0.0), job.utility),
        "replanned at the loss": utility_of(replanned, job.utility),
        "loss known from the start": clairvoyant.summary.utility_bps / 1e3,
        "bound with the loss known": clairvoyant.summary.upper_bound_bps / 1e3,
    }


def mean_rows(rows: list[dict[str, float]]) -> list[dict[str, Any]]:
    """Mean and spread of each named value over the jobs."""
    return [
        {"name": name, "mean": float(np.mean(values)), "spread": float(np.std(values))}
        for name in rows[0]
        for values in ([row[name] for row in rows],)
    ]


def _nearest(problem: Problem, paths: Array, rule: Rule) -> float:
    """Serve each user from its nearest UAV, which splits its band equally or gives it to its best user."""
    efficiency = spectral_efficiency(problem, paths)
    mine = nearest_uav(problem, paths) == np.arange(problem.n_uavs)[:, None, None]  # (U, K, N)
    rates = np.where(mine, efficiency, 0.0)
    of_band = rates.max(axis=1) if rule == "best" else rates.sum(axis=1) / np.maximum(mine.sum(axis=1), 1)
    return float((problem.bandwidth_hz[:, None] * of_band).sum(axis=0).mean()) / 1e3


def _joint(problem: Problem, paths: Array) -> float:
    """Whole bands to distinct users, the best pairing of each slot."""
    rates_bps = fast.served_rates_bps(problem, fast.linked(problem, paths))
    return float(rates_bps.sum(axis=0).mean()) / 1e3
