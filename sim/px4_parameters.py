"""PX4's parameters: names, defaults, ranges, and what they mean (PX4 parameter reference)."""

import math
from collections.abc import Mapping
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.kinematics import Limits
from skyfolio.sim.parameter_store import Parameter
from skyfolio.sim.tuning import Action, FenceRule, LinkLoss, LowBattery, Tuning

PX4_LIMITS = Limits()
_LIMIT_OF = {
    "MPC_XY_VEL_MAX": "max_speed_mps",
    "MPC_XY_CRUISE": "cruise_speed_mps",
    "MPC_ACC_HOR": "acceleration_mps2",
    "MPC_Z_V_AUTO_UP": "climb_mps",
    "MPC_Z_V_AUTO_DN": "descend_mps",
    "MPC_LAND_SPEED": "land_mps",
    "MPC_LAND_ALT1": "land_slow_below_m",
    "MPC_ACC_UP_MAX": "climb_acceleration_mps2",
    "MPC_ACC_DOWN_MAX": "descend_acceleration_mps2",
}
_LINK_ACTIONS = {0: Action.NONE, 1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND, 5: Action.DISARM, 6: Action.DISARM}
_FENCE_ACTIONS = {
    0: Action.NONE,
    1: Action.WARN,
    2: Action.HOLD,
    3: Action.RETURN,
    4: Action.DISARM,
    5: Action.LAND,
}
_SETPOINT_LOSS = {3: Action.RETURN, 4: Action.LAND, 5: Action.HOLD, 6: Action.DISARM, 7: Action.DISARM}
"""COM_OBL_RC_ACT; 0, 1 and 2 hand the vehicle to a remote control, and without one it returns (NAV_RCL_ACT)."""


def px4_parameters(limits: Limits) -> list[Parameter]:
    """Return the parameters with which a PX4 multirotor of these limits boots."""
    own = [
        Parameter("BAT1_CAPACITY", 5000.0, -1.0, 100_000.0),
        Parameter("BAT_CRIT_THR", 0.07, 0.05, 0.5),
        Parameter("BAT_EMERGEN_THR", 0.05, 0.03, 0.5),
        Parameter("BAT_LOW_THR", 0.15, 0.12, 0.5),
        Parameter("COM_DISARM_LAND", 2.0, -1.0, 60.0),
        Parameter("COM_DISARM_PRFLT", 10.0, -1.0, 60.0),
        Parameter("COM_DL_LOSS_T", 10, 5, 300),
        Parameter("COM_FAIL_ACT_T", 5.0, 0.0, 25.0),
        Parameter("COM_LOW_BAT_ACT", 0, 0, 3),
        Parameter("COM_OBL_RC_ACT", 0, 0, 7),
        Parameter("COM_OF_LOSS_T", 1.0, 0.0, 60.0),
        Parameter("GF_ACTION", 2, 0, 5),
        Parameter("GF_MAX_HOR_DIST", 0.0, 0.0, 10_000.0),
        Parameter("GF_MAX_VER_DIST", 0.0, 0.0, 10_000.0),
        Parameter("MAV_TYPE", 2, 0, 22),
        Parameter("MIS_DIST_1WP", 10_000.0, -1.0, 100_000.0),
        Parameter("MIS_TAKEOFF_ALT", 2.5, 0.0, 500.0),
        Parameter("MPC_Z_VEL_MAX_DN", max(limits.descend_mps, limits.land_mps), 0.5, 10.0),
        Parameter("MPC_Z_VEL_MAX_UP", limits.climb_mps, 0.5, 10.0),
        Parameter("NAV_ACC_RAD", 2.0, 0.05, 200.0),
        Parameter("NAV_DLL_ACT", 0, 0, 6),
        Parameter("NAV_MC_ALT_RAD", 0.8, 0.05, 200.0),
        Parameter("RTL_LAND_DELAY", 0.0, -1.0, 10_000.0),
        Parameter("RTL_MIN_DIST", 5.0, 0.5, 100.0),
        Parameter("RTL_RETURN_ALT", 30.0, 0.0, 500.0),
        Parameter("SYS_FAILURE_EN", 0, 0, 1),
    ]
    tuned = [Parameter(name, getattr(limits, attribute), 0.01, 100.0) for name, attribute in _LIMIT_OF.items()]
    return own + tuned


def px4_tuning(values: Mapping[str, float]) -> Tuning:
    """Return what PX4's parameters mean."""
    limits = Limits(**{attribute: values[name] for name, attribute in _LIMIT_OF.items()})
    return Tuning(
        limits=replace(
            limits,
            climb_mps=min(limits.climb_mps, values["MPC_Z_VEL_MAX_UP"]),
            descend_mps=min(limits.descend_mps, values["MPC_Z_VEL_MAX_DN"]),
        ),
        acceptance_radius_m=values["NAV_ACC_RAD"],
        altitude_radius_m=values["NAV_MC_ALT_RAD"],
        takeoff_alt_m=values["MIS_TAKEOFF_ALT"],
        return_alt_m=values["RTL_RETURN_ALT"],
        return_cone_m=values["RTL_MIN_DIST"],
        return_loiter_s=values["RTL_LAND_DELAY"] if values["RTL_LAND_DELAY"] >= 0.0 else math.inf,
        disarm_after_landing_s=_unless_negative(values["COM_DISARM_LAND"]),
        disarm_on_ground_s=values["COM_DISARM_PRFLT"] if values["COM_DISARM_PRFLT"] > 0.0 else None,
        setpoint_timeout_s=values["COM_OF_LOSS_T"],
        battery_capacity_mah=max(values["BAT1_CAPACITY"], 1.0),
        failures_enabled=values["SYS_FAILURE_EN"] == 1,
        link_loss=LinkLoss(
            action=_LINK_ACTIONS.get(int(values["NAV_DLL_ACT"]), Action.NONE),
            timeout_s=values["COM_DL_LOSS_T"],
        ),
        batteries=_batteries(values),
        setpoint_loss=_SETPOINT_LOSS.get(int(values["COM_OBL_RC_ACT"]), Action.RETURN),
        first_waypoint_m=values["MIS_DIST_1WP"] if values["MIS_DIST_1WP"] > 0.0 else math.inf,
        failsafe_delay_s=values["COM_FAIL_ACT_T"],
        fence=FenceRule(
            action=_FENCE_ACTIONS.get(int(values["GF_ACTION"]), Action.NONE),
            radius_m=values["GF_MAX_HOR_DIST"] or math.inf,
            ceiling_m=values["GF_MAX_VER_DIST"] or math.inf,
        ),
    )


def _batteries(values: Mapping[str, float]) -> tuple[LowBattery, ...]:
    """Return the levels of COM_LOW_BAT_ACT: 0 warns; 2 lands when critical; 3 returns, and lands in an emergency."""
    act = int(values["COM_LOW_BAT_ACT"])
    critical = {2: Action.LAND, 3: Action.RETURN}.get(act, Action.WARN)
    emergency = Action.LAND if act in (2, 3) else Action.WARN
    return (
        LowBattery(share=values["BAT_LOW_THR"], action=Action.WARN, words="Low battery\t"),
        LowBattery(share=values["BAT_CRIT_THR"], action=critical, words="Critical battery\t"),
        LowBattery(
            share=values["BAT_EMERGEN_THR"],
            action=emergency,
            words="Emergency battery level\t",
            severity=dialect.MAV_SEVERITY_EMERGENCY,
            last=True,
        ),
    )


def _unless_negative(value: float) -> float | None:
    return value if value >= 0.0 else None
