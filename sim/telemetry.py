"""What a vehicle tells unasked: streams in fleet time, their rates, and how each message is filled."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.modes import Mode, base_mode
from sim.wire import Extended, Message

if TYPE_CHECKING:
    from sim.autopilot import Autopilot

ENDURANCE_S = 25 * 60.0
"""Time in the air on a full battery."""
FASTEST_INTERVAL_S = 0.02
DEFAULT_RATES_HZ = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE: 1.0,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 1.0,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    dialect.MAVLINK_MSG_ID_VFR_HUD: 1.0,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
}
_ALWAYS_FIRST = dialect.MAVLINK_MSG_ID_HEARTBEAT
_SENSORS = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG
    | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | dialect.MAV_SYS_STATUS_SENSOR_GPS
    | dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    | dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | dialect.MAV_SYS_STATUS_SENSOR_BATTERY
    | dialect.MAV_SYS_STATUS_PREARM_CHECK
)
_CAPABILITIES = (
    dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_FIRMWARE = 1 << 24 | 16 << 16 | 255  # 1.16.0, release
_NO_BYTES = bytes(8)


class Telemetry:
    """The streams of one autopilot, and every message it can be asked for (MAV_CMD_REQUEST_MESSAGE)."""

    def __init__(self, autopilot: "Autopilot", *, start_s: float, phase: float) -> None:
        self._autopilot = autopilot
        self._builders: dict[int, Callable[[Autopilot], Message]] = dict(_BUILDERS)
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        for message_id, rate_hz in DEFAULT_RATES_HZ.items():
            self._interval_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = start_s + (0.0 if message_id == _ALWAYS_FIRST else phase / rate_hz)
        self._next_s = start_s

    def build(self, message_id: int) -> Message | None:
        """Return the message as of now, or None if the vehicle does not know it."""
        builder = self._builders.get(message_id)
        return builder(self._autopilot) if builder else None

    def set_interval(self, message_id: int, interval_s: float) -> bool:
        """Set a stream's interval (0: default, negative: off); False for a message that cannot be streamed."""
        if message_id not in self._builders:
            return False
        default = DEFAULT_RATES_HZ.get(message_id)
        if interval_s < 0.0 or (interval_s == 0.0 and default is None):
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
            return True
        self._interval_s[message_id] = max(interval_s, FASTEST_INTERVAL_S) if interval_s else 1.0 / (default or 1.0)
        self._due_s[message_id] = self._next_s = self._autopilot.now_s
        return True

    def due(self, now_s: float) -> list[Message]:
        """Return the messages whose time has come; a stream that is late sends once, not once for each miss."""
        if now_s < self._next_s:
            return []
        messages = []
        for message_id, due_s in self._due_s.items():
            if due_s <= now_s:
                messages.append(self._builders[message_id](self._autopilot))
                interval_s = self._interval_s[message_id]
                missed = math.floor((now_s - due_s) / interval_s)
                self._due_s[message_id] = due_s + (missed + 1) * interval_s
        self._next_s = min(self._due_s.values(), default=math.inf)
        return messages


def _boot_ms(autopilot: "Autopilot") -> int:
    return int((autopilot.now_s - autopilot.boot_s) * 1000.0) & 0xFFFFFFFF


def _place(autopilot: "Autopilot") -> tuple[int, int, int, int]:
    """Return latitude and longitude (1e-7 deg), altitude above sea level and above home (mm)."""
    lat, lon = autopilot.frame.to_geodetic(autopilot.body.east_m, autopilot.body.north_m)
    up_mm = round(autopilot.body.up_m * 1000.0)
    return round(lat * 1e7), round(lon * 1e7), round(autopilot.spec.home_alt_m * 1000.0) + up_mm, up_mm


def _heading_deg(autopilot: "Autopilot") -> float:
    return math.degrees(autopilot.body.yaw_rad) % 360.0


def _battery(autopilot: "Autopilot") -> tuple[int, int]:
    """Return the remaining charge (%) and the voltage of one of four cells (mV)."""
    share = max(0.0, 1.0 - autopilot.flown_s / ENDURANCE_S)
    return round(share * 100.0), round(3500 + 650 * share)


def _heartbeat(autopilot: "Autopilot") -> Message:
    state = dialect.MAV_STATE_ACTIVE if autopilot.armed else dialect.MAV_STATE_STANDBY
    if autopilot.crashed:
        state = dialect.MAV_STATE_EMERGENCY
    message: Message = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_PX4,
        base_mode(armed=autopilot.armed),
        autopilot.mode.custom_mode,
        state,
        3,
    )
    return message


def _global_position(autopilot: "Autopilot") -> Message:
    body = autopilot.body
    velocity = (round(body.north_mps * 100), round(body.east_mps * 100), round(-body.up_mps * 100))
    heading = round(_heading_deg(autopilot) * 100) % 36000
    message: Message = dialect.MAVLink_global_position_int_message(
        _boot_ms(autopilot), *_place(autopilot), *velocity, heading
    )
    return message


def _local_position(autopilot: "Autopilot") -> Message:
    body = autopilot.body
    place = (body.north_m, body.east_m, -body.up_m)
    message: Message = dialect.MAVLink_local_position_ned_message(
        _boot_ms(autopilot), *place, body.north_mps, body.east_mps, -body.up_mps
    )
    return message


def _gps(autopilot: "Autopilot") -> Message:
    body = autopilot.body
    course = math.degrees(math.atan2(body.east_mps, body.north_mps)) % 360.0
    message: Message = dialect.MAVLink_gps_raw_int_message(
        _boot_ms(autopilot) * 1000,
        dialect.GPS_FIX_TYPE_3D_FIX,
        *_place(autopilot)[:3],
        80,
        120,
        round(body.ground_speed_mps * 100),
        round(course * 100) % 36000,
        14,
    )
    return message


def _mission_current(autopilot: "Autopilot") -> Message:
    runner = autopilot.runner
    flying = autopilot.mode is Mode.MISSION
    if not runner.mission.items:
        state = dialect.MISSION_STATE_NO_MISSION
    elif runner.complete:
        state = dialect.MISSION_STATE_COMPLETE
    elif flying and autopilot.armed:
        state = dialect.MISSION_STATE_ACTIVE
    else:
        state = dialect.MISSION_STATE_PAUSED if runner.started else dialect.MISSION_STATE_NOT_STARTED
    base = dialect.MAVLink_mission_current_message(runner.index, len(runner.mission), state, 1 if flying else 2)
    return Extended(base, mission_id=runner.mission.mission_id, fence_id=0, rally_points_id=0)


def _extended_state(autopilot: "Autopilot") -> Message:
    if autopilot.body.on_ground:
        state = dialect.MAV_LANDED_STATE_ON_GROUND
    elif autopilot.landing:
        state = dialect.MAV_LANDED_STATE_LANDING
    elif autopilot.mode is Mode.TAKEOFF:
        state = dialect.MAV_LANDED_STATE_TAKEOFF
    else:
        state = dialect.MAV_LANDED_STATE_IN_AIR
    message: Message = dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, state)
    return message


def _sys_status(autopilot: "Autopilot") -> Message:
    remaining, cell_mv = _battery(autopilot)
    healthy = 0 if autopilot.crashed or not autopilot.powered else _SENSORS
    message: Message = dialect.MAVLink_sys_status_message(
        _SENSORS, _SENSORS, healthy, 250, 4 * cell_mv, 1500 if autopilot.armed else 50, remaining, 0, 0, 0, 0, 0, 0
    )
    return message


def _battery_status(autopilot: "Autopilot") -> Message:
    remaining, cell_mv = _battery(autopilot)
    cells = [cell_mv] * 4 + [0xFFFF] * 6
    message: Message = dialect.MAVLink_battery_status_message(
        0,
        dialect.MAV_BATTERY_FUNCTION_ALL,
        dialect.MAV_BATTERY_TYPE_LIPO,
        0x7FFF,
        cells,
        1500 if autopilot.armed else 50,
        -1,
        -1,
        remaining,
    )
    return message


def _attitude(autopilot: "Autopilot") -> Message:
    yaw = autopilot.body.yaw_rad
    message: Message = dialect.MAVLink_attitude_message(_boot_ms(autopilot), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)
    return message


def _attitude_quaternion(autopilot: "Autopilot") -> Message:
    half = autopilot.body.yaw_rad / 2.0
    message: Message = dialect.MAVLink_attitude_quaternion_message(
        _boot_ms(autopilot), math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0
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


def _home(autopilot: "Autopilot") -> Message:
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
        _boot_ms(autopilot) * 1000,
    )
    return message


def _version(autopilot: "Autopilot") -> Message:
    message: Message = dialect.MAVLink_autopilot_version_message(
        _CAPABILITIES, _FIRMWARE, 0, 0, 0, _NO_BYTES, _NO_BYTES, _NO_BYTES, 0, 0, 0x5B1F0000 + autopilot.spec.system_id
    )
    return message


_BUILDERS: dict[int, Callable[["Autopilot"], Message]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    dialect.MAVLINK_MSG_ID_MISSION_CURRENT: _mission_current,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_state,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    dialect.MAVLINK_MSG_ID_VFR_HUD: _hud,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home,
    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
}
