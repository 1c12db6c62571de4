"""How far a mission is, and what follows it: the terms that its runner and its telemetry share."""

from dataclasses import dataclass
from enum import Enum, auto

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.modes import Mode

NOTHING_REACHED = -1
MISSION_MODES = (Mode.MISSION, Mode.TAKEOFF, Mode.LAND)
"""Modes in which PX4 reports a mission as active (MISSION_CURRENT.mission_mode)."""


class Handover(Enum):
    """Why the runner has nothing more to fly, and another part takes over."""

    FINISHED = auto()
    LANDED = auto()
    RETURN = auto()


class MissionState(Enum):
    """How far a mission is (MISSION_CURRENT.mission_state)."""

    NO_MISSION = dialect.MISSION_STATE_NO_MISSION
    NOT_STARTED = dialect.MISSION_STATE_NOT_STARTED
    ACTIVE = dialect.MISSION_STATE_ACTIVE
    PAUSED = dialect.MISSION_STATE_PAUSED
    COMPLETE = dialect.MISSION_STATE_COMPLETE


@dataclass(frozen=True, slots=True)
class Target:
    """Where the current item leads: metres east, north and up, a radius, and the speed at which it is passed.

    passing_up_mps: how fast its altitude may be passed, up or down.
    """

    east_m: float
    north_m: float
    up_m: float
    radius_m: float
    passing_mps: float
    yaw_rad: float | None = None
    passing_up_mps: float = 0.0
