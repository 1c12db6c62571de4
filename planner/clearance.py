"""An independent check that a plan keeps clear of the ground, within its climb rates and limits of altitude.

It reads the emitted plan and the raw heights of its scenario, and shares no code with the planner or with `Terrain`: a
line is followed from cell to cell, and in each the height of the vehicle less that of the ground is a quadratic of the
way, whose least value is known. A leg is flown straight in three dimensions; on the way home a vehicle keeps the
altitude that it has when it turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Frozen, Scenario, Uav

ROUNDING_M = 1e-6
RAYS = 9
"""Ways home that are followed from each leg, ends included."""


class TooLow(Frozen):
    """Where a plan breaks a rule of altitudes: `rule` is `altitude`, `climb` or `clearance`."""

    rule: str
    where: str
    message: str


def breaches(plan: Plan) -> Iterator[TooLow]:
    """Yield every broken rule of altitudes, UAV by UAV; nothing for a plan whose scenario has none."""
    scenario = plan.scenario
    limits = [one.altitude_min_m for one in scenario.uavs] + [one.altitude_max_m for one in scenario.uavs]
    limited = any(limit is not None for limit in (scenario.altitude_min_m, scenario.altitude_max_m, *limits))
    if scenario.terrain is None and not limited:
        if plan.altitudes_m is not None:
            yield TooLow(rule="altitude", where="altitudes_m", message="the scenario asks for none")
        return
    given = plan.altitudes_m or {}
    for uav in scenario.uavs:
        row = given.get(uav.id, [])
        if len(row) != scenario.slots or not np.isfinite(row).all():
            yield TooLow(rule="altitude", where=uav.id, message=f"has {len(row)} altitudes of {scenario.slots}")
            continue
        yield from _of_one(scenario, uav, np.array(plan.trajectories_m[uav.id], dtype=float), np.array(row))


def _of_one(scenario: Scenario, uav: Uav, path: Array, altitude: Array) -> Iterator[TooLow]:
    flown = scenario.last_slot(uav) + 1
    path, altitude = path[:flown], altitude[:flown]
    yield from _climbs(scenario, uav, altitude)
    ground = _Ground(scenario)
    home = np.array(uav.home_m or uav.start_m, dtype=float)
    starts, ends = path, np.vstack([path[1:], path[-1:]])
    from_m, to_m = altitude, np.append(altitude[1:], altitude[-1])
    least = 0.0 if scenario.terrain is None else (30.0 if scenario.clearance_m is None else scenario.clearance_m)
    under = ground.margins(starts, ends, from_m, to_m)
    for n in np.flatnonzero(under < least - ROUNDING_M):
        message = f"flies {under[n]:.3f} m over the ground, less than {least:g} m"
        yield TooLow(rule="clearance", where=f"{uav.id} slot {n}", message=message)
    share = np.linspace(0.0, 1.0, RAYS)[:, None]
    turns = (starts + share[..., None] * (ends - starts)).reshape(-1, 2)
    levels = (from_m + share * (to_m - from_m)).reshape(-1)
    homeward = ground.margins(turns, np.broadcast_to(home, turns.shape), levels, levels).reshape(RAYS, -1).min(axis=0)
    for n in np.flatnonzero(homeward < least - ROUNDING_M):
        message = f"would return {homeward[n]:.3f} m over the ground, less than {least:g} m"
        yield TooLow(rule="clearance", where=f"{uav.id} slot {n}, on the way home", message=message)
    yield from _limits(scenario, uav, ground, path, altitude)


def _climbs(scenario: Scenario, uav: Uav, altitude: Array) -> Iterator[TooLow]:
    most = (1.5 if uav.max_climb_mps is None else uav.max_climb_mps) * scenario.slot_duration_s
    for n, (here, there) in enumerate(pairwise(altitude.tolist())):
        if abs(there - here) > most + ROUNDING_M:
            yield TooLow(rule="climb", where=f"{uav.id} slot {n}", message=f"climbs {there - here} m of {most} m")
    start = uav.start_altitude_m
    if start is not None and altitude[0] < start - ROUNDING_M:
        yield TooLow(rule="climb", where=f"{uav.id} slot 0", message=f"begins at {altitude[0]} m, not at {start} m")


def _limits(scenario: Scenario, uav: Uav, ground: _Ground, path: Array, altitude: Array) -> Iterator[TooLow]:
    """Check the least and greatest height above the highest ground under the legs that meet in each slot."""
    wanted = scenario.altitude_m if uav.altitude_m is None else uav.altitude_m
    given = [scenario.altitude_min_m if uav.altitude_min_m is None else uav.altitude_min_m]
    given.append(scenario.altitude_max_m if uav.altitude_max_m is None else uav.altitude_max_m)
    low, high = (wanted if limit is None else limit for limit in given)
    highest = -ground.margins(path[:-1], path[1:], np.zeros(len(path) - 1), np.zeros(len(path) - 1))
    at = -ground.margins(path, path, np.zeros(len(path)), np.zeros(len(path)))
    under = np.maximum.reduce([at, np.append(highest, -np.inf), np.append(-np.inf, highest)])
    for n in np.flatnonzero(altitude < under + low - ROUNDING_M):
        message = f"is {altitude[n] - under[n]:.3f} m above the highest ground of its legs, less than {low:g} m"
        yield TooLow(rule="altitude", where=f"{uav.id} slot {n}", message=message)
    if given == [None, None] or uav.start_altitude_m is not None:
        return  # not chosen, or begun somewhere else: then it may have to come down first
    for n in np.flatnonzero(altitude > under + high + 10 * ROUNDING_M):
        message = f"is {altitude[n] - under[n]:.3f} m above the highest ground of its legs, more than {high:g} m"
        yield TooLow(rule="altitude", where=f"{uav.id} slot {n}", message=message)


class _Ground:
    """The raw heights of a scenario; level at 0 without any."""

    def __init__(self, scenario: Scenario) -> None:
        terrain = scenario.terrain
        self._heights = np.zeros((2, 2)) if terrain is None else np.array(terrain.heights_m, dtype=float)
        self._corner = np.zeros(2) if terrain is None else np.array(terrain.south_west_m, dtype=float)
        self._spacing = 1.0 if terrain is None else terrain.spacing_m

    def margins(self, starts: Array, ends: Array, from_m: Array, to_m: Array) -> Array:
        """Return the least height over the ground on each line, (L, 2) to (L, 2), from one altitude to the other."""
        begin, finish = (starts - self._corner) / self._spacing, (ends - self._corner) / self._spacing
        rows, columns = self._heights.shape
        line, low, high = _pieces(begin, finish, (columns, rows))
        x0, y0 = begin[line].T
        x1, y1 = finish[line].T
        middle = (low + high) / 2
        inside_x, slope_x = _held(x0, x1, middle, columns - 1)
        inside_y, slope_y = _held(y0, y1, middle, rows - 1)
        column = np.clip(np.floor(inside_x).astype(int), 0, columns - 2)
        row = np.clip(np.floor(inside_y).astype(int), 0, rows - 2)
        corner, right = self._heights[row, column], self._heights[row, column + 1]
        above, across = self._heights[row + 1, column], self._heights[row + 1, column + 1]
        twist = corner - right - above + across
        # with x = px + qx t and y = py + qy t in the cell: ground = c0 + c1 t + c2 t^2
        px, qx = inside_x - slope_x * middle - column, slope_x
        py, qy = inside_y - slope_y * middle - row, slope_y
        c0 = corner + (right - corner) * px + (above - corner) * py + twist * px * py
        c1 = (right - corner) * qx + (above - corner) * qy + twist * (px * qy + py * qx)
        c2 = twist * qx * qy
        a, b, c = -c2, (to_m - from_m)[line] - c1, from_m[line] - c0
        bottom = np.clip(np.divide(-b, 2 * a, out=low.copy(), where=a > 0.0), low, high)
        least = np.full(len(starts), np.inf)
        for t in (low, high, bottom):
            np.minimum.at(least, line, c + (b + a * t) * t)
        return least


def _pieces(begin: Array, finish: Array, counts: tuple[int, int]) -> tuple[NDArray[np.intp], Array, Array]:
    """Return lines (L, 2), in grid units, as pieces within one cell: the line of each, and its shares of the way."""
    every = np.arange(len(begin))
    owners, shares = [every, every], [np.zeros(len(begin)), np.ones(len(begin))]
    for axis, count in enumerate(counts):
        owner, share = _passes(begin[:, axis], finish[:, axis], count)
        owners.append(owner)
        shares.append(share)
    line, at = np.concatenate(owners), np.concatenate(shares)
    order = np.lexsort((at, line))
    line, at = line[order], at[order]
    goes_on = line[1:] == line[:-1]
    return line[1:][goes_on], at[:-1][goes_on], at[1:][goes_on]


def _passes(start: Array, end: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Return which line passes a grid line 0 to `count` - 1, and at which share of its way."""
    first = np.ceil(np.maximum(np.minimum(start, end), 0.0))
    last = np.floor(np.minimum(np.maximum(start, end), count - 1.0))
    passes = np.where(start == end, 0, np.maximum(last - first + 1, 0)).astype(np.intp)
    line = np.repeat(np.arange(len(start)), passes)
    grid_line = first[line] + np.arange(len(line)) - np.repeat(np.cumsum(passes) - passes, passes)
    return line, np.clip((grid_line - start[line]) / (end - start)[line], 0.0, 1.0)


def _held(start: Array, end: Array, middle: Array, last: int) -> tuple[Array, Array]:
    """Return where each piece of a way is in its middle, and how fast it moves, in grid units; still beyond edges."""
    at = start + (end - start) * middle
    beyond = (at < 0.0) | (at > last)
    return np.clip(at, 0.0, last), np.where(beyond, 0.0, end - start)
