"""How each telemetry message is filled from the vehicle's state."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.airframe import CELLS
from skyfolio.sim.mission_state import MISSION_MODES
from skyfolio.sim.modes import Mode
from skyfolio.sim.tuning import Action
from skyfolio.sim.wire import Extended, Message

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

EPOCH_S = 1_767_225_600 + 12 * 3600
"""Unix time at fleet time 0: 2026-01-01, noon UTC."""
_PROPULSION = dialect.MAV_SYS_STATUS_SENSOR_PROPULSION
_NO_BYTES = bytes(8)


def boot_ms(autopilot: "Autopilot") -> int:
    """Return the autopilot's milliseconds since boot; a clock jump can take them below zero, where they wrap."""
    return int((autopilot.now_s - autopilot.boot_s + autopilot.clock_offset_s) * 1000.0) & 0xFFFFFFFF


def _place(autopilot: "Autopilot") -> tuple[int, int, int, int]:
    """Return latitude and longitude (1e-7 deg), altitude above sea level and above home (mm); zeros before it knows."""
    if not autopilot.boot_plan.has_home:
        return 0, 0, 0, 0
    body = autopilot.seen
    lat, lon = autopilot.frame.to_geodetic(body.east_m, body.north_m)
    up_mm = round(body.up_m * 1000.0)
    return round(lat * 1e7), round(lon * 1e7), round(autopilot.spec.home_alt_m * 1000.0) + up_mm, up_mm


def _heading_deg(autopilot: "Autopilot") -> float:
    return math.degrees(autopilot.body.yaw_rad) % 360.0


def _state(autopilot: "Autopilot") -> int:
    """Return MAV_STATE: ArduPilot's is standby as long as it stands, PX4's uninitialised while it cannot be armed."""
    if autopilot.failsafes.active:
        return int(dialect.MAV_STATE_CRITICAL)
    if autopilot.flavour.mav_autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return int(dialect.MAV_STATE_STANDBY if autopilot.landed else dialect.MAV_STATE_ACTIVE)
    if autopilot.armed:
        return int(dialect.MAV_STATE_ACTIVE)
    return int(dialect.MAV_STATE_UNINIT if autopilot.flavour.arming_refusal(autopilot) else dialect.MAV_STATE_STANDBY)


def _heartbeat(autopilot: "Autopilot") -> Message:
    message: Message = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        autopilot.flavour.mav_autopilot,
        autopilot.flavour.base_mode(autopilot.mode, armed=autopilot.armed, blind=autopilot.failsafes.position_lost),
        autopilot.flavour.custom_modes[autopilot.mode],
        _state(autopilot),
        3,
    )
    return message


def _global_position(autopilot: "Autopilot") -> Message | None:
    """Return the position; before there is one PX4 sends none, and ArduPilot zeros."""
    if not autopilot.boot_plan.has_home and autopilot.flavour.restores_mode:
        return None
    body = autopilot.seen
    velocity = (round(body.north_mps * 100), round(body.east_mps * 100), round(-body.up_mps * 100))
    heading = round(_heading_deg(autopilot) * 100) % 36000
    message: Message = dialect.MAVLink_global_position_int_message(
        boot_ms(autopilot), *_place(autopilot), *velocity, heading
    )
    return message


def _local_position(autopilot: "Autopilot") -> Message:
    body = autopilot.seen
    place = (body.north_m, body.east_m, -body.up_m)
    message: Message = dialect.MAVLink_local_position_ned_message(
        boot_ms(autopilot), *place, body.north_mps, body.east_mps, -body.up_mps
    )
    return message


def _gps(autopilot: "Autopilot") -> Message:
    body = autopilot.body
    course = math.degrees(math.atan2(body.east_mps, body.north_mps)) % 360.0
    looks = autopilot.flavour.looks
    fix, satellites, eph, epv = looks.gps if autopilot.dynamics.satellites else looks.no_gps
    if not autopilot.boot_plan.has_fix:
        fix, satellites, eph, epv = dialect.GPS_FIX_TYPE_NO_GPS, 0, 0xFFFF, 0xFFFF
    speed_and_course = (round(body.ground_speed_mps * 100), round(course * 100) % 36000)
    message: Message = dialect.MAVLink_gps_raw_int_message(
        boot_ms(autopilot) * 1000, fix, *_place(autopilot)[:3], eph, epv, *speed_and_course, satellites
    )
    return message


def _mission_mode(autopilot: "Autopilot") -> int:
    """Return MISSION_CURRENT.mission_mode: PX4 counts its take-off and landing as active and says suspended else."""
    if not autopilot.flavour.mission_ids:
        return 1 if autopilot.mode is Mode.MISSION else 0
    return 1 if autopilot.mode in MISSION_MODES else 2


def mission_current(autopilot: "Autopilot", seq: int | None = None) -> Message:
    """Return the MISSION_CURRENT of what is flown, or of item `seq`."""
    runner = autopilot.runner
    state = runner.state(autopilot.mode, armed=autopilot.armed).value
    told = min(runner.told_index if seq is None else seq, 0xFFFF)
    base = dialect.MAVLink_mission_current_message(told, runner.told_total, state, _mission_mode(autopilot))
    if not autopilot.flavour.mission_ids:
        message: Message = base
        return message
    plan = autopilot.missions.plan
    fence, rally = plan(dialect.MAV_MISSION_TYPE_FENCE), plan(dialect.MAV_MISSION_TYPE_RALLY)
    ids = {"fence_id": fence.mission_id, "rally_points_id": rally.mission_id}
    return Extended(base, mission_id=runner.mission.mission_id, **ids)


def _extended_state(autopilot: "Autopilot") -> Message:
    """Return the landed state; a PX4 that descends without a position is in the air, not landing."""
    if autopilot.landed:
        state = dialect.MAV_LANDED_STATE_ON_GROUND
    elif autopilot.dynamics.landing and (autopilot.satellites or not autopilot.flavour.restores_mode):
        state = dialect.MAV_LANDED_STATE_LANDING
    elif autopilot.navigator.taking_off:
        state = dialect.MAV_LANDED_STATE_TAKEOFF
    else:
        state = dialect.MAV_LANDED_STATE_IN_AIR
    message: Message = dialect.MAVLink_extended_sys_state_message(autopilot.flavour.looks.vtol_state, state)
    return message


def _sensors(autopilot: "Autopilot") -> tuple[int, int, int]:
    """Return SYS_STATUS's sensors that are present, enabled and healthy, as each autopilot has them."""
    looks, tuning = autopilot.flavour.looks, autopilot.parameters.tuning
    is_px4 = autopilot.flavour.restores_mode
    present, enabled, healthy = looks.present, looks.enabled, looks.healthy
    if not autopilot.armed:
        enabled &= ~looks.logging
    if autopilot.mode is Mode.STABILIZE:
        enabled, healthy = enabled & ~looks.moving, healthy & ~looks.moving
    if not is_px4 and tuning.fence.action is Action.NONE:
        enabled &= ~dialect.MAV_SYS_STATUS_GEOFENCE
    if not autopilot.dynamics.satellites or not autopilot.boot_plan.has_fix:
        healthy &= ~(dialect.MAV_SYS_STATUS_SENSOR_GPS | dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL)
        if is_px4:
            present &= ~dialect.MAV_SYS_STATUS_SENSOR_GPS
    if any(autopilot.battery.share < level.share for level in tuning.batteries):
        healthy &= ~dialect.MAV_SYS_STATUS_SENSOR_BATTERY
    if not autopilot.dynamics.powered:
        healthy &= ~_PROPULSION
    if is_px4 and not autopilot.armed and autopilot.flavour.arming_refusal(autopilot):
        healthy &= ~dialect.MAV_SYS_STATUS_PREARM_CHECK
    return present, enabled, healthy


def _sys_status(autopilot: "Autopilot") -> Message:
    present, enabled, healthy = _sensors(autopilot)
    battery = autopilot.battery
    power = (round(battery.voltage_v * 1000.0), round(battery.current_a * 100.0), round(battery.share * 100.0))
    message: Message = dialect.MAVLink_sys_status_message(present, enabled, healthy, 250, *power, 0, 0, 0, 0, 0, 0)
    return message


def _battery_status(autopilot: "Autopilot") -> Message:
    battery = autopilot.battery
    used_mah = round((1.0 - battery.share) * autopilot.parameters.tuning.battery_capacity_mah)
    message: Message = dialect.MAVLink_battery_status_message(
        0,
        dialect.MAV_BATTERY_FUNCTION_ALL,
        dialect.MAV_BATTERY_TYPE_LIPO,
        0x7FFF,
        [round(battery.voltage_v / CELLS * 1000.0)] * CELLS + [0xFFFF] * (10 - CELLS),
        round(battery.current_a * 100.0),
        used_mah,
        -1,
        round(battery.share * 100.0),
    )
    return message


def _system_time(autopilot: "Autopilot") -> Message:
    unix_s = EPOCH_S + autopilot.now_s + autopilot.clock_offset_s
    message: Message = dialect.MAVLink_system_time_message(round(unix_s * 1e6) % 2**64, boot_ms(autopilot))
    return message


def _attitude(autopilot: "Autopilot") -> Message:
    yaw = autopilot.body.yaw_rad
    message: Message = dialect.MAVLink_attitude_message(boot_ms(autopilot), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)
    return message


def _attitude_quaternion(autopilot: "Autopilot") -> Message:
    half = autopilot.body.yaw_rad / 2.0
    message: Message = dialect.MAVLink_attitude_quaternion_message(
        boot_ms(autopilot), math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0
    )
    return message


def _hud(autopilot: "Autopilot") -> Message:
    body = autopilot.body
    speed = body.ground_speed_mps
    message: Message = dialect.MAVLink_vfr_hud_message(
        speed,
        speed,
        int(_heading_deg(autopilot)),
        50 if autopilot.armed else 0,
        autopilot.spec.home_alt_m + body.up_m,
        body.up_mps,
    )
    return message


def _home(autopilot: "Autopilot") -> Message | None:
    if not autopilot.boot_plan.has_home:
        return None
    east_m, north_m = autopilot.home_m
    lat, lon = autopilot.frame.to_geodetic(east_m, north_m)
    message: Message = dialect.MAVLink_home_position_message(
        round(lat * 1e7),
        round(lon * 1e7),
        round(autopilot.spec.home_alt_m * 1000.0),
        north_m,
        east_m,
        0.0,
        [1.0, 0.0, 0.0, 0.0],
        0.0,
        0.0,
        0.0,
        boot_ms(autopilot) * 1000,
    )
    return message


def _version(autopilot: "Autopilot") -> Message:
    message: Message = dialect.MAVLink_autopilot_version_message(
        autopilot.flavour.capabilities,
        autopilot.flavour.firmware,
        0,
        0,
        0,
        _NO_BYTES,
        _NO_BYTES,
        _NO_BYTES,
        0,
        0,
        0x5B1F0000 + autopilot.spec.system_id,
    )
    return message


BUILDERS: dict[int, Callable[["Autopilot"], Message | None]] = {
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
