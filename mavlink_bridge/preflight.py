"""The preflight audit: is this vehicle fit to fly this plan under our timers? Pure: facts in, findings out.

Each finding names a parameter (or a measurement), what was found, what it should be, and why. A `blocker` means that
the flight would go wrong; a `warning`, that something it relies on is missing or unusual. Rules for parameters a
vehicle did not tell are left out: names differ between versions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import hypot

from mavlink_bridge.autopilots import Autopilot
from mavlink_bridge.mission_messages import GROUND
from mavlink_bridge.models import MODEL_PARAMETERS
from mavlink_bridge.pace import Point, VehicleModel, mean_acceleration
from mavlink_bridge.reach import first_leg_miss
from mavlink_bridge.telemetry import FIX_3D

START_WITHIN_M = 15.0
"""A UAV that stands further from its first point flies through air in which the plan has others."""


class Level(StrEnum):
    """How grave a finding is."""

    BLOCKER = "blocker"
    WARNING = "warning"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One row of the audit. `name`: parameter or measurement; `found` and `should` as text with units.

    refuses: a blocker that keeps it on the ground even where blockers are only reported.
    """

    level: Level
    name: str
    found: str
    should: str
    why: str
    refuses: bool = False


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What a vehicle said. Positions in metres east/north of the origin; None: not told.

    gps_fix: GPS_FIX_TYPE (3 is a 3D fix). battery: share of charge, 0..1, of which nothing is known unless
    `battery_told`. mav_type: MAV_TYPE of its HEARTBEAT. model: from its own parameters.
    """

    autopilot: Autopilot
    parameters: Mapping[str, float]
    model: VehicleModel
    at_m: Point | None = None
    home_m: Point | None = None
    gps_fix: int | None = None
    satellites: int | None = None
    battery: float | None = None
    battery_told: bool = True
    mav_type: int | None = None


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What the operation needs of this vehicle.

    path_m: (n_slots, 2) metres east/north. `stream`: guided by setpoints; force_stream: even a vehicle that would not
    hold when they end. lost_after_s: when we declare a link lost. items: of its mission, of at most max_items it
    stores. start_within_m: further from its first point nobody takes off.
    """

    path_m: list[Point]
    slot_s: float
    altitude_m: float
    max_speed_mps: float
    items: int
    max_items: int
    stream: bool = False
    force_stream: bool = False
    start_within_m: float = START_WITHIN_M
    lost_after_s: float = 5.5
    battery_at_least: float = 0.3


def audit(facts: Facts, needs: Needs) -> list[Finding]:
    """All findings, blockers first."""
    found = [*_measurements(facts, needs), *_speed(facts, needs), *_first_leg(facts, needs)]
    for rule in _RULES[facts.autopilot]:
        value = next((facts.parameters[name] for name in rule.names if name in facts.parameters), None)
        if value is not None:
            found += rule.check(value, facts, needs)
    return sorted(found, key=lambda finding: finding.level is not Level.BLOCKER)


def parameter_names(autopilot: Autopilot) -> tuple[str, ...]:
    """Parameters the audit and the vehicle model want to know."""
    ruled = [name for rule in _RULES[autopilot] for name in rule.names]
    return tuple(dict.fromkeys([*ruled, *MODEL_PARAMETERS[autopilot]]))


# -- measurements -----------------------------------------------------------------------------------------------------

_FEW_SATELLITES = 8
_START_TOLERANCE_M = 5.0
_FIRST_LEG_M = 8.0
"""A vehicle further than this from its point when its first leg should end is told of before take-off."""
_COMFORTABLE = 0.6


MULTIROTORS = {
    2: "quadrotor",
    3: "coaxial",
    13: "hexarotor",
    14: "octorotor",
    15: "tricopter",
    29: "dodecarotor",
    35: "decarotor",
}
"""MAV_TYPE of what hovers, flies in any direction and numbers its modes as the bridge reads them."""


def _measurements(facts: Facts, needs: Needs) -> Iterable[Finding]:
    if facts.mav_type is not None and facts.mav_type not in MULTIROTORS:
        why = "it cannot hover in its slots, and its modes mean something else"
        found, should = f"MAV_TYPE {facts.mav_type}", f"a multirotor ({', '.join(map(str, MULTIROTORS))})"
        yield Finding(level=Level.BLOCKER, name="vehicle type", found=found, should=should, why=why, refuses=True)
    if not facts.parameters:
        yield _warning(
            "parameters", "none told", "told when asked", "how it flies and what it does without us is guessed"
        )
    yield from _places(facts, needs)
    yield from _battery(facts, needs)
    if needs.items > needs.max_items:
        yield _blocker("mission", f"{needs.items} items", f"at most {needs.max_items}", "it cannot store them")


def _places(facts: Facts, needs: Needs) -> Iterable[Finding]:
    if facts.gps_fix is None or facts.gps_fix < FIX_3D:
        yield _blocker("GPS fix", _told(facts.gps_fix), "3 (3D fix) or better", "it does not know where it is")
    elif facts.satellites is not None and facts.satellites < _FEW_SATELLITES:
        yield _warning("GPS satellites", str(facts.satellites), f"{_FEW_SATELLITES} or more", "its position may wander")
    if facts.home_m is None:
        yield _blocker("home position", "not set", "set", "altitudes of the mission count from it")
    if facts.at_m is None:
        yield _blocker("position", "none", "a place on the globe", "nobody knows where its mission would begin")
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


def _battery(facts: Facts, needs: Needs) -> Iterable[Finding]:
    if not facts.battery_told:
        yield _warning("battery", "not told", "told once a second", "nobody knows how long it can fly")
    elif facts.battery is None:
        yield _warning("battery", "not measured", "measured", "nobody would notice that it runs empty")
    elif facts.battery < needs.battery_at_least:
        yield _blocker("battery", f"{facts.battery:.0%}", f"at least {needs.battery_at_least:.0%}", "too little to fly")
    elif facts.battery < _COMFORTABLE:
        yield _warning("battery", f"{facts.battery:.0%}", f"{_COMFORTABLE:.0%} or more", "little to spare")


def _speed(facts: Facts, needs: Needs) -> Iterable[Finding]:
    """The plan's max_speed_mps against the vehicle: whether it flies that fast, and gets there inside a slot."""
    wanted, model = needs.max_speed_mps, facts.model
    if wanted > model.max_speed_mps:
        yield _blocker(
            "max_speed_mps",
            f"{wanted:g} m/s planned",
            f"at most {model.max_speed_mps:g} m/s, or a faster {'/'.join(_SPEED_NAMES[facts.autopilot])}",
            "it cannot fly as fast as the plan lets it",
        )
        return
    seconds = wanted / mean_acceleration(wanted, model.acceleration_mps2, model.jerk_mps3)
    if seconds > needs.slot_s:
        reach_m = wanted * needs.slot_s * needs.slot_s / seconds / 2
        yield _blocker(
            "max_speed_mps",
            f"{wanted:g} m/s takes {seconds:.1f} s to reach",
            f"reached inside a slot of {needs.slot_s:g} s",
            f"from rest it flies {reach_m:.0f} m in a slot, the plan counts on up to {wanted * needs.slot_s:.0f} m",
        )
    elif seconds > needs.slot_s / 2:
        yield _warning(
            "max_speed_mps",
            f"{wanted:g} m/s takes {seconds:.1f} s to reach",
            f"less than half of a slot of {needs.slot_s:g} s: {_agility(facts, needs)}",
            "legs from rest will be late; a lower max_speed_mps keeps the schedule too",
        )


def _first_leg(facts: Facts, needs: Needs) -> Iterable[Finding]:
    """Where its first leg from rest gets it, by the speed it will be given and its acceleration and jerk."""
    missed = first_leg_miss(needs.path_m, needs.slot_s, facts.model)
    if missed is not None and missed.miss_m > _FIRST_LEG_M:
        yield _warning(
            "speed not reachable",
            f"{missed.miss_m:.1f} m behind when slot {missed.slot} begins, after a first leg of {missed.leg_m:.0f} m",
            f"within {_FIRST_LEG_M:g} m: {_agility(facts, needs)}",
            "it starts from rest, and its acceleration has to build up; it catches up in the slots after that",
        )


def _agility(facts: Facts, needs: Needs) -> str:
    """Which parameter would let it reach its speed in half a slot."""
    if facts.autopilot is Autopilot.ARDUPILOT:
        return f"WPNAV_JERK (WP_JERK) of at least {4 * needs.max_speed_mps / (needs.slot_s / 2) ** 2:.1f}"
    return f"MPC_ACC_HOR of at least {needs.max_speed_mps / (needs.slot_s / 2):.1f}"


_SPEED_NAMES = {Autopilot.PX4: ("MPC_XY_VEL_MAX",), Autopilot.ARDUPILOT: ("WP_SPD", "WPNAV_SPEED")}

# -- parameters -------------------------------------------------------------------------------------------------------

Check = Callable[[float, Facts, Needs], list[Finding]]


@dataclass(frozen=True)
class _Rule:
    """One rule about one parameter, under any of its names."""

    names: tuple[str, ...]
    check: Check = field(repr=False)


def _one_of(names: tuple[str, ...], good: set[int], level: Level, should: str, why: str) -> _Rule:
    """The parameter must be one of these values."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts, needs
        if int(value) in good:
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=should, why=why)]

    return _Rule(names, check)


def _at_least(names: tuple[str, ...], least: Callable[[Needs], float], level: Level, why: str) -> _Rule:
    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts
        if value >= least(needs):
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=f"at least {least(needs):g}", why=why)]

    return _Rule(names, check)


def _at_most(names: tuple[str, ...], most: float, level: Level, why: str) -> _Rule:
    """Only for setpoint streams: how long the vehicle goes on without one."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts
        if value <= most or not needs.stream:
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=f"at most {most:g}", why=why)]

    return _Rule(names, check)


def _limit(
    names: tuple[str, ...], needed: Callable[[Facts, Needs], float], unit: float, why: str, *, enabled: str | None
) -> _Rule:
    """A limit of the vehicle's own (0: none) that the plan must stay inside of, in `unit` metres."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        off = enabled is not None and facts.parameters.get(enabled, 0) == 0
        if value <= 0 or off or value * unit >= needed(facts, needs):
            return []
        should = f"0 (off) or at least {needed(facts, needs) / unit:.0f}"
        return [Finding(level=Level.BLOCKER, name=names[0], found=f"{value:g}", should=should, why=why)]

    return _Rule(names, check)


def _continues_in_auto(value: float, facts: Facts, needs: Needs) -> list[Finding]:
    acts = facts.parameters.get("FS_GCS_ENABLE", 0) != 0
    if not acts or int(value) & 2 or needs.stream:
        return []
    why = "else the loss of our link ends its mission, which is on board to survive exactly that"
    return [_warning("FS_OPTIONS", f"{value:g}", f"{int(value) | 2} (bit 1: continue in AUTO)", why)]


_HOLDS = 5
"""COM_OBL_RC_ACT since PX4 1.14: 0 to 2 are a pilot's modes (without remote control: return), then 3 return, 4 land."""


def _holds_without_setpoints(value: float, facts: Facts, needs: Needs) -> list[Finding]:
    """PX4 must hold when setpoints end, else it is gone before the guard, or the next service, can act."""
    del facts
    if int(value) == _HOLDS or not needs.stream:
        return []
    return [
        Finding(
            level=Level.WARNING if needs.force_stream else Level.BLOCKER,
            name="COM_OBL_RC_ACT",
            found=f"{value:g}",
            should=f"{_HOLDS} (hold)",
            why="when setpoints end, and be it for a second, it does not hold: without remote control it returns home",
            refuses=not needs.force_stream,
        )
    ]


def _farthest_m(facts: Facts, needs: Needs) -> float:
    home = facts.home_m or needs.path_m[0]
    return max(_apart(point, home) for point in needs.path_m)


def _altitude_m(facts: Facts, needs: Needs) -> float:
    del facts
    return needs.altitude_m


_B, _W = Level.BLOCKER, Level.WARNING
_BREACH = "the plan leaves it: the vehicle's fence would end the mission"

_PX4_RULES = [
    _at_least(("COM_DL_LOSS_T",), lambda needs: needs.lost_after_s, _W, "it gives up the link before we do"),
    _one_of(("NAV_DLL_ACT",), {0, 1, 2, 3}, _B, "0 (none) to 3 (land)", "losing our link would stop its motors"),
    _one_of(("COM_LOW_BAT_ACT",), {2, 3}, _W, "3 (return, then land)", "an empty battery would only be announced"),
    _one_of(("GF_ACTION",), {1, 2, 3, 5}, _W, "2 (hold)", "the uploaded geofence would not be kept"),
    _Rule(("COM_OBL_RC_ACT",), _holds_without_setpoints),
    _at_most(("COM_OF_LOSS_T",), 2.0, _W, "it flies on blindly for this long after the last setpoint"),
    _limit(("GF_MAX_HOR_DIST",), _farthest_m, 1.0, _BREACH, enabled="GF_ACTION"),
    _limit(("GF_MAX_VER_DIST",), _altitude_m, 1.0, _BREACH, enabled="GF_ACTION"),
    _limit(("MIS_DIST_1WP",), lambda f, n: _apart(f.home_m or n.path_m[0], n.path_m[0]), 1.0,
           "the first waypoint is further from home: the mission is refused", enabled=None),
]  # fmt: skip

_ARDUPILOT_RULES = [
    _one_of(
        ("SYSID_MYGCS", "MAV_GCS_SYSID"), {GROUND[0]}, _W, f"{GROUND[0]} (us)",
        "its ground station failsafe watches somebody else's heartbeat, not ours",
    ),
    _one_of(("FS_GCS_ENABLE",), {1, 2, 3, 4, 5, 6}, _W, "1 (return)", "it would not notice that we are gone"),
    _at_least(("FS_GCS_TIMEOUT",), lambda needs: min(needs.lost_after_s, 5.0), _W, "it gives up the link before we do"),
    _Rule(("FS_OPTIONS",), _continues_in_auto),
    _one_of(("MIS_RESTART",), {0}, _B, "0", "after every hold its mission would begin again"),
    _one_of(("BATT_FS_LOW_ACT",), {1, 2, 3, 4}, _W, "2 (return)", "an empty battery would only be announced"),
    _one_of(("FENCE_ENABLE",), {1}, _W, "1", "the uploaded geofence would not be kept"),
    _limit(("FENCE_RADIUS",), _farthest_m, 1.0, _BREACH, enabled="FENCE_ENABLE"),
    _limit(("FENCE_ALT_MAX",), _altitude_m, 1.0, _BREACH, enabled="FENCE_ENABLE"),
    _at_most(("GUID_TIMEOUT",), 3.0, _W, "it flies on blindly for this long after the last setpoint"),
]  # fmt: skip

_RULES = {Autopilot.PX4: _PX4_RULES, Autopilot.ARDUPILOT: _ARDUPILOT_RULES}


def _blocker(name: str, found: str, should: str, why: str) -> Finding:
    return Finding(level=Level.BLOCKER, name=name, found=found, should=should, why=why)


def _warning(name: str, found: str, should: str, why: str) -> Finding:
    return Finding(level=Level.WARNING, name=name, found=found, should=should, why=why)


def _told(value: float | None) -> str:
    return "not told" if value is None else f"{value:g}"


def _apart(a: Point, b: Point) -> float:
    return hypot(a[0] - b[0], a[1] - b[1]) if a != b else 0.0
