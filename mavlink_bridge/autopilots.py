"""Which autopilot flies a vehicle, and how it numbers its flight modes.

MAVLink leaves modes to the autopilot: HEARTBEAT.custom_mode means main and sub mode on PX4 (bytes 2 and 3) and one
number on ArduCopter. Here both are read into one `FlightMode`, and written back for MAV_CMD_DO_SET_MODE (176).
"""

from __future__ import annotations

from enum import StrEnum


class Autopilot(StrEnum):
    """The autopilots missions can be compiled for."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class FlightMode(StrEnum):
    """Who flies; OTHER is a mode this list does not know."""

    MANUAL = "manual"
    ALTITUDE = "altitude"
    POSITION = "position"
    ACRO = "acro"
    OFFBOARD = "offboard"
    GUIDED = "guided"
    """ArduPilot only: flies where it is told, and hovers when it is told nothing."""
    STABILIZED = "stabilized"
    READY = "ready"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    MISSION = "mission"
    RETURN = "return"
    LAND = "land"
    OTHER = "other"


_UNKNOWN_TOTAL = 65535

_MAV_AUTOPILOT = {12: Autopilot.PX4, 3: Autopilot.ARDUPILOT}

_PX4_MAIN = {
    1: FlightMode.MANUAL,
    2: FlightMode.ALTITUDE,
    3: FlightMode.POSITION,
    5: FlightMode.ACRO,
    6: FlightMode.OFFBOARD,
    7: FlightMode.STABILIZED,
}
_PX4_AUTO = {
    1: FlightMode.READY,
    2: FlightMode.TAKEOFF,
    3: FlightMode.HOLD,
    4: FlightMode.MISSION,
    5: FlightMode.RETURN,
    6: FlightMode.LAND,
}
_PX4_AUTO_MAIN = 4

_COPTER = {
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

_PX4_NUMBERS = {
    FlightMode.HOLD: (_PX4_AUTO_MAIN, 3),
    FlightMode.MISSION: (_PX4_AUTO_MAIN, 4),
    FlightMode.RETURN: (_PX4_AUTO_MAIN, 5),
    FlightMode.LAND: (_PX4_AUTO_MAIN, 6),
    FlightMode.OFFBOARD: (6, 0),
}
_COPTER_NUMBERS = {
    FlightMode.MISSION: (3, 0),
    FlightMode.GUIDED: (4, 0),
    FlightMode.RETURN: (6, 0),
    FlightMode.LAND: (9, 0),
}

HOLD_MODE = {Autopilot.PX4: FlightMode.HOLD, Autopilot.ARDUPILOT: FlightMode.GUIDED}
"""Where a vehicle hovers until told otherwise. ArduCopter's LOITER would listen to a throttle stick nobody holds."""

STREAM_MODE = {Autopilot.PX4: FlightMode.OFFBOARD, Autopilot.ARDUPILOT: FlightMode.GUIDED}
"""The mode that follows streamed setpoints."""

OURS = {
    Autopilot.PX4: frozenset(
        {FlightMode.MISSION, FlightMode.HOLD, FlightMode.TAKEOFF, FlightMode.READY, FlightMode.OFFBOARD}
    ),
    Autopilot.ARDUPILOT: frozenset({FlightMode.MISSION, FlightMode.GUIDED}),
}
"""Modes in which a vehicle is ours to command; in any other a human or a failsafe flies it."""


def autopilot_of(mav_autopilot: int) -> Autopilot | None:
    """The autopilot HEARTBEAT.autopilot (MAV_AUTOPILOT) names; None for one nobody compiles for."""
    return _MAV_AUTOPILOT.get(mav_autopilot)


def mode_of(autopilot: Autopilot | None, custom_mode: int) -> FlightMode:
    """HEARTBEAT.custom_mode as a mode."""
    if autopilot is Autopilot.ARDUPILOT:
        return _COPTER.get(custom_mode, FlightMode.OTHER)
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if main == _PX4_AUTO_MAIN:
        return _PX4_AUTO.get(sub, FlightMode.OTHER)
    return _PX4_MAIN.get(main, FlightMode.OTHER)


def items_on_board(autopilot: Autopilot | None, total: int) -> int | None:
    """MISSION_CURRENT.total as the length of the list that was uploaded; None: not told.

    ArduPilot leaves item 0, its home, out.
    """
    if total == _UNKNOWN_TOTAL:
        return None
    return total + 1 if autopilot is Autopilot.ARDUPILOT and total > 0 else total


def mode_numbers(autopilot: Autopilot, mode: FlightMode) -> tuple[int, int]:
    """(param2, param3) of MAV_CMD_DO_SET_MODE (176). Raises ValueError for a mode we never command."""
    numbers = _COPTER_NUMBERS if autopilot is Autopilot.ARDUPILOT else _PX4_NUMBERS
    try:
        return numbers[mode]
    except KeyError:
        raise ValueError(f"mode: '{mode}' is not one {autopilot} is commanded into") from None
