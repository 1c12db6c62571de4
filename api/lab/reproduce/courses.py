"""One scheme flown through one failure: plan for all slots, lose a UAV unannounced, replan for the rest.

Curves such as the letter's are averages over channel realisations: a course here is the mean of the rates per slot
over `Choices.draws` draws of the fading, and variance and Jain's index are taken of that mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
STARTS = 2
"""Climbs of the fast path for each plan: every draw is planned for, and more climbs hardly change means over draws."""
Split = Literal["3, 3, 3", "4, 3, 2", "drawn"]
"""How many of the nine users are near which start: so many, in an order drawn for each layout, or one by one drawn."""
N_USERS, SPLIT_STREAM = 9, 1
Knows = Literal["draw", "expectation", "statistics"]
"""What planners know of the fading: the draws of all slots, as in the letter's formulas; its distribution, over which
they average; or its mean alone."""
DRAWS_OF_PLANNERS = 16
"""Over so many draws of their own do planners average that know the distribution."""
PLANNED_FOR: Mapping[Knows, Fading | None] = {"draw": None, "expectation": "expected", "statistics": "mean"}
"""The fading of the scenario that is planned; None: the true one."""


@dataclass(frozen=True, kw_only=True)
class Choices:
    """What the letter leaves out, by default as the calibration found it. Units as in `planner.letter`.

    draws: so many realisations of the fading are averaged, 1 under mean fading, where all are the same. Each layout
    has draws of its own, so that a spread over layouts is one over draws too.
    """

    noise_dbm: float = -80.0
    user_radius_m: float | None = 100.0
    split: Split = "4, 3, 2"
    fading: Fading = "sampled"
    draws: int = 24
    knows: Knows = "draw"
    layout_seed: int = FIRST_LAYOUT

    def scenario(self, utility: Utility, draw: int = 0, *, planned: bool = True) -> Scenario:
        """Return the letter's scenario under these choices, in one draw: as planners see it, or as it is."""
        known = PLANNED_FOR[self.knows] if planned and self.fading != "mean" else None
        scenario = letter(
            noise_dbm=self.noise_dbm,
            user_radius_m=self.user_radius_m,
            users_per_uav=self.users_per_uav(),
            layout_seed=self.layout_seed,
            fading=known or self.fading,
            fading_seed=self.layout_seed + 1000 * draw,
            utility=utility,
        )
        if known != "expected":
            return scenario
        return scenario.with_changes(channel=scenario.channel.model_copy(update={"draws": DRAWS_OF_PLANNERS}))

    def users_per_uav(self) -> tuple[int, ...]:
        """Return how many users there are near each start in this layout."""
        rng = np.random.default_rng((self.layout_seed, SPLIT_STREAM))
        n_uavs = len(FAILED)
        if self.split == "drawn":
            near = rng.integers(n_uavs, size=N_USERS)
            return tuple(int((near == uav).sum()) for uav in range(n_uavs))
        return tuple(map(int, rng.permutation([int(n) for n in self.split.split(", ")])))

    @property
    def n_draws(self) -> int:
        """How many draws differ."""
        return 1 if self.fading == "mean" else self.draws


@dataclass(frozen=True)
class Scheme:
    """One way to plan: a method of the planner under a utility. knows: where it is not as `Choices` say."""

    name: str
    method: str
    utility: Utility
    knows: Knows | None = None


def pro_alg(kind: str, mu_per_kbps: float) -> Scheme:
    """Return the scheme of the letter's algorithm (its joint fast form) under one of the three utilities."""
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu_per_kbps})
    return Scheme(f"Pro-Alg {kind} mu={mu_per_kbps:g}", "fast", utility)


SR_MAX = Scheme("SR-Max", "sr_max", Utility())
BASELINE_1 = Scheme("Baseline 1", "baseline1", Utility())
BASELINE_2 = Scheme("Baseline 2 (placed)", "baseline2", Utility())
BASELINE_2_FIXED = Scheme("Baseline 2 (at the starts)", "baseline2_fixed", Utility())
BASELINE_2_ONCE = Scheme("Baseline 2 (for the mean channel)", "baseline2", Utility(), "statistics")
READINGS = (BASELINE_2_ONCE, BASELINE_2, BASELINE_2_FIXED)
"""The letter has one sentence on its Baseline 2, which "does not take into consideration" trajectories or association.

Placement and bandwidth are optimised once, for the mean channel, as a problem without slots has to do it; or UAVs fly
to that placement and bandwidth follows every draw; or the starts are the placement, and bandwidth follows every draw.
"""
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

    Period two begins at `at_slot`, counted from 0, which lies inside the table. unadjusted_kbps: the mean sum rate of
    period two had the others flown and served on as if no UAV were lost; NaN where that was not computed.
    """

    rates_kbps: Array
    gap: float
    at_slot: int = FAILURE_SLOT
    unadjusted_kbps: float = float("nan")

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
            "unadjusted": self.unadjusted_kbps,
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

    draws_kbps: (S, F, K, N), draw by draw and loss by loss; unadjusted_kbps: (S, F), as in `Course`; gap: the mean
    certified gap of the first plans.
    """

    draws_kbps: Array
    unadjusted_kbps: Array
    gap: float

    def course(self, lost: int, draws: Sequence[int] | slice = slice(None)) -> Course:
        """Return the mean course over some of the draws, for the loss of this index."""
        unadjusted = float(self.unadjusted_kbps[draws, lost].mean())
        return Course(self.draws_kbps[draws, lost].mean(axis=0), self.gap, unadjusted_kbps=unadjusted)


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

    def unadjusted_kbps(self, failed: str | None, truth: Scenario | None = None) -> float:
        """Return the mean sum rate of period two when the others fly and serve on as if this UAV were not lost."""
        return float(table(self.first, truth or self.first.scenario, failed)[:, self._at_slot :].sum(axis=0).mean())

    def _replanned(self, failed: str, achieved_kbps: Array | None) -> Plan:
        scenario = self.first.scenario
        asked = {"failed": [failed], "at_slot": self._at_slot, **self._options}
        if achieved_kbps is not None and scenario.utility.kind != "sum":  # to `sum`, the past is a constant
            achieved = dict(zip(scenario.user_ids, (achieved_kbps * 1e3).tolist(), strict=True))
            return replan(self.first, achieved_rates_bps=achieved, **asked)
        if failed not in self._replans:
            self._replans[failed] = replan(self.first, **asked)
        return self._replans[failed]


def table(plan: Plan, truth: Scenario | None = None, silent: str | None = None) -> Array:
    """Return the plan's rates: (K, N) kbit/s in user order, as promised, or as they are in the channel of `truth`.

    silent: a UAV that sends nothing, in that channel.
    """
    if truth is None:
        return np.array([plan.user_rates_bps[user] for user in plan.scenario.user_ids]) / 1e3
    really = plan.model_copy(update={"scenario": plan.scenario.with_changes(channel=truth.channel)})
    paths = np.array([plan.trajectories_m[uav] for uav in plan.scenario.uav_ids])
    n_uavs, n_slots = paths.shape[:2]
    sending = np.ones((n_slots, n_uavs), dtype=bool) & (np.array(plan.scenario.uav_ids) != silent)
    got: Array = delivered_rates_bps(really, np.arange(n_slots), paths.transpose(1, 0, 2), sending).T / 1e3
    return got


def compute(job: Job) -> Flown:
    """Compute all draws and losses of a job; runs in a worker process."""
    choices, scheme = job.choices, job.scheme
    options: dict[str, Any] = {"method": scheme.method, "n_starts": STARTS}
    choices = replace(choices, knows=scheme.knows or choices.knows)
    guessed = choices.fading != "mean" and choices.knows != "draw"
    flight = None
    rates, unadjusted, gaps = [], [], []
    for draw in range(choices.n_draws):
        if flight is None or not guessed:
            flight = _Flight(plan(choices.scenario(scheme.utility, draw), **options), FAILURE_SLOT, options)
        truth = choices.scenario(scheme.utility, draw, planned=False) if guessed else None
        rates.append([flight.rates(failed, truth) for failed in job.failed])
        unadjusted.append([flight.unadjusted_kbps(failed, truth) for failed in job.failed])
        gaps.append(flight.first.summary.gap)
    return Flown(np.array(rates), np.array(unadjusted), float(np.mean(gaps)))


def utility_of(course: Course, utility: Utility) -> float:
    """Return the utility of all slots flown, kbit/s."""
    return utility_kbps(course.rates_kbps, utility.kind, utility.mu_per_kbps)
