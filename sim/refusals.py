"""Why an autopilot does not arm or change its mode, in its own words (see `sim.hosts.Refusal`).

Both let the mode be changed to anything while they are disarmed; they check it when they are armed.
"""

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.boot import Boot
from skyfolio.sim.hosts import Equipment, Refusal, VehicleState
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator

_CRITICAL, _WARNING = dialect.MAV_SEVERITY_CRITICAL, dialect.MAV_SEVERITY_WARNING
_NOT_ARMABLE = (Mode.RTL, Mode.LAND, Mode.BRAKE)


class RefusalHost(VehicleState, Equipment, Protocol):
    """The vehicle that is to arm or to change its mode."""

    navigator: Navigator
    boot_plan: Boot


class ArmingRefusal(Protocol):
    """Returns why a vehicle does not arm; `force`: skip the checks that can be skipped; `tag`: how its texts begin."""

    def __call__(self, host: RefusalHost, *, force: bool = False, tag: str = "Arm") -> Refusal:
        """Return why `host` does not arm."""


def px4_mode_refusal(host: RefusalHost, mode: Mode) -> Refusal:
    """Return why a PX4 does not change to `mode`."""
    name = host.traits.mode_names.get(mode)
    if name is None:
        return (("Unsupported main mode\t", _CRITICAL),)
    if not host.armed or _px4_can_run(host, mode):
        return ()
    return ((f"Switching to {name} is currently not available\t", _CRITICAL),)


def px4_arming_refusal(host: RefusalHost, *, force: bool = False, tag: str = "Arm") -> Refusal:
    """Return why a PX4 does not arm; an order from outside is checked even if it is forced."""
    del force, tag
    works = host.boot_plan.ready and host.dynamics.powered and not host.dynamics.crashed
    if works and _px4_can_run(host, host.mode):
        return ()
    return (("Arming denied: Resolve system health failures first\t", _CRITICAL),)


def _px4_can_run(host: RefusalHost, mode: Mode) -> bool:
    if mode.needs_position and not host.satellites:
        return False
    if mode is Mode.MISSION:
        first = next((item for item in host.runner.mission.items if item.is_nav and item.has_place), None)
        place = host.home_m if first is None else host.frame.to_local(first.x / 1e7, first.y / 1e7)
        near = math.dist(place, host.home_m) <= host.parameters.tuning.first_waypoint_m
        return bool(host.runner.mission.items) and near
    return mode is not Mode.GUIDED or host.navigator.setpoint is not None


def ardupilot_mode_refusal(host: RefusalHost, mode: Mode) -> Refusal:
    """Return why an ArduCopter does not change to `mode`."""
    name = host.traits.mode_names.get(mode)
    if name is None:
        return (("No such mode", _WARNING),)
    if not host.armed:
        return ()
    if mode.needs_position and not host.satellites:
        return ((f"Mode change to {name} failed: requires position", _WARNING),)
    reason = host.runner.can_start(on_ground=host.body.on_ground) if mode is Mode.MISSION else None
    if reason is None:
        return ()
    failed = (f"Mode change to {name} failed: init failed", _WARNING)
    return ((reason, _CRITICAL), failed) if reason else (failed,)


def ardupilot_arming_refusal(host: RefusalHost, *, force: bool = False, tag: str = "Arm") -> Refusal:
    """Return why an ArduCopter does not arm; `force` skips all checks but the mandatory ones."""
    words = _mandatory(host) or (None if force else _not_armable(host))
    return ((f"{tag}: {words}", _CRITICAL),) if words else ()


def _mandatory(host: RefusalHost) -> str | None:
    if host.dynamics.crashed or not host.dynamics.powered:
        return "Leaning"
    if host.satellites:
        return None
    if host.mode.needs_position:
        return "Need Position Estimate"
    return "Fence enabled, need position estimate" if host.parameters.tuning.fence.needs_position else None


def _not_armable(host: RefusalHost) -> str | None:
    if host.mode in _NOT_ARMABLE:
        return "Mode not armable"
    if host.mode is not Mode.MISSION:
        return None
    if not host.parameters.tuning.arm_in_mission:
        return "Mode not armable"
    reason = host.runner.can_start(on_ground=host.body.on_ground)
    return None if reason is None else reason or "Missing Takeoff Cmd"
