"""MAV_CMD_INJECT_FAILURE: which failures of which parts this vehicle can have (PX4, with SYS_FAILURE_EN = 1)."""

from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as dialect

if TYPE_CHECKING:
    from skyfolio.sim.autopilot import Autopilot

_GPS = dialect.FAILURE_UNIT_SENSOR_GPS
_BATTERY = dialect.FAILURE_UNIT_SYSTEM_BATTERY
_MOTOR = dialect.FAILURE_UNIT_SYSTEM_MOTOR
_LINK = dialect.FAILURE_UNIT_SYSTEM_MAVLINK_SIGNAL
_OK, _OFF = dialect.FAILURE_TYPE_OK, dialect.FAILURE_TYPE_OFF
EMPTY_SHARE = 0.04
"""What is left of a battery that is failed: less than any emergency level."""


def injected_failure(autopilot: "Autopilot", unit: int, kind: int) -> bool:
    """Let a part fail (FAILURE_TYPE_OFF) or work again (OK); False for what this vehicle cannot simulate.

    GPS: the satellites are gone. BATTERY: nearly empty. MOTOR: a quadrotor without one falls. MAVLINK_SIGNAL: the
    radio is silent and deaf, so only another means brings it back.
    """
    if (unit, kind) == (_GPS, _OFF):
        autopilot.mishaps.lose_satellites()
    elif (unit, kind) == (_GPS, _OK):
        autopilot.mishaps.regain_satellites()
    elif (unit, kind) == (_BATTERY, _OFF):
        autopilot.mishaps.set_battery(EMPTY_SHARE)
    elif (unit, kind) == (_BATTERY, _OK):
        autopilot.mishaps.set_battery(1.0)
    elif (unit, kind) == (_MOTOR, _OFF):
        autopilot.mishaps.fail_motor()
    elif (unit, kind) == (_LINK, _OFF):
        autopilot.mishaps.silence()
    else:
        return False
    return True
