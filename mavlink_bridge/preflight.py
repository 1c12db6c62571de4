"""The preflight audit: is this vehicle fit to fly this plan under our timers? Pure: facts in, findings out.

Each finding names a parameter (or a measurement), what was found, what it should be, and why. A `blocker` means that
the flight would go wrong; a `warning`, that something it relies on is missing or unusual. Rules for parameters that a
vehicle did not report are left out: names differ between versions.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil, hypot

from skyfolio.mavlink_bridge.findings import Facts, Finding, Level, Needs, OverGround, blocker, warning
from skyfolio.mavlink_bridge.pace import mean_acceleration
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.reach import first_leg_miss
from skyfolio.mavlink_bridge.telemetry import FIX_3D
from skyfolio.planner.geometry import Point


def audit(facts: Facts, needs: Needs) -> list[Finding]:
    """Return all findings, blockers first."""
    findings = [*_measurements(facts, needs), *_speed(facts, needs), *_first_leg(facts, needs)]
    for rule in profile_of(facts.autopilot).rules:
        value = next((facts.parameters[name] for name in rule.names if name in facts.parameters), None)
        if value is not None:
            findings += rule.check(value, facts, needs)
    return sorted(findings, key=lambda finding: finding.level is not Level.BLOCKER)


# -- measurements -----------------------------------------------------------------------------------------------------

_FEW_SATELLITES = 8
_START_TOLERANCE_M = 5.0
_FIRST_LEG_M = 8.0
"""A vehicle that will be further than this from its point when its first leg ends is reported before take-off."""
_COMFORTABLE = 0.6
_CONTRADICTS = 0.5
"""Share of the clearance that a home may lie above or below the terrain: more than that would eat it up in flight."""
_HOME_STRAY_M = 2.0
"""A vehicle that stands a few metres from its start may have ways home this much lower over the ground."""


MULTIROTORS = {
    2: "quadrotor",
    3: "coaxial",
    13: "hexarotor",
    14: "octorotor",
    15: "tricopter",
    29: "dodecarotor",
    35: "decarotor",
}
"""MAV_TYPE of vehicles that hover, fly in any direction and number their modes as the profiles have it."""


def _measurements(facts: Facts, needs: Needs) -> Iterable[Finding]:
    if facts.mav_type is not None and facts.mav_type not in MULTIROTORS:
        why = "it cannot hover in its slots, and its modes mean something else"
        kind, should = f"MAV_TYPE {facts.mav_type}", f"a multirotor ({', '.join(map(str, MULTIROTORS))})"
        yield blocker("vehicle type", kind, should, why, refuses=True)
    if not facts.parameters:
        yield warning(
            "parameters",
            "none reported",
            "reported on request",
            "how it flies, and what it does without a link, is guessed",
        )
    yield from _places(facts, needs)
    if needs.ground is not None:
        yield from _over_ground(facts, needs.ground)
    yield from _battery(facts, needs)
    if needs.items > needs.max_items:
        yield blocker("mission", f"{needs.items} items", f"at most {needs.max_items}", "it cannot store them")


def _places(facts: Facts, needs: Needs) -> Iterable[Finding]:
    if facts.gps_fix is None or facts.gps_fix < FIX_3D:
        yield blocker("GPS fix", _reported(facts.gps_fix), "3 (3D fix) or better", "it does not know where it is")
    elif facts.satellites is not None and facts.satellites < _FEW_SATELLITES:
        yield warning("GPS satellites", str(facts.satellites), f"{_FEW_SATELLITES} or more", "its position may wander")
    if facts.home_m is None:
        yield blocker("home position", "not set", "set", "altitudes of the mission count from it")
    if facts.at_m is None:
        yield blocker("position", "none", "a place on the globe", "it is not known where its mission would begin")
    else:
        away_m = _apart(facts.at_m, needs.path_m[0])
        if away_m > min(_START_TOLERANCE_M, needs.start_within_m):
            refused = away_m > needs.start_within_m
            yield Finding(
                level=Level.BLOCKER if refused else Level.WARNING,
                name="place",
                found=f"{away_m:.0f} m from its start",
                should=f"within {needs.start_within_m if refused else _START_TOLERANCE_M:g} m",
                why="it takes off where it stands; UAVs may meet on the way to their first points",
                refuses=refused,
            )


def _over_ground(facts: Facts, ground: OverGround) -> Iterable[Finding]:
    """Yield what contradicts the terrain: altitudes above sea level are only as good as the height of the home."""
    if facts.home_amsl_m is not None:
        off_m = facts.home_amsl_m - ground.home_ground_m
        if abs(off_m) > _CONTRADICTS * ground.clearance_m:
            yield blocker(
                name="home altitude",
                found=f"{facts.home_amsl_m:.1f} m above sea level",
                should=f"{ground.home_ground_m:.1f} m, as the terrain has it, within {_CONTRADICTS:.0%} of clearance_m",
                why=f"it would fly {abs(off_m):.0f} m too {'low' if off_m > 0 else 'high'} over the ground",
                refuses=True,
            )
    if ground.way_home_m < ground.clearance_m - _HOME_STRAY_M:
        yield blocker(
            name="way home",
            found=f"{ground.way_home_m:.1f} m over the ground at its lowest",
            should=f"at least {ground.clearance_m:g} m (clearance_m)",
            why="its home is not where the plan has it; a return would come too near to the ground",
            refuses=True,
        )


def _battery(facts: Facts, needs: Needs) -> Iterable[Finding]:
    if needs.battery_for_plan is not None and facts.battery is not None and facts.battery < needs.battery_for_plan:
        yield blocker(
            name="battery for the plan",
            found=f"{facts.battery:.0%}",
            should=f"at least {ceil(needs.battery_for_plan * 100)}%",
            why="it would not come home from this plan with its reserve",
            refuses=True,
        )
    if not facts.battery_told:
        yield warning("battery", "not reported", "reported once a second", "it is not known how long it can fly")
    elif facts.battery is None:
        yield warning("battery", "not measured", "measured", "it could run empty unnoticed")
    elif facts.battery < needs.battery_at_least:
        yield blocker("battery", f"{facts.battery:.0%}", f"at least {needs.battery_at_least:.0%}", "too little to fly")
    elif facts.battery < _COMFORTABLE:
        yield warning("battery", f"{facts.battery:.0%}", f"{_COMFORTABLE:.0%} or more", "little to spare")


def _speed(facts: Facts, needs: Needs) -> Iterable[Finding]:
    """Yield what is wrong with the plan's max_speed_mps: whether it flies that fast, and gets there inside a slot."""
    wanted, model = needs.max_speed_mps, facts.model
    if wanted > model.max_speed_mps:
        yield blocker(
            "max_speed_mps",
            f"{wanted:g} m/s planned",
            f"at most {model.max_speed_mps:g} m/s, or a faster {_speed_names(facts)}",
            "it cannot fly as fast as the plan lets it",
        )
        return
    seconds = wanted / mean_acceleration(wanted, model.acceleration_mps2, model.jerk_mps3)
    if seconds > needs.slot_s:
        reach_m = wanted * needs.slot_s * needs.slot_s / seconds / 2
        yield blocker(
            "max_speed_mps",
            f"{wanted:g} m/s takes {seconds:.1f} s to reach",
            f"reached inside a slot of {needs.slot_s:g} s",
            f"from rest it flies {reach_m:.0f} m in a slot, the plan counts on up to {wanted * needs.slot_s:.0f} m",
        )
    elif seconds > needs.slot_s / 2:
        yield warning(
            "max_speed_mps",
            f"{wanted:g} m/s takes {seconds:.1f} s to reach",
            f"less than half of a slot of {needs.slot_s:g} s: {_agility(facts, needs)}",
            "legs from rest will be late; a lower max_speed_mps keeps the schedule too",
        )


def _first_leg(facts: Facts, needs: Needs) -> Iterable[Finding]:
    """Yield a warning if its first leg from rest ends far behind, by its speed, acceleration and jerk."""
    missed = first_leg_miss(needs.path_m, needs.slot_s, facts.model)
    if missed is not None and missed.miss_m > _FIRST_LEG_M:
        yield warning(
            "speed not reachable",
            f"{missed.miss_m:.1f} m behind when slot {missed.slot} begins, after a first leg of {missed.leg_m:.0f} m",
            f"within {_FIRST_LEG_M:g} m: {_agility(facts, needs)}",
            "it starts from rest, and its acceleration has to build up; it catches up in the slots after that",
        )


def _speed_names(facts: Facts) -> str:
    return "/".join(profile_of(facts.autopilot).speed_parameters)


def _agility(facts: Facts, needs: Needs) -> str:
    """Return which parameter would let it reach its speed in half a slot."""
    return profile_of(facts.autopilot).agility(needs)


def _reported(value: float | None) -> str:
    return "not reported" if value is None else f"{value:g}"


def _apart(a: Point, b: Point) -> float:
    return hypot(a[0] - b[0], a[1] - b[1]) if a != b else 0.0
