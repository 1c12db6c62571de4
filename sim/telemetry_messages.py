"""The telemetry messages (MAVLink common), filled from the vehicle's state."""

import math
from collections.abc import Callable
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.airframe import CELLS
from skyfolio.sim.boot import Boot
from skyfolio.sim.failsafes import Failsafes
from skyfolio.sim.hosts import Equipment, Refusal, VehicleState
from skyfolio.sim.mission_protocol import MissionProtocol
from skyfolio.sim.mission_state import MISSION_MODES
from skyfolio.sim.modes import Mode
from skyfolio.sim.navigator import Navigator
from skyfolio.sim.tuning import Action
from skyfolio.sim.wire import Extended, Message

_PROPULSION = dialect.MAV_SYS_STATUS_SENSOR_PROPULSION
_NO_BYTES = bytes(8)


class MessageHost(VehicleState, Equipment, Protocol):
    """The vehicle that the messages describe."""

    boot_plan: Boot
    failsafes: Failsafes
    missions: MissionProtocol
    navigator: Navigator

    def arming_refusal(self) -> Refusal:
        """Return why the vehicle cannot be armed."""


def _place(host: MessageHost) -> tuple[int, int, int, int]:
    """Return latitude, longitude (1e-7 deg), altitude above sea level and above home (mm); zeros until home is set."""
    if not host.boot_plan.has_home:
        return 0, 0, 0, 0
    body = host.seen
    lat, lon = host.frame.to_geodetic(body.east_m, body.north_m)
    up_mm = round(body.up_m * 1000.0)
    return round(lat * 1e7), round(lon * 1e7), round(host.spec.home_alt_m * 1000.0) + up_mm, up_mm


def _heading_deg(host: MessageHost) -> float:
    return math.degrees(host.body.yaw_rad) % 360.0


def _state(host: MessageHost) -> int:
    """Return MAV_STATE: ArduPilot is in standby as long as it stands, PX4 uninitialised while it cannot be armed."""
    if host.failsafes.active:
        return int(dialect.MAV_STATE_CRITICAL)
    if host.traits.mav_autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return int(dialect.MAV_STATE_STANDBY if host.landed else dialect.MAV_STATE_ACTIVE)
    if host.armed:
        return int(dialect.MAV_STATE_ACTIVE)
    return int(dialect.MAV_STATE_UNINIT if host.arming_refusal() else dialect.MAV_STATE_STANDBY)


def _heartbeat(host: MessageHost) -> Message:
    message: Message = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        host.traits.mav_autopilot,
        host.traits.base_mode(host.mode, armed=host.armed, blind=host.failsafes.position_lost),
        host.traits.custom_modes[host.mode],
        _state(host),
        3,
    )
    return message


def _global_position(host: MessageHost) -> Message | None:
    """Return GLOBAL_POSITION_INT; before there is a position PX4 sends none, and ArduPilot sends zeros."""
    if not host.boot_plan.has_home and host.traits.restores_mode:
        return None
    body = host.seen
    velocity = (round(body.north_mps * 100), round(body.east_mps * 100), round(-body.up_mps * 100))
    heading = round(_heading_deg(host) * 100) % 36000
    message: Message = dialect.MAVLink_global_position_int_message(
        host.clock.boot_ms, *_place(host), *velocity, heading
    )
    return message


def _local_position(host: MessageHost) -> Message:
    body = host.seen
    place = (body.north_m, body.east_m, -body.up_m)
    message: Message = dialect.MAVLink_local_position_ned_message(
        host.clock.boot_ms, *place, body.north_mps, body.east_mps, -body.up_mps
    )
    return message


def _gps(host: MessageHost) -> Message:
    body = host.body
    course = math.degrees(math.atan2(body.east_mps, body.north_mps)) % 360.0
    looks = host.traits.looks
    fix, satellites, eph, epv = looks.gps if host.dynamics.satellites else looks.no_gps
    if not host.boot_plan.has_fix:
        fix, satellites, eph, epv = dialect.GPS_FIX_TYPE_NO_GPS, 0, 0xFFFF, 0xFFFF
    speed_and_course = (round(body.ground_speed_mps * 100), round(course * 100) % 36000)
    message: Message = dialect.MAVLink_gps_raw_int_message(
        host.clock.boot_ms * 1000, fix, *_place(host)[:3], eph, epv, *speed_and_course, satellites
    )
    return message


def _mission_mode(host: MessageHost) -> int:
    """Return MISSION_CURRENT.mission_mode: 1 (active) or 2 (suspended) on PX4, 1 or 0 on ArduPilot."""
    if not host.traits.mission_ids:
        return 1 if host.mode is Mode.MISSION else 0
    return 1 if host.mode in MISSION_MODES else 2


def mission_current(host: MessageHost, seq: int | None = None) -> Message:
    """Return a MISSION_CURRENT that names the item being flown, or item `seq`."""
    runner = host.runner
    state = runner.state(host.mode, armed=host.armed).value
    index = min(runner.reported_index if seq is None else seq, 0xFFFF)
    base = dialect.MAVLink_mission_current_message(index, runner.reported_total, state, _mission_mode(host))
    if not host.traits.mission_ids:
        message: Message = base
        return message
    plan = host.missions.plan
    fence, rally = plan(dialect.MAV_MISSION_TYPE_FENCE), plan(dialect.MAV_MISSION_TYPE_RALLY)
    ids = {"fence_id": fence.mission_id, "rally_points_id": rally.mission_id}
    return Extended(base, mission_id=runner.mission.mission_id, **ids)


def _extended_state(host: MessageHost) -> Message:
    """Return EXTENDED_SYS_STATE; a PX4 that descends without a position is in the air, not landing."""
    if host.landed:
        state = dialect.MAV_LANDED_STATE_ON_GROUND
    elif host.dynamics.landing and (host.satellites or not host.traits.restores_mode):
        state = dialect.MAV_LANDED_STATE_LANDING
    elif host.navigator.taking_off:
        state = dialect.MAV_LANDED_STATE_TAKEOFF
    else:
        state = dialect.MAV_LANDED_STATE_IN_AIR
    message: Message = dialect.MAVLink_extended_sys_state_message(host.traits.looks.vtol_state, state)
    return message


def _sensors(host: MessageHost) -> tuple[int, int, int]:
    """Return SYS_STATUS's sensors that are present, enabled and healthy (bit masks), as each autopilot sets them."""
    looks, tuning = host.traits.looks, host.parameters.tuning
    is_px4 = host.traits.restores_mode
    present, enabled, healthy = looks.present, looks.enabled, looks.healthy
    if not host.armed:
        enabled &= ~looks.logging
    if host.mode is Mode.STABILIZE:
        enabled, healthy = enabled & ~looks.moving, healthy & ~looks.moving
    if not is_px4 and tuning.fence.action is Action.NONE:
        enabled &= ~dialect.MAV_SYS_STATUS_GEOFENCE
    if not host.dynamics.satellites or not host.boot_plan.has_fix:
        healthy &= ~(dialect.MAV_SYS_STATUS_SENSOR_GPS | dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL)
        if is_px4:
            present &= ~dialect.MAV_SYS_STATUS_SENSOR_GPS
    charge = host.gauge.share
    if any(charge < level.share for level in tuning.batteries):
        healthy &= ~dialect.MAV_SYS_STATUS_SENSOR_BATTERY
    if not host.dynamics.powered:
        healthy &= ~_PROPULSION
    if is_px4 and not host.armed and host.arming_refusal():
        healthy &= ~dialect.MAV_SYS_STATUS_PREARM_CHECK
    return present, enabled, healthy


def _sys_status(host: MessageHost) -> Message:
    present, enabled, healthy = _sensors(host)
    battery = host.battery
    power = (round(battery.voltage_v * 1000.0), round(battery.current_a * 100.0), round(host.gauge.share * 100.0))
    message: Message = dialect.MAVLink_sys_status_message(present, enabled, healthy, 250, *power, 0, 0, 0, 0, 0, 0)
    return message


def _battery_status(host: MessageHost) -> Message:
    battery = host.battery
    used_mah = round(host.gauge.used * host.parameters.tuning.battery_capacity_mah)
    message: Message = dialect.MAVLink_battery_status_message(
        0,
        dialect.MAV_BATTERY_FUNCTION_ALL,
        dialect.MAV_BATTERY_TYPE_LIPO,
        0x7FFF,
        [round(battery.voltage_v / CELLS * 1000.0)] * CELLS + [0xFFFF] * (10 - CELLS),
        round(battery.current_a * 100.0),
        used_mah,
        -1,
        round(host.gauge.share * 100.0),
    )
    return message


def _system_time(host: MessageHost) -> Message:
    message: Message = dialect.MAVLink_system_time_message(round(host.clock.unix_s * 1e6) % 2**64, host.clock.boot_ms)
    return message


def _attitude(host: MessageHost) -> Message:
    yaw = host.body.yaw_rad
    message: Message = dialect.MAVLink_attitude_message(host.clock.boot_ms, 0.0, 0.0, yaw, 0.0, 0.0, 0.0)
    return message


def _attitude_quaternion(host: MessageHost) -> Message:
    half = host.body.yaw_rad / 2.0
    message: Message = dialect.MAVLink_attitude_quaternion_message(
        host.clock.boot_ms, math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0
    )
    return message


def _hud(host: MessageHost) -> Message:
    body = host.body
    speed = body.ground_speed_mps
    message: Message = dialect.MAVLink_vfr_hud_message(
        speed,
        speed,
        int(_heading_deg(host)),
        50 if host.armed else 0,
        host.spec.home_alt_m + body.up_m,
        body.up_mps,
    )
    return message


def _home(host: MessageHost) -> Message | None:
    if not host.boot_plan.has_home:
        return None
    east_m, north_m = host.home_m
    lat, lon = host.frame.to_geodetic(east_m, north_m)
    message: Message = dialect.MAVLink_home_position_message(
        round(lat * 1e7),
        round(lon * 1e7),
        round(host.spec.home_alt_m * 1000.0),
        north_m,
        east_m,
        0.0,
        [1.0, 0.0, 0.0, 0.0],
        0.0,
        0.0,
        0.0,
        host.clock.boot_ms * 1000,
    )
    return message


def _version(host: MessageHost) -> Message:
    message: Message = dialect.MAVLink_autopilot_version_message(
        host.traits.capabilities,
        host.traits.firmware,
        0,
        0,
        0,
        _NO_BYTES,
        _NO_BYTES,
        _NO_BYTES,
        0,
        0,
        0x5B1F0000 + host.spec.system_id,
    )
    return message


BUILDERS: dict[int, Callable[[MessageHost], Message | None]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    dialect.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_state,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    dialect.MAVLINK_MSG_ID_VFR_HUD: _hud,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home,
    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
}
