"""Why a user gets little: a ladder from what it gets to what a UAV overhead, alone in the air, would give it.

Each rung takes one obstacle away, in this order, and never lowers the rate:

    planned           what the plan gives it
    band              the whole band of the UAV that gives it most, at the planned paths
    distance          the same as near as a UAV can be in each slot, while the others fly as planned
    pins              the same without the pins of the plan: pinned paths, and users pinned to a UAV
    no_fly            the same over no-fly zones
    battery           the same if no UAV left early
    reach             the same with a UAV overhead from the first slot on
    interference      the same if no other UAV interfered

No rung is above what the user asks for. So the steps add up to all that the user lacks, and each rung bounds what it
can get under the obstacles that are left. The others fly as planned on all rungs but the last. Means over the planned
slots in which the user is there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from shapely import Point, Polygon

from skyfolio.planner.arrays import Array
from skyfolio.planner.explanation.findings import Reason, ReasonKind
from skyfolio.planner.explanation.ledger import LN2, Ledger
from skyfolio.planner.heard import FARTHEST_M2
from skyfolio.planner.problem import Problem
from skyfolio.planner.reach import squared_distance_range

STEPS: tuple[ReasonKind, ...] = ("band", "distance", "pins", "no_fly", "battery", "reach", "interference")
CHUNK = 32
"""So many users at once: tables of U x CHUNK x N."""
WORTH_SAYING = 0.005
"""Steps below this share of the top rung are left out."""


@dataclass(frozen=True)
class Ladder:
    """The rungs of one user in kbit/s, `planned` first; the UAV that is the best server; its least distance, metres."""

    rungs_kbps: tuple[float, ...]
    best_uav: str
    nearest_m: float
    price: float | None

    def reasons(self) -> list[Reason]:
        """Return the steps that are worth saying, the greatest first."""
        steps = list(zip(STEPS, self.rungs_kbps[:-1], self.rungs_kbps[1:], strict=True))
        least = WORTH_SAYING * self.rungs_kbps[-1]
        found = [
            Reason(
                kind=kind,
                method="bound",
                rate_bps=above * 1e3,
                gain_bps=(above - below) * 1e3,
                detail=self._detail(kind, above),
            )
            for kind, below, above in steps
            if above - below > least
        ]
        return sorted(found, key=lambda reason: -reason.gain_bps)

    def first_above(self, enough_kbps: float) -> ReasonKind | None:
        """Return the first obstacle without which, and without those before it, the user could get enough.

        The greatest one if none reaches that; None for a user that lacks nothing.
        """
        for kind, rung in zip(STEPS, self.rungs_kbps[1:], strict=True):
            if rung >= enough_kbps:
                return kind
        reasons = self.reasons()
        return reasons[0].kind if reasons else None

    def _detail(self, kind: ReasonKind, kbps: float) -> str:
        said = {
            "band": f"the whole band of {self.best_uav} at the planned paths",
            "distance": f"a UAV as near as one can be; the plan comes within {self.nearest_m:.0f} m",
            "pins": "a UAV without the plan's pins",
            "no_fly": "a UAV that could fly over the no-fly zones",
            "battery": "a UAV that did not leave early",
            "reach": "a UAV overhead from the first slot on",
            "interference": "a UAV overhead with no other one in the air",
        }[kind]
        return f"at most {kbps:.2f} kbit/s: {said}"


def ladders(ledger: Ledger, users: NDArray[np.intp]) -> dict[int, Ladder]:
    """Return the ladder of each of these users, by index."""
    found: dict[int, Ladder] = {}
    for first in range(0, len(users), CHUNK):
        found.update(_of_some(ledger, users[first : first + CHUNK]))
    return found


def _of_some(ledger: Ledger, users: NDArray[np.intp]) -> dict[int, Ladder]:
    problem = ledger.problem
    snr = np.stack([ledger.snr_of(u, users=users) for u in range(problem.n_uavs)])  # (U, k, N)
    interfering = 1.0 + np.maximum(ledger.total_snr[users] - snr, 0.0)
    may_serve = ledger.may_serve if ledger.may_serve.size == 1 else ledger.may_serve[:, users]
    efficiency = np.where(may_serve, np.log1p(snr / interfering) / LN2, 0.0)
    whole = problem.bandwidth_hz[:, None, None] / 1e3 * efficiency
    rungs = [ledger.rates_kbps[users], whole.max(axis=0), *_nearer(problem, users, interfering, may_serve)]
    rungs = [np.minimum(rung, problem.demand_kbps[users, None]) for rung in rungs]
    table = np.stack([ledger.over_time(rung, users) for rung in rungs])
    best = whole.mean(axis=2).argmax(axis=0)
    prices = _prices(ledger, users, efficiency)
    ids = ledger.scenario.uav_ids
    return {
        int(user): Ladder(
            tuple(float(x) for x in table[:, at]), ids[best[at]], _nearest_m(ledger, int(user)), prices[at]
        )
        for at, user in enumerate(users)
    }


def _nearer(problem: Problem, users: NDArray[np.intp], interfering: Array, may_serve: NDArray[np.bool_]) -> list[Array]:
    """Return the rungs from `distance` on: (k, N) kbit/s each, of the whole band of the UAV that gives most."""
    stay = np.full(problem.n_uavs, problem.n_slots)
    some = problem.only(users=users)
    there = some.snr_gain
    lasting = np.array([_lasting(problem, u, users) for u in range(problem.n_uavs)])
    near2, _ = squared_distance_range(some)
    stay2, _ = squared_distance_range(replace(some, n_flying=stay))
    height2 = problem.altitude_m[:, None, None] ** 2 + some.spread_m2
    clear2 = np.maximum(near2, _clear_of_zones_m(problem, users)[None] ** 2 + height2)
    pinned2 = np.where(may_serve, _pinned_distance2(some, clear2), np.inf)
    tables = (
        (there, pinned2, interfering),
        (there, clear2, interfering),
        (there, near2, interfering),
        (lasting, np.minimum(stay2, near2), interfering),
        (lasting, height2, interfering),
        (lasting, height2, 1.0),
    )
    kilohertz = problem.bandwidth_hz[:, None, None] / (1e3 * LN2)
    return [
        (kilohertz * np.log1p(_snr(some, gain, distance2) / noise)).max(axis=0) for gain, distance2, noise in tables
    ]


def _snr(problem: Problem, gain: Array, distance2: Array) -> Array:
    """Return the greatest SNR, of gains (U, k, N), at these squared distances in m^2 or farther away."""
    if problem.bends is None:
        plain: Array = gain / distance2
        return plain
    near2 = np.minimum(distance2, FARTHEST_M2)
    snr: Array = gain * problem.bends.gain_range(near2, np.full(near2.shape, FARTHEST_M2))[0]
    return snr if problem.excess is None else snr * problem.excess.most()


def _pinned_distance2(problem: Problem, near2: Array) -> Array:
    """Return the squared distances (U, k, N) with those of pinned UAVs where they fly."""
    if not problem.pinned_m.size:
        return near2
    east, north = (problem.pinned_m[:, None, :, axis] - problem.user_m[None, :, :, axis] for axis in (0, 1))
    flown2 = east * east + north * north + (problem.altitude_m[:, None, None] ** 2 + problem.spread_m2)
    pinned2: Array = np.where(np.isfinite(flown2), flown2, near2)
    return pinned2


def _lasting(problem: Problem, u: int, users: NDArray[np.intp]) -> Array:
    """Return the signal gain (k, N) of a UAV as if it did not leave: its last slot's goes on."""
    gain = np.array(problem.snr_gain[u, users])
    gain[:, problem.n_flying[u] :] = gain[:, problem.n_flying[u] - 1, None]
    return gain


def _clear_of_zones_m(problem: Problem, users: NDArray[np.intp]) -> Array:
    """Return how far a UAV has to stay from each user because the user is inside a no-fly zone: (k, S) metres."""
    places = problem.user_m[users]
    away = np.zeros(places.shape[:2])
    for at in np.ndindex(away.shape):
        east, north = places[at]
        for disc_east, disc_north, radius in problem.discs:
            away[at] = max(away[at], radius - np.hypot(east - disc_east, north - disc_north))
        for outline in problem.polygons:
            polygon, point = Polygon(outline), Point(east, north)
            if polygon.contains(point):
                away[at] = max(away[at], polygon.boundary.distance(point))
    return away


def _nearest_m(ledger: Ledger, user: int) -> float:
    """Return how near a flying UAV comes to this user over the ground, in metres."""
    apart = np.linalg.norm(ledger.paths_m - ledger.problem.user_m[user][None], axis=-1)
    return float(apart[ledger.problem.flying].min())


def _prices(ledger: Ledger, users: NDArray[np.intp], efficiency: Array) -> list[float | None]:
    """Return what 1 bit/s of mean rate for each user costs in utility, where it is cheapest.

    A hertz of UAV u in slot n is worth `earned / B` where it is; given to the user, which then gets `efficiency` bit/s
    in one of N slots, it is worth the user's weight times that.
    """
    problem = ledger.problem
    hertz = ledger.earned_kbps / problem.bandwidth_hz[:, None] * 1e3  # (U, N): utility in bit/s of one hertz
    counts = ledger.weights[users].max(axis=1) > 0
    costs = np.full(efficiency.shape, np.inf)
    np.divide(np.broadcast_to(hertz[:, None], costs.shape), efficiency, out=costs, where=efficiency > 0)
    costs = np.where(problem.flying[:, None], costs - ledger.weights[users][None], np.inf) * problem.n_slots
    costs[:, :, : problem.counted_from] = np.inf
    least = costs.min(axis=(0, 2))
    return [
        max(0.0, float(cost)) if there and np.isfinite(cost) else None
        for cost, there in zip(least, counts, strict=True)
    ]
