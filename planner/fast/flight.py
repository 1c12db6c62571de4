"""From wished motions to a path that can be flown: each limit is kept slot by slot, on the legs too, to the last bit.

Slot by slot, each UAV makes its wished step, shortened to `D_max`, bent towards its end position while that must
still be reached, and clipped to the area. Then the legs are checked against each other and the no-fly zones. A leg
that comes too close is pushed out along the tangent, so that UAVs slide past each other; who still conflicts holds
its position, which is always safe: relative motion can only stop. A feasible path passes unchanged. A UAV whose path
is pinned flies just that: the others give way, and where they cannot, there is no path.
In wind and with batteries a step is shortened along itself, to what the air and the way home allow (`air.py`).
"""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.fast.air import affordable_share, home_wh, left_wh
from skyfolio.planner.fast.arena import Arena, Flag, Ints, entry, inlined, is_pinned, kernel, smooth
from skyfolio.planner.fast.routes import one_step, reach_of_step, way_on
from skyfolio.planner.fast.zones import SLACK_M, push_from_zones, push_out

PUSHES = 8
HALVINGS = 20


@entry
def fly(arena: Arena, wish: Array, chase: Flag, path: Array) -> bool:
    """Write the flyable path nearest to `wish` (N, 2, U) into `path`; return False where an end becomes unreachable.

    wish: metres, the steps into each slot, or with `chase` the positions to go to. Slot 0 is the start.
    """
    n_uavs = path.shape[2]
    for u in range(n_uavs):
        path[0, 0, u], path[0, 1, u] = arena.start_m[0, u], arena.start_m[1, u]
    near = np.empty((n_uavs * (n_uavs - 1) // 2 + 1, 2), dtype=np.int64)
    zones = arena.discs.shape[0] > 0 or arena.first.shape[0] > 1
    spare = _spare(arena)
    plain = not (arena.has_pinned or arena.has_ends or arena.has_wind or arena.has_energy)
    step_m, last, low, high, separation_m = arena.step_m, arena.last, arena.low, arena.high, arena.separation_m
    for n in range(1, path.shape[0]):
        for u in range(n_uavs):
            dx, dy = wish[n, 0, u], wish[n, 1, u]
            if chase:
                dx, dy = dx - path[n - 1, 0, u], dy - path[n - 1, 1, u]
            if plain and n <= last[u]:
                plain_step(path, n, u, dx, dy, step_m[u], low, high)
            else:
                step(arena, path, n, u, dx, dy, spare)
        pairs = _near_pairs(path, n, step_m, separation_m, near)
        if (pairs > 0 or zones) and not _resolve(arena, path, n, zones, near[:pairs], spare):
            return False
        if arena.has_energy and not _pay(arena, path, n, spare):
            return False
    return True


@inlined
def plain_step(path: Array, n: int, u: int, dx: float, dy: float, limit: float, low: Array, high: Array) -> None:
    """Do as `step` where only speed and area limit it: handing over a whole arena would take longer than the step."""
    x, y = path[n - 1, 0, u], path[n - 1, 1, u]
    length2 = dx * dx + dy * dy
    if length2 > limit * limit:
        scale = limit / np.sqrt(length2)
        dx, dy = dx * scale, dy * scale
    path[n, 0, u] = min(max(x + dx, low[0]), high[0])
    path[n, 1, u] = min(max(y + dy, low[1]), high[1])


@kernel
def step(arena: Arena, path: Array, n: int, u: int, dx: float, dy: float, spare: Array) -> None:
    """Move UAV u from slot n - 1 by (dx, dy) metres as far as speed, end, area, wind and energy allow.

    spare: (2, U) Wh, what each has to spare in slot n - 1, and what its way home costs there.
    """
    if arena.has_pinned and is_pinned(arena, u):
        path[n, 0, u], path[n, 1, u] = arena.pinned[n, 0, u], arena.pinned[n, 1, u]
        return
    x, y = path[n - 1, 0, u], path[n - 1, 1, u]
    if n > arena.last[u]:
        path[n, 0, u], path[n, 1, u] = x, y
        return
    length2, limit = dx * dx + dy * dy, reach_of_step(arena, u, dx, dy) if arena.has_wind else arena.step_m[u]
    if length2 > limit * limit:
        scale = limit / np.sqrt(length2)
        dx, dy = dx * scale, dy * scale
    to_x, to_y = x + dx, y + dy
    if arena.has_ends and not np.isnan(arena.end_m[0, u]):
        to_x, to_y = _towards_end(arena, n, u, x, y, to_x, to_y)
    path[n, 0, u] = min(max(to_x, arena.low[0]), arena.high[0])
    path[n, 1, u] = min(max(to_y, arena.low[1]), arena.high[1])
    if arena.has_wind and (path[n, 0, u] != to_x or path[n, 1, u] != to_y):
        _shorten(path, n, u, _share_in_wind(arena, u, path[n, 0, u] - x, path[n, 1, u] - y))
        if arena.has_ends and not np.isnan(arena.end_m[0, u]) and n < arena.last[u]:
            _keep_in_time(arena, path, n, u)
    if arena.has_energy and spare[0, u] < arena.breeze.most_wh[u] and arena.breeze.each_wh[u] > 0.0:
        dx, dy = path[n, 0, u] - x, path[n, 1, u] - y
        _shorten(path, n, u, affordable_share(arena.breeze, u, spare[0, u], spare[1, u], x, y, dx, dy))


@kernel
def _keep_in_time(arena: Arena, path: Array, n: int, u: int) -> None:
    """Step straight on to the end where a step that the edge has turned would let the wind keep the UAV from it."""
    if not _in_time(arena, u, path[n, 0, u], path[n, 1, u], arena.last[u] - n):
        end_x, end_y = arena.end_m[0, u], arena.end_m[1, u]
        x, y = one_step(arena, u, path[n - 1, 0, u], path[n - 1, 1, u], end_x, end_y)
        path[n, 0, u], path[n, 1, u] = x, y


@kernel
def _share_in_wind(arena: Arena, u: int, dx: float, dy: float) -> float:
    """Return the share of a step (dx, dy) that the wind allows: the edge of the area has turned it."""
    limit, away = reach_of_step(arena, u, dx, dy), np.hypot(dx, dy)
    return limit / away if away > limit else 1.0


@kernel
def _shorten(path: Array, n: int, u: int, share: float) -> None:
    """Shorten the step of UAV u into slot n, along itself."""
    if share < 1.0:
        for axis in range(2):
            here = path[n - 1, axis, u]
            path[n, axis, u] = here + share * (path[n, axis, u] - here)


@kernel
def _spare(arena: Arena) -> Array:
    """Return what each UAV has to spare in slot 0, Wh, and what its way home costs there: (2, U)."""
    n_uavs = arena.start_m.shape[1]
    spare = np.full((2, n_uavs), np.inf)
    if arena.has_energy:
        for u in range(n_uavs):
            spare[0, u] = arena.breeze.spare_wh[u]
            spare[1, u] = home_wh(arena.breeze, u, arena.start_m[0, u], arena.start_m[1, u])
    return spare


@kernel
def _pay(arena: Arena, path: Array, n: int, spare: Array) -> bool:
    """Take what the steps into slot n cost off `spare` (2, U) Wh; return whether everybody can afford them."""
    for u in range(path.shape[2]):
        if n > arena.last[u] or spare[0, u] == np.inf:
            continue
        x, y = path[n - 1, 0, u], path[n - 1, 1, u]
        dx, dy = path[n, 0, u] - x, path[n, 1, u] - y
        spare[0, u], spare[1, u] = left_wh(arena.breeze, u, spare[0, u], spare[1, u], x, y, dx, dy)
        if not spare[0, u] >= 0.0:
            return False
    return True


@kernel
def _towards_end(arena: Arena, n: int, u: int, x: float, y: float, to_x: float, to_y: float) -> tuple[float, float]:
    """Return the point nearest to (to_x, to_y) in one step of (x, y) from which the end can still be reached."""
    if arena.has_wind:
        return _towards_end_in_wind(arena, n, u, x, y, to_x, to_y)
    end_x, end_y, limit = arena.end_m[0, u], arena.end_m[1, u], arena.step_m[u]
    left = (arena.last[u] - n) * limit
    if left == 0.0:
        return end_x, end_y
    away = np.hypot(to_x - end_x, to_y - end_y)
    if away <= left:
        return to_x, to_y
    near_x, near_y = end_x + (to_x - end_x) * left / away, end_y + (to_y - end_y) * left / away
    if np.hypot(near_x - x, near_y - y) <= limit:
        return near_x, near_y
    apart = np.hypot(end_x - x, end_y - y)
    if apart >= left + limit:  # only straight on
        return x + (end_x - x) * limit / apart, y + (end_y - y) * limit / apart
    along = (apart * apart + limit * limit - left * left) / (2.0 * apart)
    across = np.sqrt(max(0.0, limit * limit - along * along)) * (1.0 - 1e-12)
    ex, ey = (end_x - x) / apart, (end_y - y) / apart
    side = 1.0 if ex * (to_y - y) - ey * (to_x - x) >= 0.0 else -1.0
    return x + along * ex - side * across * ey, y + along * ey + side * across * ex


@kernel
def _towards_end_in_wind(
    arena: Arena, n: int, u: int, x: float, y: float, to_x: float, to_y: float
) -> tuple[float, float]:
    """Return the point nearest to (to_x, to_y), on the way there from a full step to the end, that is still in time.

    From where the end is still in reach is convex, and so is where a step leads: all points between are fine.
    """
    left, end_x, end_y = arena.last[u] - n, arena.end_m[0, u], arena.end_m[1, u]
    if left == 0:
        return end_x, end_y
    if _in_time(arena, u, to_x, to_y, left):
        return to_x, to_y
    sure_x, sure_y = one_step(arena, u, x, y, end_x, end_y)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        share = (low + high) / 2.0
        if _in_time(arena, u, sure_x + share * (to_x - sure_x), sure_y + share * (to_y - sure_y), left):
            low = share
        else:
            high = share
    return sure_x + low * (to_x - sure_x), sure_y + low * (to_y - sure_y)


@kernel
def _in_time(arena: Arena, u: int, x: float, y: float, left: int) -> bool:
    """Return whether UAV u flies straight from (x, y) to its end in `left` slots."""
    dx, dy = arena.end_m[0, u] - x, arena.end_m[1, u] - y
    return bool(np.hypot(dx, dy) <= left * reach_of_step(arena, u, dx, dy))


@kernel
def _resolve(arena: Arena, path: Array, n: int, zones: bool, near: Ints, spare: Array) -> bool:
    """Push, then hold, until no leg into slot n conflicts; False where a hold would miss an end.

    near: (P, 2), the pairs that can meet on the leg at all.
    """
    n_uavs, separation_m = path.shape[2], arena.separation_m
    for attempt in range(PUSHES + n_uavs + 1):
        hold = attempt >= PUSHES
        clear = True
        if zones:
            for u in range(n_uavs):
                clear = _keep_out(arena, path, n, u, hold, spare) and clear
                clear = _on_the_way(arena, path, n, u) and clear
        for i in range(near.shape[0]):
            px, py = _push_apart(path, n, near[i, 0], near[i, 1], separation_m)
            if px != 0.0 or py != 0.0:
                clear = _keep_apart(arena, path, n, near[i, 0], near[i, 1], px, py, hold, spare) and clear
        if clear:
            return _ends_reachable(arena, path, n)
    return False


@smooth
def _near_pairs(path: Array, n: int, step_m: Array, separation_m: float, near: Ints) -> int:
    """Return the pairs that stand so near before slot n that their next legs could come within `D_min`; how many."""
    if separation_m == 0.0:
        return 0
    n_uavs, found = path.shape[2], 0
    for u in range(n_uavs - 1):
        reach, count = separation_m + step_m[u], 0
        for j in range(u + 1, n_uavs):
            dx, dy = path[n - 1, 0, u] - path[n - 1, 0, j], path[n - 1, 1, u] - path[n - 1, 1, j]
            limit = reach + step_m[j]
            count += dx * dx + dy * dy < limit * limit
        if count == 0:
            continue
        for j in range(u + 1, n_uavs):
            dx, dy = path[n - 1, 0, u] - path[n - 1, 0, j], path[n - 1, 1, u] - path[n - 1, 1, j]
            limit = reach + step_m[j]
            if dx * dx + dy * dy < limit * limit:
                near[found, 0], near[found, 1] = u, j
                found += 1
    return found


@kernel
def _ends_reachable(arena: Arena, path: Array, n: int) -> bool:
    if not arena.has_ends:
        return True
    for u in range(path.shape[2]):
        if n <= arena.last[u] and not np.isnan(arena.end_m[0, u]) and not (arena.has_pinned and is_pinned(arena, u)):
            dx, dy = arena.end_m[0, u] - path[n, 0, u], arena.end_m[1, u] - path[n, 1, u]
            if np.hypot(dx, dy) > (arena.last[u] - n) * reach_of_step(arena, u, dx, dy) + SLACK_M:
                return False
    return True


@kernel
def _hold(path: Array, n: int, u: int) -> None:
    path[n, 0, u], path[n, 1, u] = path[n - 1, 0, u], path[n - 1, 1, u]


@kernel
def _keep_out(arena: Arena, path: Array, n: int, u: int, hold: bool, spare: Array) -> bool:
    """Return whether the leg of u stays out of every zone; if not, it is pushed out, or held."""
    if n > arena.last[u] or (arena.has_pinned and is_pinned(arena, u)):
        return True
    dx, dy, inside = push_from_zones(arena, path[n - 1, 0, u], path[n - 1, 1, u], path[n, 0, u], path[n, 1, u])
    if not inside:
        return True
    if hold:
        _hold(path, n, u)
    else:
        dx, dy = path[n, 0, u] + dx - path[n - 1, 0, u], path[n, 1, u] + dy - path[n - 1, 1, u]
        step(arena, path, n, u, dx, dy, spare)
    return False


@kernel
def _on_the_way(arena: Arena, path: Array, n: int, u: int) -> bool:
    """Return whether u can still reach its end around the zones; if not, it takes the next step of the shortest way."""
    if (
        n > arena.last[u]
        or not arena.has_ends
        or np.isnan(arena.end_m[0, u])
        or (arena.has_pinned and is_pinned(arena, u))
    ):
        return True
    end_x, end_y, left = arena.end_m[0, u], arena.end_m[1, u], arena.left[u]
    slots, _, _ = way_on(arena, left, u, path[n, 0, u], path[n, 1, u], end_x, end_y)
    if slots <= arena.last[u] - n:
        return True
    x, y = path[n - 1, 0, u], path[n - 1, 1, u]
    _, to_x, to_y = way_on(arena, left, u, x, y, end_x, end_y)
    path[n, 0, u], path[n, 1, u] = one_step(arena, u, x, y, to_x, to_y)
    return False


@kernel
def _push_apart(path: Array, n: int, u: int, j: int, separation_m: float) -> tuple[float, float]:
    """Return by how much the leg of u must be pushed away from that of j to stay `D_min` apart: 0, 0 where it does."""
    x0, y0 = path[n - 1, 0, u] - path[n - 1, 0, j], path[n - 1, 1, u] - path[n - 1, 1, j]
    x1, y1 = path[n, 0, u] - path[n, 0, j], path[n, 1, u] - path[n, 1, j]
    return push_out(x0, y0, x1, y1, separation_m)


@kernel
def _keep_apart(
    arena: Arena, path: Array, n: int, u: int, j: int, px: float, py: float, hold: bool, spare: Array
) -> bool:
    """Push each of u and j half of (px, py) apart, or hold them; return whether that was not theirs to do.

    Beside a UAV whose path is pinned the other is pushed all the way, and never held: staying is no safety there.
    """
    u_pinned = arena.has_pinned and is_pinned(arena, u)
    j_pinned = arena.has_pinned and is_pinned(arena, j)
    if n > min(arena.last[u], arena.last[j]) or (u_pinned and j_pinned):
        return True
    one_pinned = u_pinned or j_pinned
    if hold and not one_pinned:
        _hold(path, n, u)
        _hold(path, n, j)
        return False
    share = 1.0 if one_pinned else 0.5
    for one, sign in ((u, share), (j, -share)):
        dx = path[n, 0, one] + sign * px - path[n - 1, 0, one]
        dy = path[n, 1, one] + sign * py - path[n - 1, 1, one]
        step(arena, path, n, one, dx, dy, spare)
    return False
