"""Flight modes and how PX4 writes them into HEARTBEAT.custom_mode and MAV_CMD_DO_SET_MODE."""

from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as dialect

_MAIN_AUTO = 4


class Mode(Enum):
    """The automatic modes this vehicle flies; the value is PX4's AUTO sub mode."""

    TAKEOFF = 2
    HOLD = 3
    MISSION = 4
    RTL = 5
    LAND = 6

    @property
    def custom_mode(self) -> int:
        """The 32-bit custom_mode of HEARTBEAT: main mode in byte 2, sub mode in byte 3."""
        return _MAIN_AUTO << 16 | self.value << 24

    @classmethod
    def from_command(cls, main: float, sub: float) -> "Mode | None":
        """Return the mode that DO_SET_MODE's param2 and param3 name, or None if the vehicle has no such mode."""
        if main != _MAIN_AUTO:
            return None
        return next((mode for mode in cls if mode.value == sub), None)


def base_mode(*, armed: bool) -> int:
    """Return HEARTBEAT.base_mode of a vehicle in any of the automatic modes."""
    flags = (
        dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        | dialect.MAV_MODE_FLAG_AUTO_ENABLED
        | dialect.MAV_MODE_FLAG_GUIDED_ENABLED
        | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
    )
    return int(flags | dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else flags)
