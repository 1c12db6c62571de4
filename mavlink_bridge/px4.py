"""PX4: its mission items, modes, storage, parameters and rules.

PX4 expects positions in frame 6 (or 0, above mean sea level), commands without a position in frame 2
(MAV_FRAME_MISSION), the speed of a leg before the waypoint the leg ends at, and hovering as param1 of the waypoint (a
NAV_DELAY item makes copters pace about).
Yaw is fixed to north (param4 = 0): the antenna of a base station keeps its orientation.

What it stores is read from the sources of 1.18: `MavlinkMissionManager::parse_mavlink_mission_item`,
`format_mavlink_mission_item` and `send_mission_item`.
"""

from __future__ import annotations

from dataclasses import replace
from math import dist

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode, MavAutopilot
from skyfolio.mavlink_bridge.findings import Facts, Finding, Level, Needs
from skyfolio.mavlink_bridge.items import Command
from skyfolio.mavlink_bridge.mission_messages import MissionType
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
from skyfolio.mavlink_bridge.readback import DEGREES, DROPPED, FLAG, NEAREST, NO_PARAMS, SAME, WHOLE, Kept
from skyfolio.mavlink_bridge.schedule import Stop
from skyfolio.mavlink_bridge.writer import MissionWriter


class Px4Writer(MissionWriter):
    """Writes missions for PX4. On the ground NAV_TAKEOFF is item 0; in flight it goes straight to the first leg."""

    def _begin(self, first: Stop, *, takeoff: bool) -> None:
        if takeoff:
            self._position(Command.NAV_TAKEOFF, first.point_m, self._level(first))

    def _waypoint(self, stop: Stop) -> None:
        self._position(
            Command.NAV_WAYPOINT,
            stop.point_m,
            self._level(stop),
            param1=round(stop.hold_s, 3),
            param2=round(stop.radius_m, 3),
        )


# -- modes: HEARTBEAT.custom_mode has the main mode in byte 2 and the sub mode of AUTO in byte 3 ----------------------

_MAIN_MODES = {
    1: FlightMode.MANUAL,
    2: FlightMode.ALTITUDE,
    3: FlightMode.POSITION,
    5: FlightMode.ACRO,
    6: FlightMode.OFFBOARD,
    7: FlightMode.STABILIZED,
}
_AUTO_MODES = {
    1: FlightMode.READY,
    2: FlightMode.TAKEOFF,
    3: FlightMode.HOLD,
    4: FlightMode.MISSION,
    5: FlightMode.RETURN,
    6: FlightMode.LAND,
}
_AUTO = 4
_MODE_NUMBERS = {
    FlightMode.HOLD: (_AUTO, 3),
    FlightMode.MISSION: (_AUTO, 4),
    FlightMode.RETURN: (_AUTO, 5),
    FlightMode.LAND: (_AUTO, 6),
    FlightMode.OFFBOARD: (6, 0),
}


def _read_mode(custom_mode: int) -> FlightMode:
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    modes, number = (_AUTO_MODES, sub) if main == _AUTO else (_MAIN_MODES, main)
    return modes.get(number, FlightMode.OTHER)


def _takeoff_params(up_m: float, home_amsl_m: float) -> tuple[float | None, ...]:
    """Return the parameters: altitude above mean sea level, NaN for its own position and yaw."""
    return (None, 0.0, 0.0, None, None, None, home_amsl_m + up_m)


# -- how it flies -----------------------------------------------------------------------------------------------------

PX4_MODEL = VehicleModel(jerk_from_rest_mps3=4.0, departure_mps2=1.8)
"""PX4 with its default parameters."""
_BRAKING_SHARE = 0.8
"""Stops and corners are planned with less than the acceleration limit, so that wind does not make them late."""
_DEPARTURE_SHARE = 0.6
"""PX4 waits for a vehicle that lags behind its setpoint: from rest, so much of MPC_ACC_HOR is left (measured, 1.18)."""
_LEAST_MPS2 = 0.1
_LEAST_MPS3 = 0.5
"""The least value that MPC_JERK_AUTO may have."""


def _model_of(parameters: Parameters) -> VehicleModel:
    acceleration = max(parameters.get("MPC_ACC_HOR", PX4_MODEL.acceleration_mps2), _LEAST_MPS2)
    return VehicleModel(
        acceleration_mps2=acceleration,
        braking_mps2=round(_BRAKING_SHARE * acceleration, 6),
        max_speed_mps=parameters.get("MPC_XY_VEL_MAX", PX4_MODEL.max_speed_mps),
        jerk_from_rest_mps3=max(parameters.get("MPC_JERK_AUTO", PX4_MODEL.jerk_from_rest_mps3), _LEAST_MPS3),
        departure_mps2=round(_DEPARTURE_SHARE * acceleration, 6),
        cruise_mps=parameters.get("MPC_XY_CRUISE", PX4_MODEL.cruise_mps),
        acceptance_radius_m=PX4_MODEL.acceptance_radius_m,  # sent with each waypoint, so NAV_ACC_RAD does not matter
    )


def _agility(needs: Needs) -> str:
    return f"MPC_ACC_HOR of at least {needs.max_speed_mps / (needs.slot_s / 2):.1f}"


# -- what it stores ---------------------------------------------------------------------------------------------------

_FENCE = replace(NO_PARAMS, autocontinue=DROPPED, datum=False)
_CORNER = replace(_FENCE, param1=NEAREST)
_CIRCLE = replace(_FENCE, param1=SAME)
_KEPT: dict[MissionType, dict[int, Kept]] = {
    MissionType.MISSION: {
        Command.NAV_WAYPOINT: Kept(param3=DROPPED, param4=DEGREES),
        Command.NAV_LOITER_UNLIM: Kept(param1=DROPPED, param2=DROPPED, param4=DEGREES),
        Command.NAV_LOITER_TIME: Kept(param2=FLAG, param4=FLAG),
        Command.NAV_RETURN_TO_LAUNCH: Kept(placed=False),
        Command.NAV_LAND: Kept(param2=WHOLE, param3=DROPPED, param4=DEGREES),
        Command.NAV_TAKEOFF: replace(NO_PARAMS, param4=DEGREES),
        Command.NAV_DELAY: Kept(placed=False),
        Command.DO_CHANGE_SPEED: Kept(placed=False),
    },
    MissionType.FENCE: {
        Command.NAV_FENCE_RETURN_POINT: _FENCE,
        Command.NAV_FENCE_POLYGON_VERTEX_INCLUSION: _CORNER,
        Command.NAV_FENCE_POLYGON_VERTEX_EXCLUSION: _CORNER,
        Command.NAV_FENCE_CIRCLE_INCLUSION: _CIRCLE,
        Command.NAV_FENCE_CIRCLE_EXCLUSION: _CIRCLE,
    },
    MissionType.RALLY: {Command.NAV_RALLY_POINT: NO_PARAMS},
}

# -- rules of the preflight audit -------------------------------------------------------------------------------------

_HOLDS = 5
"""COM_OBL_RC_ACT since PX4 1.14: 0 to 2 are a pilot's modes (without remote control: return), then 3 return, 4 land."""


def _holds_without_setpoints(value: float, facts: Facts, needs: Needs) -> list[Finding]:
    """Return a finding unless PX4 holds when setpoints end: else it is gone before the guard or a new service acts."""
    del facts
    if int(value) == _HOLDS or not needs.stream:
        return []
    return [
        Finding(
            level=Level.WARNING if needs.force_stream else Level.BLOCKER,
            name="COM_OBL_RC_ACT",
            found=f"{value:g}",
            should=f"{_HOLDS} (hold)",
            why="when setpoints end, even for a second, it does not hold: without remote control it returns home",
            refuses=not needs.force_stream,
        )
    ]


def _takes_waypoints_while_climbing(value: float, facts: Facts, needs: Needs) -> list[Finding]:
    """Return a finding if PX4 would miss waypoints on climbs.

    It flies altitude apart from the way over ground, at full speed, and passes it by some 2.5 m where the next one is
    another: outside of NAV_MC_ALT_RAD then, it flies back to each waypoint. With the default 0.8 m a flight over hills
    was 104 m behind in the end, with 10 m never more than 2.6 m while it climbed.
    """
    del facts
    if value >= needs.climb_m:
        return []
    return [
        Finding(
            level=Level.WARNING if needs.stream else Level.BLOCKER,
            name="NAV_MC_ALT_RAD",
            found=f"{value:g}",
            should=f"at least {needs.climb_m:g}, what the plan climbs in a slot",
            why="it would miss waypoints on its climbs, fly back to each, and be late by minutes",
            refuses=not needs.stream,
        )
    ]


def _first_waypoint_m(facts: Facts, needs: Needs) -> float:
    return dist(facts.home_m or needs.path_m[0], needs.path_m[0])


_B, _W = Level.BLOCKER, Level.WARNING
_RULES = (
    at_least(("COM_DL_LOSS_T",), lambda needs: needs.lost_after_s, _W, "it gives up the link before this service does"),
    one_of(("NAV_DLL_ACT",), {0, 1, 2, 3}, _B, "0 (none) to 3 (land)", "losing our link would stop its motors"),
    one_of(("COM_LOW_BAT_ACT",), {2, 3}, _W, "3 (return, then land)", "an empty battery would only be announced"),
    one_of(("GF_ACTION",), {1, 2, 3, 5}, _W, "2 (hold)", "the uploaded geofence would not be kept"),
    Rule(("COM_OBL_RC_ACT",), _holds_without_setpoints),
    Rule(("NAV_MC_ALT_RAD",), _takes_waypoints_while_climbing),
    at_least(("MPC_Z_V_AUTO_UP",), climb_mps, _W, CLIMBS_LATE),
    at_least(("MPC_Z_V_AUTO_DN",), climb_mps, _W, SINKS_LATE),
    at_most(("COM_OF_LOSS_T",), 2.0, _W, "it flies on blindly for this long after the last setpoint"),
    limit(("GF_MAX_HOR_DIST",), farthest_m, BREACH, enabled="GF_ACTION"),
    limit(("GF_MAX_VER_DIST",), altitude_m, BREACH, enabled="GF_ACTION"),
    limit(("MIS_DIST_1WP",), _first_waypoint_m, "the first waypoint is further from home: the mission is refused"),
)

PX4 = AutopilotProfile(
    autopilot=Autopilot.PX4,
    title="PX4",
    mav_autopilot=MavAutopilot.PX4,
    read_mode=_read_mode,
    mode_numbers=_MODE_NUMBERS,
    hold_mode=FlightMode.HOLD,
    stream_mode=FlightMode.OFFBOARD,
    our_modes=frozenset(
        {FlightMode.MISSION, FlightMode.HOLD, FlightMode.TAKEOFF, FlightMode.READY, FlightMode.OFFBOARD}
    ),
    takeoff=Takeoff(armed_in=None, mode=FlightMode.TAKEOFF, params=_takeoff_params),
    writer=Px4Writer,
    home_first=False,
    replaces_whole=True,
    restarts_hold=False,
    read_window=1,
    kept=_KEPT,
    default_model=PX4_MODEL,
    model_of=_model_of,
    model_parameters=("MPC_ACC_HOR", "MPC_JERK_AUTO", "MPC_XY_CRUISE", "MPC_XY_VEL_MAX"),
    speed_parameters=("MPC_XY_VEL_MAX",),
    agility=_agility,
    bytewise_parameters=True,
    rules=_RULES,
)
