"""What each user gets, and why it is not more."""

from __future__ import annotations

from typing import Literal

import numpy as np

from skyfolio.planner.explanation.findings import Reason, ReasonKind, UserReasons
from skyfolio.planner.explanation.ladder import Ladder, ladders
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.plans import Plan

LITTLE = 0.5
"""Below this share of the users' mean rate a user has little."""
TO_USERS: tuple[ReasonKind, ...] = ("separation", "no_fly", "battery", "pins")
"""Constraints that may be the reason for a single user."""


def user_reasons(ledger: Ledger, base: Plan, without: dict[str, Plan]) -> tuple[UserReasons, ...]:
    """Return a row for every user; `without` holds plans without a constraint, whose gains count from `base`."""
    mean_bps = ledger.over_time(ledger.rates_kbps) * 1e3
    little_bps = LITTLE * float(mean_bps.mean())
    enough_kbps = LITTLE * float(ledger.rates_kbps.sum(axis=0).mean()) / ledger.problem.n_uavs
    unmet = ledger.plan.unmet_min_rate_slots
    has_little = (mean_bps == 0.0) | (mean_bps < little_bps)
    sated = ledger.has_all_it_asks_for
    short = [k for k, user in enumerate(ledger.scenario.user_ids) if (has_little[k] or user in unmet) and not sated[k]]
    found = ladders(ledger, np.array(short, dtype=np.intp))
    rows = []
    for k, user in enumerate(ledger.scenario.user_ids):
        rate = float(mean_bps[k])
        if k not in found:
            level: Literal["satisfied", "served"] = "satisfied" if sated[k] else "served"
            rows.append(UserReasons(user_id=user, mean_rate_bps=rate, level=level))
            continue
        resolved = _without_constraints(user, base, without)
        rows.append(
            UserReasons(
                user_id=user,
                mean_rate_bps=rate,
                level="none" if rate == 0.0 else "little",
                main=_main(found[k], resolved, little_bps, enough_kbps),
                reasons=(*resolved, *found[k].reasons()),
                price_per_bps=found[k].price,
            )
        )
    return tuple(rows)


def _without_constraints(user: str, base: Plan, without: dict[str, Plan]) -> list[Reason]:
    """Return what the user would gain without each constraint, the greatest gain first."""
    now = _mean(base.user_rates_bps[user])
    reasons = []
    for kind in TO_USERS:
        rate = _mean(without[kind].user_rates_bps[user]) if kind in without else now
        if rate > now:
            detail = f"{rate / 1e3:.2f} kbit/s in a plan without this constraint"
            reasons.append(Reason(kind=kind, method="resolve", rate_bps=rate, gain_bps=rate - now, detail=detail))
    return sorted(reasons, key=lambda reason: -reason.gain_bps)


def _main(ladder: Ladder, resolved: list[Reason], little_bps: float, enough_kbps: float) -> ReasonKind | None:
    """Return the constraint without which the user would not have little, else the first obstacle that matters.

    enough_kbps: half of what a UAV gives all its users together, on average.
    """
    if resolved and resolved[0].rate_bps >= little_bps:
        return resolved[0].kind
    return ladder.first_above(enough_kbps)


def _mean(rates_bps: list[float]) -> float:
    return sum(rates_bps) / len(rates_bps)
