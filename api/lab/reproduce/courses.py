"""One scheme flown through one failure: plan for all slots, lose a UAV unannounced, replan for the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from skyfolio.planner import Plan, Scenario, Utility, letter, plan, replan
from skyfolio.planner.arrays import Array
from skyfolio.planner.examples import FADING, LAYOUT_SEED, NOISE_DBM, USER_RADIUS_M
from skyfolio.planner.utility import jain_index, utility_kbps

FAILED = tuple(uav.id for uav in letter().uavs)
"""Each UAV fails in turn; the letter does not say which."""
FAILURE_SLOT = 10
"""Slot 11 of the letter: here slots count from 0."""


@dataclass(frozen=True, kw_only=True)
class Choices:
    """What the letter leaves out, by default as in the `paper` example. Units as in `planner.letter`."""

    noise_dbm: float = NOISE_DBM
    user_radius_m: float | None = USER_RADIUS_M
    fading: Literal["mean", "sampled"] = FADING
    layout_seed: int = LAYOUT_SEED
    fading_seed: int = LAYOUT_SEED

    def scenario(self, utility: Utility) -> Scenario:
        """Return the letter's scenario under these choices."""
        return letter(**vars(self), utility=utility)


@dataclass(frozen=True)
class Scheme:
    """One way to plan: a method of the planner under a utility."""

    name: str
    method: str
    utility: Utility


def pro_alg(kind: str, mu_per_kbps: float) -> Scheme:
    """Return the scheme of the letter's algorithm (its joint fast form) under one of the three utilities."""
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu_per_kbps})
    return Scheme(f"Pro-Alg {kind} mu={mu_per_kbps:g}", "fast", utility)


SR_MAX = Scheme("SR-Max", "sr_max", Utility())
BASELINE_1 = Scheme("Baseline 1", "baseline1", Utility())
BASELINE_2 = Scheme("Baseline 2 (placed)", "baseline2", Utility())
BASELINE_2_FIXED = Scheme("Baseline 2 (at the starts)", "baseline2_fixed", Utility())
READINGS = (BASELINE_2, BASELINE_2_FIXED)
"""The letter has one sentence on its Baseline 2: UAVs fly to an optimised placement, or the placement is the starts."""
COMPARED = (SR_MAX, *READINGS, BASELINE_1)


@dataclass(frozen=True)
class Job:
    """One course to compute: hashable, so that results are found again."""

    choices: Choices
    scheme: Scheme
    failed: str | None


@dataclass(frozen=True)
class Course:
    """What users get over all slots: rates_kbps is (K, N); `gap` is the certified gap of the first plan.

    Period two begins at `at_slot`, counted from 0, which lies inside the table.
    """

    rates_kbps: Array
    gap: float
    at_slot: int = FAILURE_SLOT

    @property
    def sum_kbps(self) -> Array:
        """Sum rate of each slot: (N,)."""
        total: Array = self.rates_kbps.sum(axis=0)
        return total

    def measures(self) -> dict[str, float]:
        """Return the letter's figures of merit for this course. Rates in kbit/s, variance in (kbit/s)^2."""
        total = self.sum_kbps
        return {
            "period_1": float(total[: self.at_slot].mean()),
            "period_2": float(total[self.at_slot :].mean()),
            "before": float(total[self.at_slot - 1]),
            "at_loss": float(total[self.at_slot]),
            "at_end": float(total[-1]),
            "mean": float(total.mean()),
            "variance": float(total.var()),
            "jain": jain_index(self.rates_kbps),
        }


def fly(scenario: Scenario, method: str, failed: str | None, at_slot: int = FAILURE_SLOT) -> Course:
    """Plan for all slots; at `at_slot` the UAV is gone, and the survivors are replanned at once with what was achieved.

    No detection delay, as in the letter. `failed=None`: nothing happens.
    """
    first = plan(scenario, method=method)
    rates = table(first)
    if failed is not None:
        second = replan(first, failed=[failed], at_slot=at_slot, method=method)
        rates = np.hstack([rates[:, :at_slot], table(second)])
    return Course(rates, first.summary.gap, at_slot)


def table(plan: Plan) -> Array:
    """Return the plan's rates, (K, N) kbit/s in user order."""
    return np.array([plan.user_rates_bps[user] for user in plan.scenario.user_ids]) / 1e3


def compute(job: Job) -> Course:
    """Compute the course of a job; runs in a worker process."""
    return fly(job.choices.scenario(job.scheme.utility), job.scheme.method, job.failed)


def utility_of(course: Course, utility: Utility) -> float:
    """Return the utility of all slots flown, kbit/s."""
    return utility_kbps(course.rates_kbps, utility.kind, utility.mu_per_kbps)
