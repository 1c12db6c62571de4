"""ArduCopter: its mission items, modes, storage, parameters and rules.

Item 0 is home: ArduPilot keeps its own place there, whatever is uploaded. Item 1 must be NAV_TAKEOFF on the ground. It
stores a waypoint's hold in whole seconds and neither radius nor yaw (AP_Mission), so none of these is sent, and
altitudes in centimetres. Read back, commands without a place have frame 0.

What it stores is read from the sources of 4.6: `AP_Mission::mavlink_int_to_mission_cmd` and back,
`MissionItemProtocol_Fence`, `AC_PolyFence_loader::write_fence`, `MissionItemProtocol_Rally`.
"""

from __future__ import annotations

from dataclasses import replace

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode, MavAutopilot
from skyfolio.mavlink_bridge.findings import Facts, Finding, Level, Needs, warning
from skyfolio.mavlink_bridge.items import Command, Frame
from skyfolio.mavlink_bridge.mission_messages import GROUND, MissionType
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.parameter_rules import (
    BREACH,
    CLIMBS_LATE,
    SINKS_LATE,
    Rule,
    altitude_m,
    at_least,
    at_most,
    climb_mps,
    farthest_m,
    limit,
    one_of,
)
from skyfolio.mavlink_bridge.profile import AutopilotProfile, Parameters, Takeoff
from skyfolio.mavlink_bridge.readback import (
    CENTIMETRES,
    DIRECTION,
    DROPPED,
    FLAG,
    MILLIMETRES,
    NO_PARAMS,
    SET,
    WHOLE,
    Kept,
)
from skyfolio.mavlink_bridge.schedule import Stop
from skyfolio.mavlink_bridge.writer import MissionWriter


class ArduPilotWriter(MissionWriter):
    """Writes missions for ArduCopter. On the ground: home, NAV_TAKEOFF; in flight: home, then straight to leg one."""

    def _begin(self, first: Stop, *, takeoff: bool) -> None:
        self._position(Command.NAV_WAYPOINT, first.point_m, 0.0, frame=Frame.GLOBAL)
        if takeoff:
            self._position(Command.NAV_TAKEOFF, first.point_m, self._level(first))

    def _waypoint(self, stop: Stop) -> None:
        self._position(Command.NAV_WAYPOINT, stop.point_m, self._level(stop), param1=float(round(stop.hold_s)))

    def _level(self, stop: Stop) -> float:
        return round(stop.altitude_m, 2)


# -- modes: HEARTBEAT.custom_mode is one number -----------------------------------------------------------------------

_MODES = {
    0: FlightMode.STABILIZED,
    1: FlightMode.ACRO,
    2: FlightMode.ALTITUDE,
    3: FlightMode.MISSION,
    4: FlightMode.GUIDED,
    5: FlightMode.POSITION,
    6: FlightMode.RETURN,
    9: FlightMode.LAND,
    16: FlightMode.POSITION,
    17: FlightMode.HOLD,
    21: FlightMode.RETURN,
    27: FlightMode.RETURN,
}
_MODE_NUMBERS = {
    FlightMode.MISSION: (3, 0),
    FlightMode.GUIDED: (4, 0),
    FlightMode.RETURN: (6, 0),
    FlightMode.LAND: (9, 0),
}


def _read_mode(custom_mode: int) -> FlightMode:
    return _MODES.get(custom_mode, FlightMode.OTHER)


def _takeoff_params(up_m: float, home_amsl_m: float) -> tuple[float | None, ...]:
    """Return the parameters: altitude above its home."""
    del home_amsl_m
    return (0.0, 0.0, 0.0, None, 0.0, 0.0, up_m)


# -- how it flies -----------------------------------------------------------------------------------------------------

ARDUCOPTER_MODEL = VehicleModel(
    acceleration_mps2=2.5,
    braking_mps2=2.0,
    max_speed_mps=15.0,
    acceptance_radius_m=2.0,
    jerk_mps3=1.0,
    cruise_mps=10.0,
    rests_in_plan=True,
    settle_s=2.2,
    hold_step_s=1.0,
)
"""ArduCopter 4.x with its default parameters; settling measured in software-in-the-loop."""
_BRAKING_SHARE = 0.8
"""Stops and corners are planned with less than the acceleration limit, so that wind does not make them late."""
_LEAST_MPS2 = 0.1
_SPEED_FACTOR = 1.5
"""ArduCopter flies DO_CHANGE_SPEED above WP_SPD; beyond this factor its corners and stops grow out of proportion."""


def _model_of(parameters: Parameters) -> VehicleModel:
    """Return its model. Names and units changed in 4.7: WPNAV_* are centimetres, WP_* metres."""
    default = ARDUCOPTER_MODEL
    acceleration = max(_metres(parameters, "WP_ACC", "WPNAV_ACCEL", default.acceleration_mps2), _LEAST_MPS2)
    cruise = _metres(parameters, "WP_SPD", "WPNAV_SPEED", default.cruise_mps)
    return VehicleModel(
        acceleration_mps2=acceleration,
        braking_mps2=round(_BRAKING_SHARE * acceleration, 6),
        max_speed_mps=max(cruise * _SPEED_FACTOR, VehicleModel().min_speed_mps),
        acceptance_radius_m=_metres(parameters, "WP_RADIUS_M", "WPNAV_RADIUS", default.acceptance_radius_m),
        jerk_mps3=parameters.get("WP_JERK", parameters.get("WPNAV_JERK", default.jerk_mps3)),
        cruise_mps=cruise,
        rests_in_plan=True,
        settle_s=default.settle_s,
        hold_step_s=default.hold_step_s,
    )


def _metres(parameters: Parameters, metres: str, centimetres: str, default: float) -> float:
    if metres in parameters:
        return parameters[metres]
    return parameters[centimetres] / 100.0 if centimetres in parameters else default


def _agility(needs: Needs) -> str:
    return f"WPNAV_JERK (WP_JERK) of at least {4 * needs.max_speed_mps / (needs.slot_s / 2) ** 2:.1f}"


# -- what it stores ---------------------------------------------------------------------------------------------------

_ITEM = replace(NO_PARAMS, z=CENTIMETRES, autocontinue=SET)
_ORDER = Kept(param4=DROPPED, autocontinue=SET, placed=False)
_FENCE = replace(NO_PARAMS, z=DROPPED, autocontinue=DROPPED, datum=False)
_CIRCLE = replace(_FENCE, param1=MILLIMETRES)
_CORNER = replace(_FENCE, param1=WHOLE)
_KEPT: dict[MissionType, dict[int, Kept]] = {
    MissionType.MISSION: {
        Command.NAV_WAYPOINT: replace(_ITEM, param1=WHOLE),
        Command.NAV_SPLINE_WAYPOINT: replace(_ITEM, param1=WHOLE),
        Command.NAV_LOITER_UNLIM: replace(_ITEM, param3=WHOLE),
        Command.NAV_LOITER_TIME: replace(_ITEM, param1=WHOLE, param3=DIRECTION, param4=FLAG),
        Command.NAV_RETURN_TO_LAUNCH: replace(NO_PARAMS, autocontinue=SET, placed=False),
        Command.NAV_LAND: replace(_ITEM, param1=WHOLE, param4=DIRECTION),
        Command.NAV_TAKEOFF: replace(_ITEM, param1=WHOLE),
        Command.NAV_DELAY: replace(_ORDER, param2=WHOLE, param3=WHOLE, param4=WHOLE),
        Command.DO_CHANGE_SPEED: replace(_ORDER, param1=WHOLE),
    },
    MissionType.FENCE: {
        Command.NAV_FENCE_RETURN_POINT: _FENCE,
        Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION: _CORNER,
        Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION: _CORNER,
        Command.NAV_FENCE_CIRCLE_INCLUSION: _CIRCLE,
        Command.NAV_FENCE_CIRCLE_EXCLUSION: _CIRCLE,
    },
    MissionType.RALLY: {Command.NAV_RALLY_POINT: replace(NO_PARAMS, z=WHOLE, autocontinue=DROPPED)},
}

# -- rules of the preflight audit -------------------------------------------------------------------------------------


def _continues_in_auto(value: float, facts: Facts, needs: Needs) -> list[Finding]:
    acts = facts.parameters.get("FS_GCS_ENABLE", 0) != 0
    if not acts or int(value) & 2 or needs.stream:
        return []
    why = "else the loss of our link ends its mission, which is on board to survive exactly that"
    return [warning("FS_OPTIONS", f"{value:g}", f"{int(value) | 2} (bit 1: continue in AUTO)", why)]


_B, _W = Level.BLOCKER, Level.WARNING
_GIVES_UP = "it gives up the link before this service does"
_RULES = (
    one_of(
        ("SYSID_MYGCS", "MAV_GCS_SYSID"),
        {GROUND[0]},
        _W,
        f"{GROUND[0]} (us)",
        "its ground station failsafe watches another station's heartbeat, not ours",
    ),
    one_of(("FS_GCS_ENABLE",), {1, 2, 3, 4, 5, 6}, _W, "1 (return)", "it would not notice that this service is gone"),
    at_least(
        ("FS_GCS_TIMEOUT",),
        lambda needs: min(needs.lost_after_s, 5.0),
        _W,
        _GIVES_UP,
    ),
    Rule(("FS_OPTIONS",), _continues_in_auto),
    one_of(("MIS_RESTART",), {0}, _B, "0", "after every hold its mission would begin again"),
    one_of(("BATT_FS_LOW_ACT",), {1, 2, 3, 4}, _W, "2 (return)", "an empty battery would only be announced"),
    one_of(("FENCE_ENABLE",), {1}, _W, "1", "the uploaded geofence would not be kept"),
    at_least(("WPNAV_SPEED_UP",), lambda needs: 100.0 * climb_mps(needs), _W, CLIMBS_LATE),
    at_least(("WPNAV_SPEED_DN",), lambda needs: 100.0 * climb_mps(needs), _W, SINKS_LATE),
    limit(("FENCE_RADIUS",), farthest_m, BREACH, enabled="FENCE_ENABLE"),
    limit(("FENCE_ALT_MAX",), altitude_m, BREACH, enabled="FENCE_ENABLE"),
    at_most(("GUID_TIMEOUT",), 3.0, _W, "it flies on blindly for this long after the last setpoint"),
)

ARDUCOPTER = AutopilotProfile(
    autopilot=Autopilot.ARDUPILOT,
    title="ArduPilot",
    mav_autopilot=MavAutopilot.ARDUPILOTMEGA,
    read_mode=_read_mode,
    mode_numbers=_MODE_NUMBERS,
    hold_mode=FlightMode.GUIDED,  # LOITER would follow the throttle stick of a remote control that nobody holds
    stream_mode=FlightMode.GUIDED,
    our_modes=frozenset({FlightMode.MISSION, FlightMode.GUIDED}),
    takeoff=Takeoff(armed_in=FlightMode.GUIDED, mode=None, params=_takeoff_params),
    writer=ArduPilotWriter,
    home_first=True,
    replaces_whole=False,
    restarts_hold=True,
    read_window=4,
    kept=_KEPT,
    default_model=ARDUCOPTER_MODEL,
    model_of=_model_of,
    model_parameters=(
        *("WP_ACC", "WP_JERK", "WP_RADIUS_M", "WP_SPD"),
        *("WPNAV_ACCEL", "WPNAV_JERK", "WPNAV_RADIUS", "WPNAV_SPEED"),
    ),
    speed_parameters=("WP_SPD", "WPNAV_SPEED"),
    agility=_agility,
    bytewise_parameters=False,
    rules=_RULES,
)
