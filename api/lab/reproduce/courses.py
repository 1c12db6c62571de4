"""One scheme flown through one failure: plan for all slots, lose a UAV unannounced, replan for the rest.

Curves such as the letter's are averages over channel realisations: a course here is the mean of the rates per slot
over `Choices.draws` draws of the fading, and variance and Jain's index are taken of that mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from skyfolio.planner import Plan, Scenario, Utility, delivered_rates_bps, letter, plan, replan
from skyfolio.planner.arrays import Array
from skyfolio.planner.scenario import Fading
from skyfolio.planner.utility import jain_index, utility_kbps

FAILED = tuple(uav.id for uav in letter().uavs)
"""Each UAV fails in turn; the letter does not say which."""
FAILURE_SLOT = 10
"""Slot 11 of the letter: here slots count from 0."""
FIRST_LAYOUT = 100
"""Seeds of user layouts count from here; the calibration has others."""
AROUND = 3
"""Slots that are averaged before the loss, from it on, and at the end."""
STARTS = 8
"""Climbs of the fast path for each plan: a quarter of the planner's default, because every draw is planned for."""
Knows = Literal["draw", "statistics"]
"""What planners know of the fading: the draws of all slots, as in the letter's formulas, or its mean alone."""


@dataclass(frozen=True, kw_only=True)
class Choices:
    """What the letter leaves out, by default as the calibration found it. Units as in `planner.letter`.

    draws: so many realisations of the fading are averaged, 1 under mean fading, where all are the same. Each layout
    has draws of its own, so that a spread over layouts is one over draws too.
    """

    noise_dbm: float = -60.0
    user_radius_m: float | None = 105.0
    fading: Fading = "sampled"
    draws: int = 8
    knows: Knows = "draw"
    layout_seed: int = FIRST_LAYOUT

    def scenario(self, utility: Utility, draw: int = 0, *, planned: bool = True) -> Scenario:
        """Return the letter's scenario under these choices, in one draw: as planners see it, or as it is."""
        told = "mean" if planned and self.knows == "statistics" else self.fading
        return letter(
            noise_dbm=self.noise_dbm,
            user_radius_m=self.user_radius_m,
            layout_seed=self.layout_seed,
            fading=told,
            fading_seed=self.layout_seed + 1000 * draw,
            utility=utility,
        )

    @property
    def n_draws(self) -> int:
        """How many draws differ."""
        return 1 if self.fading == "mean" else self.draws


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
    """One scheme under these choices, each UAV of `failed` lost in turn (None: nothing happens).

    Hashable, so that results are found again.
    """

    choices: Choices
    scheme: Scheme
    failed: tuple[str | None, ...] = FAILED


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
        """Return the letter's figures of merit for this course. Rates in kbit/s, variance in (kbit/s)^2.

        `before`, `at_loss` and `at_end` are means over AROUND slots: single slots are mostly the draw's.
        """
        total = self.sum_kbps
        return {
            "period_1": float(total[: self.at_slot].mean()),
            "period_2": float(total[self.at_slot :].mean()),
            "before": float(total[max(self.at_slot - AROUND, 0) : self.at_slot].mean()),
            "at_loss": float(total[self.at_slot :][:AROUND].mean()),
            "at_end": float(total[self.at_slot :][-AROUND:].mean()),
            "mean": float(total.mean()),
            "variance": float(total.var()),
            "jain": jain_index(self.rates_kbps),
        }


@dataclass(frozen=True)
class Flown:
    """A job's courses before they are averaged.

    draws_kbps: (S, F, K, N), draw by draw and loss by loss; gap: the mean certified gap of the first plans.
    """

    draws_kbps: Array
    gap: float

    def course(self, lost: int, draws: Sequence[int] | slice = slice(None)) -> Course:
        """Return the mean course over some of the draws, for the loss of this index."""
        return Course(self.draws_kbps[draws, lost].mean(axis=0), self.gap)


def fly(scenario: Scenario, method: str, failed: str | None, at_slot: int = FAILURE_SLOT, **options: Any) -> Course:
    """Plan for all slots; at `at_slot` the UAV is gone, and the survivors are replanned at once with what was achieved.

    No detection delay, as in the letter. `failed=None`: nothing happens. options: as for `plan`.
    """
    flight = _Flight(plan(scenario, method=method, **options), at_slot, options)
    return Course(flight.rates(failed), flight.first.summary.gap, at_slot)


class _Flight:
    """A plan that has been made, and what comes of it; replans that do not depend on what was drawn are kept."""

    def __init__(self, first: Plan, at_slot: int, options: Mapping[str, Any]) -> None:
        self.first, self._at_slot, self._options = first, at_slot, options
        self._replans: dict[str, Plan] = {}

    def rates(self, failed: str | None, truth: Scenario | None = None) -> Array:
        """Return what users get when this UAV is lost: (K, N) kbit/s, promised, or as `truth`'s channel has it."""
        rates = table(self.first, truth)
        if failed is None:
            return rates
        past = rates[:, : self._at_slot]
        return np.hstack([past, table(self._replanned(failed, None if truth is None else past), truth)])

    def _replanned(self, failed: str, achieved_kbps: Array | None) -> Plan:
        scenario = self.first.scenario
        asked = {"failed": [failed], "at_slot": self._at_slot, **self._options}
        if achieved_kbps is not None and scenario.utility.kind != "sum":  # to `sum`, the past is a constant
            achieved = dict(zip(scenario.user_ids, (achieved_kbps * 1e3).tolist(), strict=True))
            return replan(self.first, achieved_rates_bps=achieved, **asked)
        if failed not in self._replans:
            self._replans[failed] = replan(self.first, **asked)
        return self._replans[failed]


def table(plan: Plan, truth: Scenario | None = None) -> Array:
    """Return the plan's rates: (K, N) kbit/s in user order, as promised, or as they are in the channel of `truth`."""
    if truth is None:
        return np.array([plan.user_rates_bps[user] for user in plan.scenario.user_ids]) / 1e3
    really = plan.model_copy(update={"scenario": plan.scenario.with_changes(channel=truth.channel)})
    paths = np.array([plan.trajectories_m[uav] for uav in plan.scenario.uav_ids])
    n_uavs, n_slots = paths.shape[:2]
    sending = np.ones((n_slots, n_uavs), dtype=bool)
    got: Array = delivered_rates_bps(really, np.arange(n_slots), paths.transpose(1, 0, 2), sending).T / 1e3
    return got


def compute(job: Job) -> Flown:
    """Compute all draws and losses of a job; runs in a worker process."""
    choices, scheme = job.choices, job.scheme
    options: dict[str, Any] = {"method": scheme.method, "n_starts": STARTS}
    guessed = choices.fading != "mean" and choices.knows == "statistics"
    flight = None
    rates, gaps = [], []
    for draw in range(choices.n_draws):
        if flight is None or not guessed:
            flight = _Flight(plan(choices.scenario(scheme.utility, draw), **options), FAILURE_SLOT, options)
        truth = choices.scenario(scheme.utility, draw, planned=False) if guessed else None
        rates.append([flight.rates(failed, truth) for failed in job.failed])
        gaps.append(flight.first.summary.gap)
    return Flown(np.array(rates), float(np.mean(gaps)))


def utility_of(course: Course, utility: Utility) -> float:
    """Return the utility of all slots flown, kbit/s."""
    return utility_kbps(course.rates_kbps, utility.kind, utility.mu_per_kbps)
