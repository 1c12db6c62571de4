"""`assess()`: a plan under many draws of what it does not know, and after every single and double loss."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.plans import Plan, PlanStatus
from skyfolio.planner.robustness.disturbances import Disturbances
from skyfolio.planner.robustness.findings import LossOutcome, Robustness, RobustnessError, UserUnderDraws, Worst
from skyfolio.planner.robustness.flown import flown_as_planned, planned_gains
from skyfolio.planner.robustness.losses import Loss, Losses, asked_losses, tried
from skyfolio.planner.robustness.tallies import DUST_BPS, Tally, percentiles, thresholds_bps

MOST_CELL_DRAWS = 1_000_000_000
"""Draws x UAVs x users x slots that may be asked for: some 30 s of processor time for the draws alone."""


def _never() -> bool:
    return False


def assess(
    plan: Plan,
    *,
    disturbances: Disturbances | None = None,
    losses: Losses | None = None,
    outage_share: float = 0.5,
    outage_bps: float | None = None,
    stop: Callable[[], bool] = _never,
) -> Robustness:
    """Assess a finished plan: rates and outages under `disturbances`, and after every loss that `losses` asks for.

    outage_bps: a user that gets less in a slot is in outage; without it, one that gets less than its `min_rate_bps`, or
    where it has none, less than `outage_share` of what the plan gives it in that slot. stop: polled between draws, and
    between and within replans; once it says so, what is left out is in `notes`, and `complete` is false. The same
    inputs give the same result unless `stop` speaks. Raises RobustnessError that names what makes no sense.
    """
    disturbances, losses = disturbances or Disturbances(), losses or Losses()
    _check(plan, disturbances, outage_share, outage_bps)
    asked = asked_losses(plan, losses)
    flown, gains = flown_as_planned(plan), planned_gains(plan)
    planned_bps = flown.rates_bps(gains)
    thresholds = thresholds_bps(plan.scenario, planned_bps, outage_share, outage_bps)
    whole = Tally(thresholds)
    for draw in range(disturbances.draws):
        whole.add(flown.rates_bps(*_drawn(plan, disturbances, draw)))
        if stop():
            break
    found = list(tried(plan, asked[: losses.most], losses, disturbances.seed, stop))
    tallies = [Tally(thresholds, loss.begin) for loss in found]
    for draw in range(whole.draws if found else 0):
        drawn = _drawn(plan, disturbances, draw)
        for loss, tally in zip(found, tallies, strict=True):
            tally.add(loss.helped.rates_bps(*drawn))
        if stop():
            break
    outcomes = tuple(_outcome(one, tally, planned_bps, gains) for one, tally in zip(found, tallies, strict=True))
    users = _users(plan, whole, planned_bps, [loss.helped.rates_bps(gains) for loss in found])
    notes = _notes(disturbances, whole, tallies, len(asked), len(found), losses.most)
    return Robustness(
        plan_id=plan.id,
        disturbances=disturbances,
        draws=whole.draws,
        outage=_in_words(outage_share, outage_bps),
        planned_sum_rate_bps=float(planned_bps.sum(axis=0).mean()),
        sum_rate_bps=percentiles(whole.sums()),
        outage_probability=whole.outage(),
        users=users,
        losses=outcomes,
        worst=_worst(whole, users, outcomes),
        complete=not notes,
        notes=notes,
    )


def _check(plan: Plan, disturbances: Disturbances, share: float, outage_bps: float | None) -> None:
    cells = len(plan.scenario.uavs) * len(plan.scenario.users) * plan.scenario.slots
    if disturbances.draws * cells > MOST_CELL_DRAWS:
        raise RobustnessError(
            f"draws: {disturbances.draws} draws of {cells} cells (UAVs x users x slots) are too many; at most "
            f"{max(1, MOST_CELL_DRAWS // cells)}"
        )
    if not 0.0 < share <= 1.0:
        raise RobustnessError(f"outage_share: {share:g} must be above 0 and at most 1")
    if outage_bps is not None and not 0.0 < outage_bps < np.inf:
        raise RobustnessError(f"outage_bps: {outage_bps:g} must be above 0")


def _drawn(plan: Plan, disturbances: Disturbances, draw: int) -> tuple[Array, Array]:
    scenario = plan.scenario
    return disturbances.gains(scenario, plan.first_slot, draw), disturbances.errors_m(scenario, draw)


def _outcome(loss: Loss, tally: Tally, planned_bps: Array, gains: Array) -> LossOutcome:
    ahead = slice(loss.begin, None)
    helped_bps, unhelped_bps = loss.helped.rates_bps(gains), loss.unhelped.rates_bps(gains)
    had, has = planned_bps[:, ahead].max(axis=1) > DUST_BPS, helped_bps[:, ahead].max(axis=1) > DUST_BPS
    return LossOutcome(
        lost=loss.lost,
        at_slot=loss.at_slot,
        replanned_from_slot=loss.new_from,
        status=_status(loss),
        detail=loss.reason,
        planned_bps=float(planned_bps[:, ahead].sum(axis=0).mean()),
        without_replan_bps=float(unhelped_bps[:, ahead].sum(axis=0).mean()),
        with_replan_bps=float(helped_bps[:, ahead].sum(axis=0).mean()),
        rate_bps=percentiles(tally.sums()),
        outage_probability=tally.outage(),
        cut_off=tuple(np.array(loss.helped.scenario.user_ids)[had & ~has].tolist()),
    )


def _status(loss: Loss) -> Literal["replanned", "short_of_min_rates", "not_replanned"]:
    if loss.new is None:
        return "not_replanned"
    return "short_of_min_rates" if loss.new.status is PlanStatus.INFEASIBLE else "replanned"


def _users(plan: Plan, whole: Tally, planned_bps: Array, after: Sequence[Array]) -> tuple[UserUnderDraws, ...]:
    rates, outages = whole.users(), whole.outages()
    left = np.array([table.mean(axis=1) for table in after])  # (losses, K)
    return tuple(
        UserUnderDraws(
            user_id=user,
            planned_bps=float(planned_bps[k].mean()),
            rate_bps=rates[k],
            outage_probability=outages[k],
            worst_loss=int(left[:, k].argmin()) if len(left) else None,
        )
        for k, user in enumerate(plan.scenario.user_ids)
    )


def _worst(whole: Tally, users: Sequence[UserUnderDraws], outcomes: Sequence[LossOutcome]) -> Worst:
    def worst_loss(together: int) -> int | None:
        mine = [number for number, one in enumerate(outcomes) if len(one.lost) == together]
        return min(mine, key=badness, default=None)

    def badness(number: int) -> tuple[float, float]:
        return -(outcomes[number].outage_probability or 0.0), outcomes[number].with_replan_bps

    likely = [(one.outage_probability, one.user_id) for one in users if one.outage_probability is not None]
    return Worst(
        single_loss=worst_loss(1),
        double_loss=worst_loss(2),
        user_id=max(likely, key=lambda one: one[0])[1] if likely else None,
        draw=int(whole.sums().argmin()),
    )


def _in_words(share: float, outage_bps: float | None) -> str:
    if outage_bps is not None:
        return f"less than {outage_bps:g} bit/s in a slot"
    return f"less than its min_rate_bps in a slot; without one, less than {share:.0%} of what is planned in that slot"


def _notes(
    disturbances: Disturbances, whole: Tally, tallies: Sequence[Tally], asked: int, found: int, most: int
) -> tuple[str, ...]:
    notes = []
    if whole.draws < disturbances.draws:
        notes.append(f"time was up after {whole.draws} of {disturbances.draws} draws")
    if asked > most:
        notes.append(f"{asked} losses are more than {most}: the first {most} were tried, single ones first")
    if found < min(asked, most):
        notes.append(f"time was up after {found} of {min(asked, most)} losses")
    if tallies and tallies[0].draws < whole.draws:
        notes.append(f"time was up: losses have {tallies[0].draws} of {whole.draws} draws")
    return tuple(notes)
