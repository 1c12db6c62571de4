"""MAV_CMD_INJECT_FAILURE: which failures of which parts this vehicle can have (PX4, with SYS_FAILURE_EN = 1)."""

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.component_failures import ComponentFailures

_GPS = dialect.FAILURE_UNIT_SENSOR_GPS
_BATTERY = dialect.FAILURE_UNIT_SYSTEM_BATTERY
_MOTOR = dialect.FAILURE_UNIT_SYSTEM_MOTOR
_LINK = dialect.FAILURE_UNIT_SYSTEM_MAVLINK_SIGNAL
_OK, _OFF = dialect.FAILURE_TYPE_OK, dialect.FAILURE_TYPE_OFF
EMPTY_SHARE = 0.04
"""The charge left in a battery that has failed: less than any emergency level."""


def injected_failure(failures: ComponentFailures, unit: int, kind: int) -> bool:
    """Let a FAILURE_UNIT fail (FAILURE_TYPE_OFF) or work again (OK); return False if this vehicle cannot simulate it.

    GPS: the satellites are gone. BATTERY: it is nearly empty. MOTOR: a quadrotor without one falls. MAVLINK_SIGNAL: the
    radio neither sends nor receives, so that no message can end it.
    """
    if (unit, kind) == (_GPS, _OFF):
        failures.lose_satellites()
    elif (unit, kind) == (_GPS, _OK):
        failures.regain_satellites()
    elif (unit, kind) == (_BATTERY, _OFF):
        failures.set_battery(EMPTY_SHARE)
    elif (unit, kind) == (_BATTERY, _OK):
        failures.set_battery(1.0)
    elif (unit, kind) == (_MOTOR, _OFF):
        failures.fail_motor()
    elif (unit, kind) == (_LINK, _OFF):
        failures.silence()
    else:
        return False
    return True
