"""Changed scenarios: one thing different, and paths of the plan to begin from."""

from __future__ import annotations

from dataclasses import dataclass
from math import dist
from typing import Any, get_args

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.explanation.findings import Lifted
from skyfolio.planner.explanation.ledger import LN2, Ledger
from skyfolio.planner.scenario import Scenario, Uav, zone_holds

MORE_BAND = 1.1
PLACES, MOMENTS = 48, 12
"""At so many users one more UAV is tried, at so many moments of the flight."""
LIFTED: tuple[Lifted, ...] = get_args(Lifted)


@dataclass(frozen=True)
class WhatIf:
    """A changed scenario, (U, N, 2) paths in metres to begin from, and what is different."""

    scenario: Scenario
    paths_m: Array
    uav_id: str
    detail: str


def lifted(scenario: Scenario, constraint: Lifted) -> Scenario:
    """Return the scenario without this constraint; the same one if it has none, and for pins, which are the plan's."""
    uavs, users = scenario.uavs, scenario.users
    without: dict[Lifted, dict[str, Any]] = {
        "separation": {"min_separation_m": 0.0},
        "no_fly": {"no_fly": ()},
        "battery": {"uavs": tuple(uav.model_copy(update={"leaves_at_slot": None}) for uav in uavs)},
        "end": {"uavs": tuple(uav.model_copy(update={"end_m": None}) for uav in uavs)},
        "min_rate": {"users": tuple(user.model_copy(update={"min_rate_bps": 0.0}) for user in users)},
        "pins": {},
    }
    return scenario.with_changes(**without[constraint])


def is_there(ledger: Ledger, constraint: Lifted) -> bool:
    """Return whether the scenario, or the plan, has this constraint at all."""
    scenario = ledger.scenario
    return {
        "separation": scenario.min_separation_m > 0 and len(scenario.uavs) > 1,
        "no_fly": bool(scenario.no_fly),
        "battery": any(scenario.last_slot(uav) < scenario.slots - 1 for uav in scenario.uavs),
        "end": any(uav.end_m is not None for uav in scenario.uavs),
        "min_rate": any(user.min_rate_bps > 0 for user in scenario.users),
        "pins": bool(ledger.plan.pins),
    }[constraint]


def more_band(ledger: Ledger, u: int) -> WhatIf:
    """Return 10 % more band for UAV `u`."""
    uav = ledger.scenario.uavs[u]
    hertz = uav.bandwidth_hz * MORE_BAND
    return WhatIf(
        _with_uav(ledger.scenario, u, bandwidth_hz=hertz), ledger.paths_m, uav.id, f"bandwidth_hz {hertz:g} (10 % more)"
    )


def moved_start(ledger: Ledger, u: int) -> WhatIf | None:
    """Return UAV `u` starting where the plan has it give most.

    None if it already does, another one starts there, or its path is pinned.
    """
    if ledger.is_pinned(u):
        return None
    uav, last = ledger.scenario.uavs[u], int(ledger.problem.n_flying[u]) - 1
    given = np.where(ledger.serving == u, ledger.rates_kbps, 0.0).sum(axis=0)
    best = int(given[: last + 1].argmax())
    place = (float(ledger.paths_m[u, best, 0]), float(ledger.paths_m[u, best, 1]))
    if dist(place, uav.start_m) < 1.0 or not _may_start(ledger.scenario, place, but=uav):
        return None
    paths = ledger.paths_m.copy()
    paths[u] = paths[u][np.minimum(np.arange(ledger.problem.n_slots) + best, last)]
    changed = _with_uav(ledger.scenario, u, start_m=place)
    return WhatIf(changed, paths, uav.id, f"start_m ({place[0]:.1f}, {place[1]:.1f}) instead of {uav.start_m}")


def one_more_uav(ledger: Ledger) -> WhatIf | None:
    """Return one more UAV like the first, starting where it gains most; None if there is no room for it."""
    scenario = ledger.scenario
    taken = set(scenario.uav_ids)
    name = next(one for one in (f"one-more-{number}" for number in range(1, len(taken) + 2)) if one not in taken)
    place = _best_place(ledger)
    if place is None:
        return None
    like = scenario.uavs[0]
    uav = like.model_copy(update={"id": name, "start_m": place, "end_m": None, "leaves_at_slot": None})
    still = np.broadcast_to(np.array(place), (1, scenario.slots, 2))
    detail = f"like {like.id}, start_m ({place[0]:.1f}, {place[1]:.1f})"
    return WhatIf(
        scenario.with_changes(uavs=(*scenario.uavs, uav)), np.concatenate([ledger.paths_m, still]), name, detail
    )


def _best_place(ledger: Ledger) -> tuple[float, float] | None:
    """Return over which user one more UAV would gain most, if it stayed there and the others flew as planned.

    In each slot it gives its band to the best user, and interferes with the others.
    """
    problem, scenario = ledger.problem, ledger.scenario
    low, high = problem.low_m, problem.high_m
    picked = np.unique(np.linspace(0, problem.n_users - 1, PLACES).astype(int))
    corners = [(low + high) / 2, low, high]
    places = [(float(at[0]), float(at[1])) for at in [*np.clip(problem.mean_user_m[picked], low, high), *corners]]
    open_places = [place for place in places if _may_start(scenario, place)]
    if not open_places:
        return None
    return max(open_places, key=lambda place: _gain_kbps(ledger, np.array(place)))


def _gain_kbps(ledger: Ledger, place: Array) -> float:
    problem = ledger.problem
    moments = np.unique(np.linspace(problem.counted_from, problem.n_slots - 1, MOMENTS).astype(int))
    weights, total, own = (table[:, moments] for table in (ledger.weights, ledger.total_snr, ledger.own_snr))
    over2 = ((problem.mean_user_m - place) ** 2).sum(axis=1)
    bent, _ = problem.bent(0, over2)
    snr = (problem.snr_gain[0, :, 0] / (over2 + problem.altitude_m[0] ** 2) * bent)[:, None]
    if problem.excess is not None:
        snr = snr * problem.excess.of_uav(0, place[None])[0][:, :1]
    new = weights * problem.bandwidth_hz[0] * np.log1p(snr / (1.0 + total))
    interfering = 1.0 + total - own
    lost = np.log1p(own / interfering) - np.log1p(own / (interfering + snr))
    return float(new.max(axis=0).sum() - (weights * ledger.bandwidth_hz[:, moments] * lost).sum()) / (1e3 * LN2)


def _may_start(scenario: Scenario, place: tuple[float, float], but: Uav | None = None) -> bool:
    """Return whether a UAV can start there: outside all zones, and D_min away from the other starts."""
    free = not any(zone_holds(zone, place) for zone in scenario.no_fly)
    return free and all(
        dist(place, uav.start_m) >= scenario.min_separation_m
        for uav in scenario.uavs
        if but is None or uav.id != but.id
    )


def _with_uav(scenario: Scenario, u: int, **changes: Any) -> Scenario:
    changed = scenario.uavs[u].model_copy(update=changes)
    return scenario.with_changes(uavs=(*scenario.uavs[:u], changed, *scenario.uavs[u + 1 :]))
