"""Names of what MAVLink leaves to each autopilot: who it is, and what its flight modes mean to us.

The names are shared by everything; what an autopilot makes of them is in its profile (`profile`, `px4`, `ardupilot`).
"""

from __future__ import annotations

from enum import StrEnum

from skyfolio.mavlink_bridge.answers import Answer


class Autopilot(StrEnum):
    """The autopilots that have a profile, by the names that files, the REST interface and the command line use.

    `Autopilot(name)` raises ValueError for an unknown name; the text lists the known ones.
    """

    PX4 = "px4"
    ARDUPILOT = "ardupilot"

    @classmethod
    def _missing_(cls, value: object) -> Autopilot:
        raise ValueError(f"autopilot: {value!r} is unknown; known are {', '.join(cls)}")


DEFAULT_AUTOPILOT = Autopilot.PX4
"""The autopilot that missions are compiled for where a caller names none."""


class MavAutopilot(Answer):
    """MAV_AUTOPILOT, as HEARTBEAT.autopilot has it."""

    GENERIC = 0
    RESERVED = 1
    SLUGS = 2
    ARDUPILOTMEGA = 3
    OPENPILOT = 4
    GENERIC_WAYPOINTS_ONLY = 5
    GENERIC_WAYPOINTS_AND_SIMPLE_NAVIGATION_ONLY = 6
    GENERIC_MISSION_FULL = 7
    INVALID = 8
    """The sender reports itself that it is no autopilot."""
    PPZ = 9
    UDB = 10
    FP = 11
    PX4 = 12
    SMACCMPILOT = 13
    AUTOQUAD = 14
    ARMAZILA = 15
    AEROB = 16
    ASLUAV = 17
    SMARTAP = 18
    AIRRAILS = 19
    REFLEX = 20


class FlightMode(StrEnum):
    """What flies the vehicle; OTHER is a mode that the profile does not list, or one of an unknown autopilot."""

    MANUAL = "manual"
    ALTITUDE = "altitude"
    POSITION = "position"
    ACRO = "acro"
    OFFBOARD = "offboard"
    GUIDED = "guided"
    """ArduPilot only: the vehicle flies where it is commanded to, and hovers without a command."""
    STABILIZED = "stabilized"
    READY = "ready"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    MISSION = "mission"
    RETURN = "return"
    LAND = "land"
    OTHER = "other"


_NO_AIRCRAFT = frozenset({5, 6, 18, 26, 27, *range(30, 35), *range(36, 43), 44, 48, 49})
"""MAV_TYPE of what may be on board or on the ground and is no aircraft: antenna tracker, ground station, onboard
controller, gimbal, ADS-B, camera, charging station, FLARM, servo, remote identification, battery, parachute, log,
display, IMU, GPS, winch, illuminator, gripper, radio."""


def speaks_as_autopilot(mav_type: int, mav_autopilot: int) -> bool:
    """Return whether a HEARTBEAT with this MAV_TYPE and MAV_AUTOPILOT can come from an aircraft's autopilot.

    A ground station, camera or receiver that claims component 1 reports nothing about the autopilot: neither what the
    autopilot does nor that it is alive.
    """
    return mav_autopilot != MavAutopilot.INVALID and mav_type not in _NO_AIRCRAFT
