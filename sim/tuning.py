"""What parameters mean to the rest of the vehicle, whatever their names on an autopilot.

Each flavour's table turns its parameters into one `Tuning`, anew whenever a parameter is set, so that a parameter is
live: the next step flies, and the next failsafe acts, by the new value.
"""

import math
from dataclasses import dataclass, field
from enum import Enum, auto

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.kinematics import Limits


class Action(Enum):
    """What a failsafe does."""

    NONE = auto()
    WARN = auto()
    HOLD = auto()
    RETURN = auto()
    LAND = auto()
    DISARM = auto()


class Breach(Enum):
    """Which part of the fence is broken."""

    CEILING = auto()
    RADIUS = auto()
    SHAPES = auto()


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkLoss:
    """What to do `timeout_s` seconds after the ground station's last HEARTBEAT.

    `gcs_system_id` None accepts any ground station. `spare_mission`, `spare_landing`, `spare_pilot`: go on with a
    mission, a landing, or in a mode that a pilot flies instead.
    """

    action: Action = Action.NONE
    timeout_s: float = 10.0
    gcs_system_id: int | None = None
    spare_mission: bool = False
    spare_landing: bool = False
    spare_pilot: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class LowBattery:
    """One battery level: act once the charge left falls below `share` (0-1), and send `words`.

    `last`: there is no level below.
    """

    share: float
    action: Action
    words: str
    severity: int = dialect.MAV_SEVERITY_CRITICAL
    last: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class FenceRule:
    """The fence: the action at a breach, and a cylinder around home beside the uploaded shapes (infinite: none)."""

    action: Action = Action.NONE
    radius_m: float = math.inf
    ceiling_m: float = math.inf
    shapes: bool = True

    @property
    def needs_position(self) -> bool:
        """Whether a circle or a shape is to be kept, which takes a position."""
        return self.action is not Action.NONE and (self.shapes or self.radius_m < math.inf)


@dataclass(frozen=True, kw_only=True, slots=True)
class Tuning:
    """Everything by which a vehicle flies, in metres, seconds and m/s; altitudes are above home.

    acceptance_radius_m, altitude_radius_m: when a waypoint counts as reached. return_alt_m: least altitude of a way
    home longer than `return_cone_m`; `return_loiter_s`: stay over home before landing. disarm_after_landing_s and
    disarm_on_ground_s (armed, never took off): None never. arm_in_mission, takeoff_without_throttle: ArduPilot's
    AUTO_OPTIONS. failsafe_delay_s: how long a failsafe holds before it acts. first_waypoint_m: a mission that
    begins further from home is not flown. failures_enabled: MAV_CMD_INJECT_FAILURE
    is obeyed. rally_limit_m: rally points further from home are not used.
    """

    limits: Limits
    acceptance_radius_m: float
    altitude_radius_m: float
    takeoff_alt_m: float
    return_alt_m: float
    return_cone_m: float
    return_loiter_s: float
    disarm_after_landing_s: float | None
    disarm_on_ground_s: float | None
    setpoint_timeout_s: float
    battery_capacity_mah: float
    arm_in_mission: bool = True
    takeoff_without_throttle: bool = True
    restart_mission: bool = False
    failures_enabled: bool = False
    rally_limit_m: float = math.inf
    link_loss: LinkLoss = field(default_factory=LinkLoss)
    batteries: tuple[LowBattery, ...] = ()
    position_loss: Action = Action.LAND
    setpoint_loss: Action = Action.HOLD
    failsafe_delay_s: float = 0.0
    first_waypoint_m: float = math.inf
    fence: FenceRule = field(default_factory=FenceRule)
