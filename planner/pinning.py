"""From pins by id to arrays, checked: parts of a plan that a request fixes, so that the search finds the rest.

Pinned paths and UAVs fly exactly what is given; pinned users are served by the given UAV, or by none. A pin only takes
feasible plans away, so every upper bound of the problem without pins holds with them too, only less tightly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from math import dist

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.account import ROUNDING_WH, account_of
from skyfolio.planner.energy.air import Air
from skyfolio.planner.feasibility import ROUNDING_M, no_fly_depth_m
from skyfolio.planner.pins import Pins
from skyfolio.planner.scenario import Point, Scenario, Uav
from skyfolio.planner.separation import closest_approach

AT_START_M = 1e-6
"""A pinned path begins where its UAV is, but for this much of rounding."""
SHRINK = 1.0 - 1e-9
"""A UAV that catches up with its current path flies this much below `D_max`."""


class PinError(ValueError):
    """A pin that names no UAV or user, has the wrong length, or fixes what cannot be flown or served."""


@dataclass(frozen=True)
class Pinned:
    """Pins as arrays: paths_m (U, N, 2) metres, NaN where free; serving (K, N), -1 where free; `pins` explains them."""

    pins: Pins
    paths_m: Array
    serving: NDArray[np.intp]


def pinned(scenario: Scenario, pins: Pins, current_m: Mapping[str, Sequence[Point]] | None = None) -> Pinned:
    """Return the pins of a request as arrays, and with the paths of pinned UAVs written out.

    current_m: the path that a UAV is on, (N, 2) metres from slot 0 on; who has none hovers at its start. Raises
    PinError with field and rule for unknown ids, wrong lengths, and paths that leave the area, are too fast (6d), come
    too close to each other (6e), do not begin at the start (6g), miss an end position or enter a no-fly zone.
    """
    paths_m = dict(_paths(scenario, pins, current_m or {}))
    _check_apart(scenario, pins, paths_m)
    table_m = np.full((len(scenario.uavs), scenario.slots, 2), np.nan)
    for row, uav in zip(table_m, scenario.uav_ids, strict=True):
        if uav in paths_m:
            row[:] = paths_m[uav]
    spelt = Pins(
        paths_m={uav: tuple((e, n) for e, n in path.tolist()) for uav, path in paths_m.items()},
        associations=pins.associations,
    )
    return Pinned(spelt, table_m if paths_m else np.zeros((0, 0, 2)), _serving(scenario, pins))


def _paths(scenario: Scenario, pins: Pins, current_m: Mapping[str, Sequence[Point]]) -> Iterator[tuple[str, Array]]:
    """Return each pinned UAV with its checked path: (N, 2) metres."""
    for field, ids in (("paths_m", list(pins.paths_m)), ("uavs", list(pins.uavs))):
        for uav_id in ids:
            if uav_id not in scenario.uav_ids:
                raise PinError(f"pins.{field}: {uav_id!r} is not a UAV of the plan")
    for uav_id, given in pins.paths_m.items():
        field, uav = f"pins.paths_m.{uav_id}", scenario.uav(uav_id)
        if uav_id in pins.uavs:
            raise PinError(f"pins.uavs: {uav_id!r} is pinned to another path by pins.paths_m")
        flown = scenario.last_slot(uav) + 1
        if len(given) not in {flown, scenario.slots}:
            raise PinError(f"{field}: has {len(given)} points, but {uav_id!r} flies in {flown} slots")
        if dist(given[0], uav.start_m) > AT_START_M:
            raise PinError(f"{field}: begins at {given[0]}, but {uav_id!r} starts at {uav.start_m} (eq. 6g)")
        yield uav_id, _checked(scenario, uav, field, _whole(scenario, uav, given))
    for uav_id in pins.uavs:
        uav = scenario.uav(uav_id)
        wanted = current_m.get(uav_id, [uav.start_m] * scenario.slots)
        yield uav_id, _checked(scenario, uav, "pins.uavs", caught_up_m(scenario, uav, wanted))


def _whole(scenario: Scenario, uav: Uav, given: Sequence[Point]) -> Array:
    """Return a path from exactly the start on; after its last slot a UAV keeps its place in the table."""
    last = scenario.last_slot(uav)
    path = np.array([given[min(n, last)] for n in range(scenario.slots)], dtype=float)
    path[0] = uav.start_m
    return path


def caught_up_m(scenario: Scenario, uav: Uav, wanted: Sequence[Point]) -> Array:
    """Return the way from the start onto the wanted path, as fast as the UAV flies."""
    limit, air = uav.max_speed_mps * scenario.slot_duration_s, scenario.air_of(uav)
    path = _whole(scenario, uav, wanted)
    for n in range(1, scenario.last_slot(uav) + 1):
        move = path[n] - path[n - 1]
        length, longest = float(np.hypot(*move)), _longest_m(air, move, limit)
        if length > longest + ROUNDING_M:
            path[n] = path[n - 1] + move * (longest * SHRINK / length)
    path[scenario.last_slot(uav) + 1 :] = path[scenario.last_slot(uav)]
    return path


def _checked(scenario: Scenario, uav: Uav, field: str, path: Array) -> Array:
    """Return the path. Raises PinError unless this UAV, alone in the air, may fly it."""
    (west, south), (east, north) = scenario.area_m
    limit, air = uav.max_speed_mps * scenario.slot_duration_s, scenario.air_of(uav)
    flown: list[Point] = [(e, n) for e, n in path[: scenario.last_slot(uav) + 1].tolist()]
    for n, point in enumerate(flown):
        if not (west <= point[0] <= east and south <= point[1] <= north):
            raise PinError(f"{field}: {point} of {uav.id!r} in slot {n} lies outside area_m {scenario.area_m} (eq. 6f)")
    for n, (here, there) in enumerate(pairwise([*flown, flown[-1]])):
        longest = _longest_m(air, np.subtract(there, here), limit)
        if dist(here, there) > longest + ROUNDING_M:
            raise PinError(
                f"{field}: {uav.id!r} would move {dist(here, there):.6g} m in slot {n}, "
                f"but it can fly only {longest:.6g} m (eq. 6d)"
            )
        for number, zone in enumerate(scenario.no_fly):
            if no_fly_depth_m(zone, here, there) > ROUNDING_M:
                raise PinError(f"{field}: {uav.id!r} would enter no_fly.{number} in slot {n}")
    if uav.end_m is not None and dist(flown[-1], uav.end_m) > ROUNDING_M:
        raise PinError(f"{field}: {uav.id!r} would end at {flown[-1]}, not at its end_m {uav.end_m}")
    _check_energy(scenario, uav, air, field, path)
    return path


def _longest_m(air: Air | None, move_m: Array, limit_m: float) -> float:
    """Return how far a UAV flies in a slot in the direction of a move (2,), metres; limit_m: its `D_max`."""
    return limit_m if air is None else float(air.longest_m(np.asarray(move_m, dtype=float)[None])[0])


def _check_energy(scenario: Scenario, uav: Uav, air: Air | None, field: str, path: Array) -> None:
    """Raise PinError where the UAV could not go home from its path with its reserve."""
    if air is None:
        return
    flying = scenario.last_slot(uav) + 1
    margin = account_of(air, path[None], np.array([flying])).margin_wh[0, :flying]
    if margin.min() < -ROUNDING_WH:
        n = int(np.argmax(margin < -ROUNDING_WH))
        raise PinError(
            f"{field}: {uav.id!r} would not come home with its reserve after slot {n}: it lacks {-margin[n]:.3g} Wh"
        )


def _check_apart(scenario: Scenario, pins: Pins, paths_m: Mapping[str, Array]) -> None:
    """Raise PinError when two pinned UAVs come too close to each other while both fly."""
    for a, b in combinations(paths_m, 2):
        together = min(scenario.last_slot(scenario.uav(a)), scenario.last_slot(scenario.uav(b))) + 1
        apart = closest_approach(np.stack([paths_m[a][:together], paths_m[b][:together]]))
        if apart < scenario.min_separation_m - ROUNDING_M:
            field = "paths_m" if a in pins.paths_m or b in pins.paths_m else "uavs"
            raise PinError(
                f"pins.{field}: {a!r} and {b!r} would come within {apart:.3g} m, closer than "
                f"min_separation_m {scenario.min_separation_m:g} (eq. 6e)"
            )


def _serving(scenario: Scenario, pins: Pins) -> NDArray[np.intp]:
    """Return who has to serve each user, (K, N) UAV indices, -1 where that is free; empty without such pins."""
    if not pins.associations:
        return np.zeros((0, 0), dtype=np.intp)
    number = {uav: u for u, uav in enumerate(scenario.uav_ids)}
    serving = np.full((len(scenario.users), scenario.slots), -1, dtype=np.intp)
    for user, given in pins.associations.items():
        field = f"pins.associations.{user}"
        if user not in scenario.user_ids:
            raise PinError(f"pins.associations: {user!r} is not a user of the plan")
        row = [given] * scenario.slots if isinstance(given, str) else given
        if len(row) != scenario.slots:
            raise PinError(f"{field}: has {len(row)} slots, but the plan has {scenario.slots}")
        for n, uav_id in enumerate(row):
            if uav_id is None:
                continue
            if uav_id not in number:
                raise PinError(f"{field}: {uav_id!r} is not a UAV of the plan")
            if n > scenario.last_slot(scenario.uav(uav_id)):
                raise PinError(f"{field}: {uav_id!r} has left by slot {n}")
            serving[scenario.user_ids.index(user), n] = number[uav_id]
    return serving
