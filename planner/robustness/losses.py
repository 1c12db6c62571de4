"""Every single and double loss, replanned."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil

from skyfolio.planner.changes import ReplanError
from skyfolio.planner.plans import Plan
from skyfolio.planner.replanning import replan
from skyfolio.planner.robustness.flown import Flown, flown_as_planned, planned_gains, replanned, without
from skyfolio.planner.robustness.trial import Losses
from skyfolio.planner.solve import converged
from skyfolio.planner.stopping import AnyOf, StopToken
from skyfolio.planner.unreachable import UnreachableEndError


@dataclass(frozen=True, kw_only=True)
class Loss:
    """A loss as it would be flown. begin: its slot on the plan's own grid; new: the replan, None with the reason."""

    lost: tuple[str, ...]
    at_slot: int
    begin: int
    unhelped: Flown
    helped: Flown
    new: Plan | None = None
    new_from: int | None = None
    reason: str = ""


def tried(
    plan: Plan, asked: Sequence[tuple[tuple[str, ...], int]], losses: Losses, seed: int, stop: Callable[[], bool]
) -> Iterator[Loss]:
    """Yield each loss as it would be flown, until `stop` says so; a replan that it interrupts is left out."""
    flown = flown_as_planned(plan)
    gap = ceil(losses.recovery_s / plan.scenario.slot_duration_s)
    for lost, begin in asked:
        if stop():
            return
        rule = AnyOf(converged(), StopToken(stop))
        unhelped = without(flown, lost, begin)
        new, reason = _new_plan(plan, unhelped, lost, begin + gap, losses.starts, seed, rule)
        if rule.interrupts:
            return
        helped = unhelped if new is None else replanned(unhelped, new, begin + gap)
        new_from = None if new is None else plan.first_slot + begin + gap
        yield Loss(
            lost=lost,
            at_slot=plan.first_slot + begin,
            begin=begin,
            unhelped=unhelped,
            helped=helped,
            new=new,
            new_from=new_from,
            reason=reason,
        )


def _new_plan(
    plan: Plan, unhelped: Flown, lost: tuple[str, ...], at: int, starts: int, seed: int, rule: AnyOf
) -> tuple[Plan | None, str]:
    """Return the replan from slot `at` of the plan's own grid on, or None and why there is none."""
    if at >= plan.scenario.slots:
        return None, "the operation ends before a new plan could be flown"
    rates = unhelped.rates_bps(planned_gains(plan))[:, :at]
    achieved = {
        user: [*plan.achieved_rates_bps.get(user, []), *row.tolist()]
        for user, row in zip(plan.scenario.user_ids, rates, strict=True)
    }
    try:
        made = replan(
            plan,
            failed=lost,
            at_slot=plan.first_slot + at,
            achieved_rates_bps=achieved,
            n_starts=starts,
            seed=seed,
            stop=rule,
        )
    except (ReplanError, UnreachableEndError) as error:
        return None, str(error)
    return made, ""
