"""Where to hover and who goes where, by what comes of it: sketches first, the best of them settled.

A sketch picks distinct users by spectral efficiency (`sketch.py`), for one of several prices of the time that the
flights take, and matches UAVs to them by what each earns there and what is lost on the way. The sketches that are worth
most to the utility (`snapshots.py`) are settled by a local search over places (`settling.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from scipy.optimize import linear_sum_assignment

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.excess import Frame, looked_up
from skyfolio.planner.fast.air import longest_steps_m
from skyfolio.planner.fast.appraisal import look
from skyfolio.planner.fast.arena import SUM, Arena, Ints, mean_user_m, plain
from skyfolio.planner.fast.settling import settle
from skyfolio.planner.fast.sketch import exchange_users
from skyfolio.planner.fast.snapshots import Snapshots, snapshots_of

PRICES = (0.0, 4.0, 2.0, 8.0)
"""bit/s/Hz that count as lost while a UAV flies, sketch by sketch: which is best depends on utility and distances."""
MATCHING_PRICE = 1.0
"""The same, at least, when UAVs are matched to users."""
NO_WAY = 1e6
"""kbit/s: the price of a user from whom the UAV would not reach its end in time."""
SKETCHES, FEWER_SKETCHES = 24, 8
FEW = 4
"""Up to so many UAVs climbs are so cheap that they are the better search: fewer sketches are made then."""
CLEARLY = 5e-4
"""Relative: by how much places must be worth more than those that UAVs are bound for."""
TRIES_AT_ONCE = 500
COOLED = 0.7
"""From this share of the tries on, nothing that is worth less is kept."""
CLEAR_M = 1e-6
"""Points over users in a no-fly zone are taken this far outside its edge."""
HEAT = 1e-3
"""Of the utility: by how much a long search may first step back to get ahead."""


@dataclass(frozen=True)
class Effort:
    """How many sketches are made, how many of the best are settled, and by how many tries each."""

    sketches: int
    settled: int
    tries: int
    heat: float = 0.0


class Grounds(NamedTuple):
    """What sketches need. user_m: (2, K), where users are on average. site_m: (2, K), where one hovers for each.

    gain: (U, 1 or K), m^2, mean over the slots; height2: (U,), m^2: of an inverse square that is like the channel.

    lost: (U, K), kHz times the share of the slots that the flights to a user and on to the end take; NO_WAY where the
    end would be missed.
    """

    user_m: Array
    site_m: Array
    gain: Array
    height2: Array
    lost: Array


def effort_of(arena: Arena, number: int = 0, *, warm: bool = False) -> Effort:
    """Return how far round `number` looks.

    By size and utility, twice as far as the last up to a limit, less in a replan.
    """
    n_uavs, is_sum = arena.gain.shape[1], arena.kind == SUM
    if warm and n_uavs <= FEW and is_sum:
        return Effort(0, 0, 0)  # under `sum` variations of what such a fleet does find as much as places do
    more = 2 ** min(number, 4)
    tries = min(200 * n_uavs, 5000) if n_uavs > FEW else 60 * n_uavs
    if warm:
        tries = 60 * n_uavs if is_sum or n_uavs <= FEW else min(40 * n_uavs, 600)
        return Effort(6 * more, 1, tries * more, HEAT if number else 0.0)
    sketches = SKETCHES if n_uavs > FEW else FEWER_SKETCHES
    return Effort(sketches * more, 3 if is_sum else 2, tries * more, HEAT if number else 0.0)


def places(
    arena: Arena,
    rng: np.random.Generator,
    effort: Effort,
    given_m: Array | None = None,
    *,
    halted: Callable[[], bool] = lambda: False,
) -> list[Array]:
    """Hover points (2, U) metres, best first: as far as it comes until `halted` says so, asked every now and then.

    given_m: (2, U), points to begin from beside the sketches, as where UAVs are bound for when a replan begins; then
    only places that are clearly worth more than these come back.
    """
    if arena.gain.shape[0] < 2 or effort.sketches == 0:
        return []
    shots, grounds = snapshots_of(arena), grounds_of(arena)
    wanted = [] if given_m is None else [given_m]
    for i in range(effort.sketches):
        if halted():
            break
        wanted.append(sketched(arena, grounds, rng, PRICES[i % len(PRICES)]))
    worth = [look(arena, shots, place) for place in wanted]
    ranked = sorted(range(len(wanted)), key=lambda i: -worth[i])
    different = list({wanted[i].tobytes(): wanted[i] for i in ranked}.values())
    settled = [_settled(arena, shots, grounds, rng, place, effort, halted) for place in different[: effort.settled]]
    least = -np.inf if given_m is None else worth[0] + CLEARLY * abs(worth[0])
    return [place for value, place in sorted(settled, key=lambda one: -one[0]) if value > least]


def _settled(
    arena: Arena,
    shots: Snapshots,
    grounds: Grounds,
    rng: np.random.Generator,
    place: Array,
    effort: Effort,
    halted: Callable[[], bool],
) -> tuple[float, Array]:
    """Return what `place` (2, U) becomes, and what that is worth."""
    value = look(arena, shots, place)
    draws, heat = rng.random((effort.tries, 6)), effort.heat * abs(value)
    for begin in range(0, effort.tries, TRIES_AT_ONCE):
        if halted():
            break
        part = draws[begin : begin + TRIES_AT_ONCE]
        cooled = max(0.0, 1.0 - begin / (COOLED * effort.tries))
        value = settle(arena, shots, grounds.site_m, part, value, heat * cooled)
    return value, shots.place.copy()


def grounds_of(arena: Arena) -> Grounds:
    """Sites, mean gains and flight times of `arena`."""
    n_slots = arena.gain.shape[0]
    gain = arena.fading.mean(axis=0) if arena.fading.shape[0] else arena.gain.mean(axis=0)[:, None]
    height2 = arena.height2
    if arena.has_bend:
        like, height2 = arena.bend.like, arena.bend.like_height2
        gain = gain * like[:, None]
    site_m = sites_m(arena)
    if arena.bend.logs.shape[0] > 0:
        gain = gain * _by_map(arena, site_m)
    ending = np.isfinite(arena.end_m[0])[:, None]
    lost_slots, late = _flights(arena, site_m)
    lost = arena.khz[:, None] * np.minimum(lost_slots, n_slots) / n_slots
    return Grounds(
        mean_user_m(arena), plain(site_m), plain(gain), plain(height2), plain(np.where(late & ending, NO_WAY, lost))
    )


def _by_map(arena: Arena, site_m: Array) -> Array:
    """Return what the maps of users say of each UAV at their sites, half-way through the plan: (U, K)."""
    bend = arena.bend
    frame = Frame(float(bend.west_south[0]), float(bend.west_south[1]), 1.0 / bend.per_cell)
    reads = bend.reads[len(bend.reads) // 2]
    factors: Array = np.exp(looked_up(bend.logs, frame, bend.row[:, None], reads[None], site_m.T[None]).value)
    return factors


def _flights(arena: Arena, site_m: Array) -> tuple[Array, Array]:
    """Return how many slots each UAV flies to each site and on to its end, and if that is too late: both (U, K)."""
    way_out = site_m[:, None] - arena.start_m[:, :, None]
    way_on = np.nan_to_num(arena.end_m[:, :, None] - site_m[:, None])
    there, back = np.hypot(*way_out), np.hypot(*way_on)
    if not arena.has_wind:
        step_m = np.maximum(arena.step_m, 1e-9)[:, None]
        return (there + back) / step_m, there + back > (arena.last * arena.step_m)[:, None]
    slots = sum(
        length / np.maximum(longest_steps_m(arena.breeze, arena.step_m, way), 1e-9)
        for length, way in ((there, way_out), (back, way_on))
    )
    return slots, slots > arena.last[:, None]


def sites_m(arena: Arena) -> Array:
    """Return where a UAV hovers for each user, (2, K): over it, or as near as area and no-fly zones let it come."""
    points = np.clip(mean_user_m(arena), arena.low[:, None], arena.high[:, None])
    for east, north, radius in arena.discs:
        away = points - np.array([[east], [north]])
        length = np.hypot(*away)
        direction = np.where(length > 0.0, away / np.where(length > 0.0, length, 1.0), np.array([[1.0], [0.0]]))
        inside = length < radius
        points = np.where(inside, points - away + (radius + CLEAR_M) * direction, points)
    for begin, end in zip(arena.first[:-1], arena.first[1:], strict=True):
        outline = shapely.Polygon(arena.corners[begin:end])
        for k in np.flatnonzero(shapely.contains_xy(outline, *points)):
            at = shapely.Point(points[:, k])
            edge = outline.exterior.interpolate(outline.exterior.project(at))
            out = np.array([edge.x, edge.y]) - points[:, k]
            points[:, k] += out * (1.0 + CLEAR_M / max(float(np.hypot(*out)), CLEAR_M))
    clipped: Array = np.clip(points, arena.low[:, None], arena.high[:, None])
    return clipped


def sketched(arena: Arena, grounds: Grounds, rng: np.random.Generator, price: float) -> Array:
    """Hover points (2, U) over distinct users while they last; who has none, or would miss its end, stays."""
    n_uavs, n_users = grounds.lost.shape
    if n_uavs > n_users:
        flying, users = linear_sum_assignment(grounds.lost - grounds.lost.max() * rng.random((n_uavs, 1)))
        return _over(arena, grounds, flying, users)
    users = np.asarray(rng.choice(n_users, n_uavs, replace=False))
    chosen = users[linear_sum_assignment(grounds.lost[:, users])[1]].astype(np.int64)
    cost = grounds.lost * price if price > 0.0 else np.where(grounds.lost >= NO_WAY, NO_WAY, 0.0)
    exchange_users(grounds.site_m, grounds.user_m, grounds.gain, grounds.height2, arena.khz, plain(cost), chosen)
    worth = _earned(arena, grounds, chosen) - max(price, MATCHING_PRICE) * grounds.lost[:, chosen]
    return _over(arena, grounds, np.arange(n_uavs), chosen[linear_sum_assignment(worth, maximize=True)[1]])


def _earned(arena: Arena, grounds: Grounds, chosen: Ints) -> Array:
    """Return what each UAV would earn over each user of `chosen` (U,), the others hovering there: (U, U) kbit/s."""
    site, user = grounds.site_m[:, chosen], grounds.user_m[:, chosen]
    gain = grounds.gain if grounds.gain.shape[1] == 1 else grounds.gain[:, chosen]
    apart2 = ((site[:, :, None] - user[:, None]) ** 2).sum(axis=0)
    heard = gain / (apart2 + grounds.height2[:, None])
    others = 1.0 + np.maximum(heard.sum(axis=0) - np.diag(heard), 0.0)
    own = gain / (np.diag(apart2)[None] + grounds.height2[:, None])
    earned: Array = arena.khz[:, None] * np.log2(1.0 + own / others)
    return earned


def _over(arena: Arena, grounds: Grounds, flying: Ints, users: Ints) -> Array:
    place = arena.start_m.copy()
    there = grounds.lost[flying, users] < NO_WAY
    place[:, flying[there]] = grounds.site_m[:, users[there]]
    return plain(place)
