"""Where constraints that can be lifted bind, and what lifting each of them is worth."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from shapely import LineString, Point, Polygon

from skyfolio.planner.explanation.findings import Lifted, Price
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.explanation.resolving import Resolver
from skyfolio.planner.explanation.what_if import LIFTED, is_there, lifted
from skyfolio.planner.geometry import nearest_to_origin
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon

NEAR_M = 0.05
"""A UAV this near to the limit is at it."""
HELD = 1e-6
"""Relative: a rate this little above the minimum is the minimum."""
Touching = tuple[tuple[str, ...], int]
"""At which UAVs a constraint binds, and in how many of their slots together."""


def lifted_prices(ledger: Ledger, resolver: Resolver) -> dict[Lifted, tuple[Price, Plan | None]]:
    """Return for each constraint of the scenario its price, and the plan without it where it was resolved.

    The plan itself is one without the constraint, so lifting it is worth 0 at least; except for departures: a UAV that
    stays interferes too.
    """
    rows: dict[Lifted, tuple[Price, Plan | None]] = {}
    for constraint in LIFTED:
        if not is_there(ledger, constraint):
            continue
        changed = lifted(ledger.scenario, constraint)
        made = resolver.solve(changed, ledger.paths_m, pinned=constraint != "pins")
        gain = None
        if made is not None:
            gain = made.summary.utility_bps - resolver.nothing_changed().summary.utility_bps
            gain = gain if constraint == "battery" else max(0.0, gain)
        uav_ids, slots = touching(ledger, constraint)
        price = Price(
            constraint=constraint, uav_ids=uav_ids, slots=slots, per="lifted", price_bps=gain, method="resolve"
        )
        rows[constraint] = price, made
    return rows


def touching(ledger: Ledger, constraint: Lifted) -> Touching:
    """Return where the plan meets this constraint with equality."""
    return {
        "separation": _separation,
        "no_fly": _no_fly,
        "battery": _departures,
        "end": _ends,
        "min_rate": _minimum_rates,
        "pins": _pins,
    }[constraint](ledger)


def _separation(ledger: Ledger) -> Touching:
    """Count the slots in which two UAVs come as close as they may, on the legs between slots too."""
    uavs, limit = ledger.scenario.uavs, ledger.scenario.min_separation_m
    whom: set[str] = set()
    count = 0
    for a, b in combinations(range(len(uavs)), 2):
        together = int(min(ledger.problem.n_flying[a], ledger.problem.n_flying[b]))
        apart = (ledger.paths_m[a] - ledger.paths_m[b])[:together]
        nearest = apart.copy()
        nearest[:-1] = nearest_to_origin(apart[:-1], np.diff(apart, axis=0))
        near = int((np.linalg.norm(nearest, axis=-1) <= limit + NEAR_M).sum())
        if near:
            whom |= {uavs[a].id, uavs[b].id}
            count += near
    return tuple(sorted(whom)), count


def _no_fly(ledger: Ledger) -> Touching:
    """Count the slots that a UAV begins at the edge of a zone, or whose leg touches one."""
    zones = [_outline(zone) for zone in ledger.scenario.no_fly]
    rows = {}
    for u, uav in enumerate(ledger.scenario.uavs):
        path = ledger.paths_m[u][: int(ledger.problem.n_flying[u])]
        legs = [LineString([here, there]) for here, there in zip(path, [*path[1:], path[-1]], strict=True)]
        rows[uav.id] = sum(any(zone.distance(leg) <= NEAR_M for zone in zones) for leg in legs)
    return _counted(rows)


def _outline(zone: NoFlyDisc | NoFlyPolygon) -> Polygon:
    if isinstance(zone, NoFlyPolygon):
        return Polygon(zone.vertices_m)
    return Point(zone.center_m).buffer(zone.radius_m, quad_segs=64)


def _departures(ledger: Ledger) -> Touching:
    """Count the slots in which UAVs have left."""
    scenario = ledger.scenario
    return _counted({uav.id: scenario.slots - 1 - scenario.last_slot(uav) for uav in scenario.uavs})


def _ends(ledger: Ledger) -> Touching:
    """Count the UAVs that must be somewhere in their last slot: one slot each."""
    return _counted({uav.id: int(uav.end_m is not None) for uav in ledger.scenario.uavs})


def _minimum_rates(ledger: Ledger) -> Touching:
    """Count the slots in which UAVs serve a user that gets no more than its minimum rate."""
    least = ledger.problem.min_kbps[:, None]
    held = (least > 0) & (ledger.rates_kbps <= least * (1 + HELD))
    ids = ledger.scenario.uav_ids
    return _counted({uav: int((held & (ledger.serving == u)).sum()) for u, uav in enumerate(ids)})


def _pins(ledger: Ledger) -> Touching:
    """Count the slots in which a UAV flies a pinned path, and those in which a user is pinned to it."""
    problem, ids = ledger.problem, ledger.scenario.uav_ids
    flown = {uav: int(problem.n_flying[u]) if ledger.is_pinned(u) else 0 for u, uav in enumerate(ids)}
    return _counted({uav: flown[uav] + int((problem.pinned_to == u).sum()) for u, uav in enumerate(ids)})


def _counted(slots_of: dict[str, int]) -> Touching:
    whom = tuple(uav for uav, slots in slots_of.items() if slots)
    return whom, sum(slots_of.values())
