"""Flight modes, independent of their numbers in HEARTBEAT.custom_mode (`sim.flavours` has the tables)."""

from enum import Enum, auto

from pymavlink.dialects.v20 import ardupilotmega as dialect


class Mode(Enum):
    """A flight mode of either autopilot."""

    TAKEOFF = auto()
    """PX4 only: climb to the take-off altitude, then hold. ArduCopter takes off in GUIDED."""
    HOLD = auto()
    """Stay here: PX4's AUTO.LOITER, ArduCopter's LOITER with centred sticks."""
    MISSION = auto()
    """PX4's AUTO.MISSION, ArduCopter's AUTO."""
    RTL = auto()
    LAND = auto()
    GUIDED = auto()
    """Flown by messages: PX4's OFFBOARD, ArduCopter's GUIDED."""
    BRAKE = auto()
    """ArduCopter only: stop as hard as it can, then stay."""
    POSITION = auto()
    """A human flies: PX4's POSCTL, ArduCopter's POSHOLD; with centred sticks the vehicle stays."""
    STABILIZE = auto()
    """A human flies by attitude; with centred sticks and mid throttle the vehicle stays."""

    @property
    def needs_position(self) -> bool:
        """Whether it can only be flown knowing where the vehicle is."""
        return self not in (Mode.LAND, Mode.STABILIZE)

    @property
    def is_automatic(self) -> bool:
        """Whether the autopilot decides where to go."""
        return self not in (Mode.POSITION, Mode.STABILIZE)

    @property
    def is_flown_by_a_pilot(self) -> bool:
        """Whether an ArduCopter counts it as flown by sticks, centred or not."""
        return self in (Mode.POSITION, Mode.STABILIZE, Mode.HOLD, Mode.BRAKE)


def px4_base_mode(mode: Mode, *, armed: bool, blind: bool = False) -> int:
    """Return a PX4's HEARTBEAT.base_mode, the same with a position and without."""
    del blind
    flags = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
    if not mode.is_automatic:
        flags |= dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    elif mode is not Mode.GUIDED:
        flags |= dialect.MAV_MODE_FLAG_AUTO_ENABLED | dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    return int(flags | dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else flags)


def ardupilot_base_mode(mode: Mode, *, armed: bool, blind: bool = False) -> int:
    """Return an ArduCopter's HEARTBEAT.base_mode: never "auto", and "guided" where a position is controlled."""
    flags = (
        dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
        | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    if mode is not Mode.STABILIZE and not blind:
        flags |= dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    return int(flags | dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else flags)
