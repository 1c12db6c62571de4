"""Why an autopilot does not arm or change its mode, in its own words: (text, MAV_SEVERITY) pairs, none if it does.

Both let the mode be changed to anything while they are disarmed; the check comes with arming.
"""

import math
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.modes import Mode

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

Refusal = tuple[tuple[str, int], ...]
_CRITICAL, _WARNING = dialect.MAV_SEVERITY_CRITICAL, dialect.MAV_SEVERITY_WARNING
_NOT_ARMABLE = (Mode.RTL, Mode.LAND, Mode.BRAKE)


def px4_mode_refusal(autopilot: "Autopilot", mode: Mode) -> Refusal:
    """Return why a PX4 does not change to `mode`."""
    name = autopilot.flavour.mode_names.get(mode)
    if name is None:
        return (("Unsupported main mode\t", _CRITICAL),)
    if not autopilot.armed or _px4_can_run(autopilot, mode):
        return ()
    return ((f"Switching to {name} is currently not available\t", _CRITICAL),)


def px4_arming_refusal(autopilot: "Autopilot", *, force: bool = False, tag: str = "Arm") -> Refusal:
    """Return why a PX4 does not arm; what comes from outside is checked even if it is forced."""
    del force, tag
    works = autopilot.boot_plan.ready and autopilot.dynamics.powered and not autopilot.crashed
    if works and _px4_can_run(autopilot, autopilot.mode):
        return ()
    return (("Arming denied: Resolve system health failures first\t", _CRITICAL),)


def _px4_can_run(autopilot: "Autopilot", mode: Mode) -> bool:
    if mode.needs_position and not autopilot.satellites:
        return False
    if mode is Mode.MISSION:
        first = next((item for item in autopilot.runner.mission.items if item.is_nav and item.has_place), None)
        place = autopilot.home_m if first is None else autopilot.frame.to_local(first.x / 1e7, first.y / 1e7)
        near = math.dist(place, autopilot.home_m) <= autopilot.parameters.tuning.first_waypoint_m
        return bool(autopilot.runner.mission.items) and near
    return mode is not Mode.GUIDED or autopilot.navigator.setpoint is not None


def ardupilot_mode_refusal(autopilot: "Autopilot", mode: Mode) -> Refusal:
    """Return why an ArduCopter does not change to `mode`."""
    name = autopilot.flavour.mode_names.get(mode)
    if name is None:
        return (("No such mode", _WARNING),)
    if not autopilot.armed:
        return ()
    if mode.needs_position and not autopilot.satellites:
        return ((f"Mode change to {name} failed: requires position", _WARNING),)
    reason = autopilot.runner.can_start(on_ground=autopilot.body.on_ground) if mode is Mode.MISSION else None
    if reason is None:
        return ()
    failed = (f"Mode change to {name} failed: init failed", _WARNING)
    return ((reason, _CRITICAL), failed) if reason else (failed,)


def ardupilot_arming_refusal(autopilot: "Autopilot", *, force: bool = False, tag: str = "Arm") -> Refusal:
    """Return why an ArduCopter does not arm; a force skips all but what is mandatory."""
    words = _mandatory(autopilot) or (None if force else _not_armable(autopilot))
    return ((f"{tag}: {words}", _CRITICAL),) if words else ()


def _mandatory(autopilot: "Autopilot") -> str | None:
    if autopilot.crashed or not autopilot.dynamics.powered:
        return "Leaning"
    if autopilot.satellites:
        return None
    if autopilot.mode.needs_position:
        return "Need Position Estimate"
    return "Fence enabled, need position estimate" if autopilot.parameters.tuning.fence.needs_position else None


def _not_armable(autopilot: "Autopilot") -> str | None:
    if autopilot.mode in _NOT_ARMABLE:
        return "Mode not armable"
    if autopilot.mode is not Mode.MISSION:
        return None
    if not autopilot.parameters.tuning.arm_in_mission:
        return "Mode not armable"
    reason = autopilot.runner.can_start(on_ground=autopilot.body.on_ground)
    return None if reason is None else reason or "Missing Takeoff Cmd"
