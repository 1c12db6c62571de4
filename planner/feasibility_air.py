"""Part of the independent check of a plan: the air it is flown through, and the energy to come home.

Written apart from `energy/`, by other means: in plain arithmetic from the plan's own numbers, with airspeeds that are
looked for instead of bounded. It proves what the plan claims to the extent that it finds no wind within the gust that
breaks it; it tolerates rounding only.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import cos, hypot, inf, pi, sin, sqrt

from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Point, Rotors, Scenario, Uav, Wind

Fault = tuple[str, str, str]
"""The broken constraint, where, and what is wrong."""
ROUNDING_MPS = 1e-9
ROUNDING_WH = 1e-6
_GUSTS = 16
"""So many directions of a full gust are tried, beside the steady wind."""
_HALVINGS = 60


def air_faults(plan: Plan) -> Iterator[Fault]:
    """Yield what is wrong with airspeeds and energy; nothing for a scenario without wind and batteries."""
    for uav in plan.scenario.uavs:
        flown = plan.trajectories_m[uav.id][: plan.scenario.last_slot(uav) + 1]
        if plan.scenario.wind is not None:
            yield from _airspeeds(plan.scenario, uav, flown)
        if uav.battery is not None:
            yield from _energy(plan, uav, flown)


def _airspeeds(scenario: Scenario, uav: Uav, flown: list[Point]) -> Iterator[Fault]:
    limit, slot_s = uav.max_airspeed_mps, scenario.slot_duration_s
    limit = uav.max_speed_mps if limit is None else limit
    for n, ((e0, n0), (e1, n1)) in enumerate(pairwise([*flown, flown[-1]])):
        fastest = max(_airspeeds_in_gusts(_wind(scenario), (e1 - e0) / slot_s, (n1 - n0) / slot_s))
        if fastest > limit + ROUNDING_MPS:
            yield "wind", f"{uav.id} slot {n}", f"flies {fastest} m/s through the air in a gust, of {limit} m/s"


def _energy(plan: Plan, uav: Uav, flown: list[Point]) -> Iterator[Fault]:
    """Check each slot's margin, and that the plan tells it, and its use, no better than it is."""
    scenario, battery = plan.scenario, uav.battery
    rotors, slot_s = uav.rotors or Rotors(), plan.scenario.slot_duration_s
    assert battery is not None  # noqa: S101 - the caller has looked
    wind, heights = _wind(scenario), _heights_m(plan, uav, len(flown))
    if heights is None:
        return  # `clearance.py` tells of missing altitudes
    told_used, told_margin = plan.energy_wh.get(uav.id, []), plan.energy_margin_wh.get(uav.id, [])
    if len(told_used) != scenario.slots or len(told_margin) != scenario.slots:
        yield "energy", uav.id, f"energy_wh or energy_margin_wh does not hold {scenario.slots} slots"
        return
    hover_j = _worst_w(rotors, wind, 0.0, 0.0)
    still_j = _power_w(rotors, hypot(wind.east_mps, wind.north_mps))
    lift_s, lift_j = heights[0] / rotors.climb_mps, rotors.climb_w_per_mps * heights[0]
    on_ground = battery.used_wh is None
    worst = hover_j * lift_s + lift_j if on_ground else (battery.used_wh or 0.0) * 3600.0
    expected = still_j * lift_s + lift_j if on_ground else worst
    for n, ((e0, n0), (e1, n1)) in enumerate(pairwise([*flown, flown[-1]])):
        east, north = (e1 - e0) / slot_s, (n1 - n0) / slot_s
        ends_at = heights[min(n + 1, len(flown) - 1)]
        rise_j = rotors.climb_w_per_mps * max(0.0, ends_at - heights[n])
        worst += _worst_w(rotors, wind, east, north) * slot_s + rise_j
        expected += _power_w(rotors, hypot(east - wind.east_mps, north - wind.north_mps)) * slot_s + rise_j
        landing_j = hover_j * ends_at / rotors.descend_mps
        home_j = min(_way_j(scenario, uav, rotors, (e1, n1), place) for place in _places(scenario, uav)) + landing_j
        margin = battery.usable_wh * (1.0 - battery.reserve_share) - (worst + home_j) / 3600.0
        if margin < -ROUNDING_WH:
            message = f"lacks {-margin} Wh to come home with its reserve"
            yield "energy", f"{uav.id} slot {n}", message
        if told_margin[n] > margin + ROUNDING_WH:
            yield "energy", f"{uav.id} slot {n}", f"promises a margin of {told_margin[n]} Wh, but has {margin} Wh"
        if abs(told_used[n] - expected / 3600.0) > ROUNDING_WH:
            message = f"is said to have used {told_used[n]} Wh, not {expected / 3600.0} Wh"
            yield "energy", f"{uav.id} slot {n}", message


def _way_j(scenario: Scenario, uav: Uav, rotors: Rotors, here: Point, home: Point) -> float:
    """Return what the straight way costs, J, as fast as ground speed and airspeed in every gust allow."""
    east, north = home[0] - here[0], home[1] - here[1]
    away = hypot(east, north)
    if away == 0.0:
        return 0.0
    wind, limit = _wind(scenario), uav.max_airspeed_mps
    limit = inf if scenario.wind is None else uav.max_speed_mps if limit is None else limit
    slowest, fastest = 0.0, uav.max_speed_mps
    speed = fastest
    for _ in range(_HALVINGS):
        drift = hypot(east / away * speed - wind.east_mps, north / away * speed - wind.north_mps)
        if drift + wind.gust_mps <= limit:
            slowest = speed
        else:
            fastest = speed
        speed = (slowest + fastest) / 2.0
    if slowest <= 0.0:
        return inf
    return _worst_w(rotors, wind, east / away * slowest, north / away * slowest) * away / slowest


def _worst_w(rotors: Rotors, wind: Wind, east_mps: float, north_mps: float) -> float:
    """Return the greatest power found in gusts of any strength within the bound."""
    steady = hypot(east_mps - wind.east_mps, north_mps - wind.north_mps)
    gust = wind.gust_mps
    between = (
        max(0.0, steady - gust) + (steady + gust - max(0.0, steady - gust)) * k / _GUSTS for k in range(_GUSTS + 1)
    )
    return max(_power_w(rotors, airspeed) for airspeed in between)


def _airspeeds_in_gusts(wind: Wind, east_mps: float, north_mps: float) -> Iterator[float]:
    yield hypot(east_mps - wind.east_mps, north_mps - wind.north_mps)
    for k in range(_GUSTS):
        east, north = wind.gust_mps * cos(2 * pi * k / _GUSTS), wind.gust_mps * sin(2 * pi * k / _GUSTS)
        yield hypot(east_mps - wind.east_mps - east, north_mps - wind.north_mps - north)


def _power_w(rotors: Rotors, airspeed: float) -> float:
    """Return Zeng et al. (2019), eq. (6), W."""
    swirl = airspeed / rotors.induced_mps
    induced = rotors.induced_w * sqrt(sqrt(1.0 + swirl**4 / 4.0) - swirl**2 / 2.0)
    blade = rotors.blade_w + 3.0 * rotors.blade_w * (airspeed / rotors.tip_mps) ** 2
    return blade + induced + rotors.parasite_w_per_mps3 * airspeed**3


def _wind(scenario: Scenario) -> Wind:
    return scenario.wind or Wind()


def _places(scenario: Scenario, uav: Uav) -> list[Point]:
    """Return where it may land; over terrain only its way home is checked to be clear of the ground."""
    home = uav.home_m or uav.start_m
    return [home] if scenario.terrain is not None else [home, *(point.position_m for point in scenario.rally_points)]


def _heights_m(plan: Plan, uav: Uav, n_slots: int) -> list[float] | None:
    """Return how high above its home it is when each slot begins; None where the plan does not say."""
    if plan.altitudes_m is None:
        return [plan.scenario.altitude_of(uav)] * n_slots
    row = plan.altitudes_m.get(uav.id, [])
    if len(row) < n_slots:
        return None
    ground = _ground_m(plan.scenario, uav.home_m or uav.start_m)
    return [altitude - ground for altitude in row[:n_slots]]


def _ground_m(scenario: Scenario, place: Point) -> float:
    """Return the height of the ground at a place, by weighing the four heights around it; 0 without terrain."""
    terrain = scenario.terrain
    if terrain is None:
        return 0.0
    rows, columns = len(terrain.heights_m), len(terrain.heights_m[0])
    east = min(max((place[0] - terrain.south_west_m[0]) / terrain.spacing_m, 0.0), columns - 1.0)
    north = min(max((place[1] - terrain.south_west_m[1]) / terrain.spacing_m, 0.0), rows - 1.0)
    column, row = min(int(east), columns - 2), min(int(north), rows - 2)
    return sum(
        terrain.heights_m[row + up][column + right] * abs(1 - right - (east - column)) * abs(1 - up - (north - row))
        for up in (0, 1)
        for right in (0, 1)
    )
