"""What one more UAV, more band or a moved start would be worth."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.bound import upper_bound_kbps
from skyfolio.planner.explanation.findings import Worth
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.explanation.prices import head_start_kbps
from skyfolio.planner.explanation.resolving import Resolver
from skyfolio.planner.explanation.what_if import MORE_BAND, WhatIf, more_band, moved_start, one_more_uav
from skyfolio.planner.plans import Plan
from skyfolio.planner.problem import problem_of


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
    at_most = Worth(
        what="one_more_uav", uav_id=changed.uav_id, detail=changed.detail, method="bound", utility_gain_bps=gain
    )
    return [at_most] if made is None else [_gained("one_more_uav", changed, made, base), at_most]


def per_uav(ledger: Ledger, resolver: Resolver, base: Plan) -> list[Worth]:
    """Return what more band and a moved start are worth to each UAV; the most promising are resolved first."""
    ids = ledger.scenario.uav_ids
    rows: list[Worth] = []
    changes: dict[str, list[tuple[float, int]]] = {"more_band": [], "moved_start": []}
    sums = ledger.rates_kbps
    for u, uav in enumerate(ids):
        more = (MORE_BAND - 1.0) * float(ledger.earned_kbps[u].sum()) * 1e3
        rate = (MORE_BAND - 1.0) * float(np.where(ledger.serving == u, sums, 0.0).sum()) / sums.shape[1] * 1e3
        rows.append(_first_order("more_band", uav, "10 % more band", more, rate))
        changes["more_band"].append((-more, u))
        ahead, ahead_rate = (1e3 * kbps for kbps in head_start_kbps(ledger, u))
        step = f"a start one slot of flight ahead ({_first_step_m(ledger, u):.1f} m along its path)"
        rows.append(_first_order("moved_start", uav, step, ahead, ahead_rate))
        changes["moved_start"].append((-ahead, u))
    in_turn = zip(sorted(changes["moved_start"]), sorted(changes["more_band"]), strict=True)
    for what, u in (turn for (_, a), (_, b) in in_turn for turn in (("moved_start", a), ("more_band", b))):
        changed = more_band(ledger, u) if what == "more_band" else moved_start(ledger, u)
        made = None if changed is None else resolver.solve(changed.scenario, changed.paths_m)
        if changed is not None and made is not None:
            rows.append(_gained(what, changed, made, base))
    return rows


def _first_order(what: str, uav_id: str, detail: str, utility_bps: float, rate_bps: float) -> Worth:
    return Worth.model_validate(
        {
            "what": what,
            "uav_id": uav_id,
            "detail": detail,
            "method": "derivative",
            "utility_gain_bps": utility_bps,
            "mean_sum_rate_gain_bps": rate_bps,
        }
    )


def _gained(what: str, changed: WhatIf, made: Plan, base: Plan) -> Worth:
    return Worth.model_validate(
        {
            "what": what,
            "uav_id": changed.uav_id,
            "detail": changed.detail,
            "method": "resolve",
            "utility_gain_bps": made.summary.utility_bps - base.summary.utility_bps,
            "mean_sum_rate_gain_bps": made.summary.mean_sum_rate_bps - base.summary.mean_sum_rate_bps,
        }
    )


def _first_step_m(ledger: Ledger, u: int) -> float:
    path = ledger.paths_m[u]
    return float(np.linalg.norm(path[1] - path[0])) if len(path) > 1 else 0.0
