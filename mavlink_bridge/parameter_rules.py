"""Rules about parameters of each autopilot, under any of the names that its versions give them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import dist

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.findings import Facts, Finding, Level, Needs, warning
from skyfolio.mavlink_bridge.mission_messages import GROUND

Check = Callable[[float, Facts, Needs], list[Finding]]


@dataclass(frozen=True)
class Rule:
    """One rule about one parameter, under any of its names."""

    names: tuple[str, ...]
    check: Check = field(repr=False)


def _one_of(names: tuple[str, ...], good: set[int], level: Level, should: str, why: str) -> Rule:
    """The parameter must be one of these values."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts, needs
        if int(value) in good:
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=should, why=why)]

    return Rule(names, check)


def _at_least(names: tuple[str, ...], least: Callable[[Needs], float], level: Level, why: str) -> Rule:
    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts
        if value >= least(needs):
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=f"at least {least(needs):g}", why=why)]

    return Rule(names, check)


def _at_most(names: tuple[str, ...], most: float, level: Level, why: str) -> Rule:
    """Only for setpoint streams: how long the vehicle goes on without one."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        del facts
        if value <= most or not needs.stream:
            return []
        return [Finding(level=level, name=names[0], found=f"{value:g}", should=f"at most {most:g}", why=why)]

    return Rule(names, check)


def _limit(
    names: tuple[str, ...], needed: Callable[[Facts, Needs], float], unit: float, why: str, *, enabled: str | None
) -> Rule:
    """A limit of the vehicle's own (0: none) that the plan must stay inside of, in `unit` metres."""

    def check(value: float, facts: Facts, needs: Needs) -> list[Finding]:
        off = enabled is not None and facts.parameters.get(enabled, 0) == 0
        if value <= 0 or off or value * unit >= needed(facts, needs):
            return []
        should = f"0 (off) or at least {needed(facts, needs) / unit:.0f}"
        return [Finding(level=Level.BLOCKER, name=names[0], found=f"{value:g}", should=should, why=why)]

    return Rule(names, check)


def _continues_in_auto(value: float, facts: Facts, needs: Needs) -> list[Finding]:
    acts = facts.parameters.get("FS_GCS_ENABLE", 0) != 0
    if not acts or int(value) & 2 or needs.stream:
        return []
    why = "else the loss of our link ends its mission, which is on board to survive exactly that"
    return [warning("FS_OPTIONS", f"{value:g}", f"{int(value) | 2} (bit 1: continue in AUTO)", why)]


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
    return max(dist(point, home) for point in needs.path_m)


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
    Rule(("COM_OBL_RC_ACT",), _holds_without_setpoints),
    _at_most(("COM_OF_LOSS_T",), 2.0, _W, "it flies on blindly for this long after the last setpoint"),
    _limit(("GF_MAX_HOR_DIST",), _farthest_m, 1.0, _BREACH, enabled="GF_ACTION"),
    _limit(("GF_MAX_VER_DIST",), _altitude_m, 1.0, _BREACH, enabled="GF_ACTION"),
    _limit(("MIS_DIST_1WP",), lambda f, n: dist(f.home_m or n.path_m[0], n.path_m[0]), 1.0,
           "the first waypoint is further from home: the mission is refused", enabled=None),
]  # fmt: skip

_ARDUPILOT_RULES = [
    _one_of(
        ("SYSID_MYGCS", "MAV_GCS_SYSID"), {GROUND[0]}, _W, f"{GROUND[0]} (us)",
        "its ground station failsafe watches somebody else's heartbeat, not ours",
    ),
    _one_of(("FS_GCS_ENABLE",), {1, 2, 3, 4, 5, 6}, _W, "1 (return)", "it would not notice that we are gone"),
    _at_least(("FS_GCS_TIMEOUT",), lambda needs: min(needs.lost_after_s, 5.0), _W, "it gives up the link before we do"),
    Rule(("FS_OPTIONS",), _continues_in_auto),
    _one_of(("MIS_RESTART",), {0}, _B, "0", "after every hold its mission would begin again"),
    _one_of(("BATT_FS_LOW_ACT",), {1, 2, 3, 4}, _W, "2 (return)", "an empty battery would only be announced"),
    _one_of(("FENCE_ENABLE",), {1}, _W, "1", "the uploaded geofence would not be kept"),
    _limit(("FENCE_RADIUS",), _farthest_m, 1.0, _BREACH, enabled="FENCE_ENABLE"),
    _limit(("FENCE_ALT_MAX",), _altitude_m, 1.0, _BREACH, enabled="FENCE_ENABLE"),
    _at_most(("GUID_TIMEOUT",), 3.0, _W, "it flies on blindly for this long after the last setpoint"),
]  # fmt: skip

RULES = {Autopilot.PX4: _PX4_RULES, Autopilot.ARDUPILOT: _ARDUPILOT_RULES}
