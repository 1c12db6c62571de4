"""What one more UAV, more band or a moved start would be worth."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Final

import numpy as np

from skyfolio.planner.bound import upper_bound_kbps
from skyfolio.planner.explanation.findings import What, Worth
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.explanation.prices import head_start_kbps
from skyfolio.planner.explanation.resolving import Resolver
from skyfolio.planner.explanation.what_if import MORE_BAND, WhatIf, more_band, moved_start, one_more_uav
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import problem_of

ONE_MORE: Final = "one_more_uav"
BAND: Final = "more_band"
START: Final = "moved_start"


def one_more(ledger: Ledger, resolver: Resolver, base: Plan) -> list[Worth]:
    """Return what one more UAV is worth: by a plan that has it, if it may be resolved, and at most."""
    changed = one_more_uav(ledger)
    if changed is None:
        return []
    made = resolver.solve(changed.scenario, changed.paths_m)
    if made is None:
        bound = upper_bound_kbps(problem_of(changed.scenario, ledger.past)) * 1e3
    else:
        bound = made.summary.upper_bound_bps
    gain = bound - base.summary.utility_bps
    at_most = Worth(what=ONE_MORE, uav_id=changed.uav_id, detail=changed.detail, method="bound", utility_gain_bps=gain)
    return [at_most] if made is None else [_gained(ONE_MORE, changed, made, base), at_most]


def per_uav(ledger: Ledger, resolver: Resolver, base: Plan) -> list[Worth]:
    """Return what a moved start and more band are worth to each UAV: to first order all, by resolves the greatest.

    Where a path is pinned the UAV starts where it does.
    """
    uavs = range(ledger.problem.n_uavs)
    starts = {u: _head_start(ledger, u) for u in uavs if not ledger.is_pinned(u)}
    bands = {u: _band(ledger, u) for u in uavs}
    resolved = _resolved(ledger, resolver, base, _greatest_first(starts), _greatest_first(bands))
    return [*starts.values(), *bands.values(), *resolved]


def _greatest_first(rows: dict[int, Worth]) -> list[int]:
    """Return the UAVs of these rows by what they gain."""
    return sorted(rows, key=lambda u: -rows[u].utility_gain_bps)


def _resolved(ledger: Ledger, resolver: Resolver, base: Plan, starts: list[int], bands: list[int]) -> Iterator[Worth]:
    """Resolve moved starts and wider bands of these UAVs in turn, as long as the budget lasts."""
    for what, u in _in_turn(starts, bands):
        if not resolver.may_go_on:
            return
        changed = moved_start(ledger, u) if what == START else more_band(ledger, u)
        made = None if changed is None else resolver.solve(changed.scenario, changed.paths_m)
        if changed is not None and made is not None:
            yield _gained(what, changed, made, base)


def _in_turn(starts: list[int], bands: list[int]) -> Iterator[tuple[What, int]]:
    for start, band in zip_longest(starts, bands):
        if start is not None:
            yield START, start
        if band is not None:
            yield BAND, band


def _band(ledger: Ledger, u: int) -> Worth:
    given = np.where(ledger.serving == u, ledger.rates_kbps, 0.0).sum() / ledger.problem.n_slots
    return Worth(
        what=BAND,
        uav_id=ledger.scenario.uav_ids[u],
        detail="10 % more band",
        method="derivative",
        utility_gain_bps=(MORE_BAND - 1.0) * float(ledger.earned_kbps[u].sum()) * 1e3,
        mean_sum_rate_gain_bps=(MORE_BAND - 1.0) * float(given) * 1e3,
    )


def _head_start(ledger: Ledger, u: int) -> Worth:
    utility_kbps, rate_kbps = head_start_kbps(ledger, u)
    path = ledger.paths_m[u]
    step_m = float(np.linalg.norm(path[1] - path[0])) if len(path) > 1 else 0.0
    return Worth(
        what=START,
        uav_id=ledger.scenario.uav_ids[u],
        detail=f"a start one slot of flight ahead ({step_m:.1f} m along its path)",
        method="derivative",
        utility_gain_bps=utility_kbps * 1e3,
        mean_sum_rate_gain_bps=rate_kbps * 1e3,
    )


def _gained(what: What, changed: WhatIf, made: Plan, base: Plan) -> Worth:
    return Worth(
        what=what,
        uav_id=changed.uav_id,
        detail=changed.detail,
        method="resolve",
        utility_gain_bps=made.summary.utility_bps - base.summary.utility_bps,
        mean_sum_rate_gain_bps=made.summary.mean_sum_rate_bps - base.summary.mean_sum_rate_bps,
    )
