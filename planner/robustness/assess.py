"""`assess()`: a plan under many draws of what it does not know, and after every single and double loss."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.plans import Plan, PlanStatus
from skyfolio.planner.robustness.disturbances import Disturbances
from skyfolio.planner.robustness.findings import LossOutcome, Robustness, UserUnderDraws, Worst
from skyfolio.planner.robustness.flown import flown_as_planned, planned_gains
from skyfolio.planner.robustness.losses import Loss, tried
from skyfolio.planner.robustness.tallies import DUST_BPS, Tally, percentiles, thresholds_bps
from skyfolio.planner.robustness.trial import Trial, asked_losses, require_possible


def _never() -> bool:
    return False


def assess(plan: Plan, trial: Trial | None = None, *, stop: Callable[[], bool] = _never) -> Robustness:
    """Assess a finished plan: rates and outages under the disturbances of `trial`, and after every loss it asks for.

    stop: polled between draws, and between and within replans; once it says so, what is left out is in `notes`, and
    `complete` is false. The same inputs give the same result unless `stop` speaks. Raises RobustnessError that names
    what makes no sense for this plan.
    """
    trial = trial or Trial()
    disturbances, losses = trial.disturbances, trial.losses
    require_possible(plan, trial)
    asked = asked_losses(plan, losses)
    flown, gains = flown_as_planned(plan), planned_gains(plan)
    planned_bps = flown.rates_bps(gains)
    thresholds = thresholds_bps(plan.scenario, planned_bps, trial.outage_share, trial.outage_bps)
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
        outage=trial.outage,
        planned_sum_rate_bps=float(planned_bps.sum(axis=0).mean()),
        sum_rate_bps=percentiles(whole.sums()),
        outage_probability=whole.outage(),
        users=users,
        losses=outcomes,
        worst=_worst(whole, users, outcomes),
        complete=not notes,
        notes=notes,
    )


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
