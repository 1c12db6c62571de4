"""ArduCopter's parameters: names, defaults, ranges, and what they mean (ArduCopter parameter reference, 4.6)."""

import math
from collections.abc import Mapping

from skyfolio.sim.kinematics import Limits
from skyfolio.sim.parameter_store import INT8, INT16, INT32, Parameter
from skyfolio.sim.tuning import Action, FenceRule, LinkLoss, LowBattery, Tuning

ARDUCOPTER_LIMITS = Limits(
    max_speed_mps=20.0,
    cruise_speed_mps=10.0,
    acceleration_mps2=2.5,
    climb_mps=2.5,
    descend_mps=1.5,
    land_mps=0.5,
    land_slow_below_m=10.0,
    climb_acceleration_mps2=1.0,
    descend_acceleration_mps2=1.0,
    jerk_mps3=1.0,
)
"""WPNAV_* and LAND_* defaults; ArduCopter's speed is limited to 20 m/s by WPNAV_SPEED's own range."""
_ACTIONS = {0: Action.NONE, 1: Action.RETURN, 2: Action.RETURN, 3: Action.RETURN, 4: Action.RETURN, 5: Action.LAND}
_BATTERY_ACTIONS = {0: Action.WARN, 1: Action.LAND, 2: Action.RETURN, 3: Action.RETURN, 4: Action.RETURN}
_FENCE_ACTIONS = {0: Action.WARN, 1: Action.RETURN, 2: Action.LAND, 3: Action.RETURN, 4: Action.HOLD}
_CONTINUE_IN_AUTO_ON_GCS_LOSS, _CONTINUE_LANDING, _CONTINUE_FLOWN_BY_A_PILOT = 2, 8, 16
_ARM_IN_AUTO, _TAKEOFF_WITHOUT_THROTTLE = 1, 2
_CEILING, _CIRCLE, _POLYGON = 1, 2, 4


def ardupilot_parameters(limits: Limits) -> list[Parameter]:
    """Return the parameters with which an ArduCopter of these limits boots; it has speeds in cm/s."""
    return [
        Parameter("ARMING_CHECK", 1, 0, 1_048_575, INT32),
        Parameter("AUTO_OPTIONS", 0, 0, 255, INT32),
        Parameter("BATT_CAPACITY", 5000, 0, 100_000, INT32),
        Parameter("BATT_CRT_MAH", 0.0, 0.0, 100_000.0),
        Parameter("BATT_FS_CRT_ACT", 0, 0, 7, INT8),
        Parameter("BATT_FS_LOW_ACT", 0, 0, 7, INT8),
        Parameter("BATT_LOW_MAH", 0.0, 0.0, 100_000.0),
        Parameter("DISARM_DELAY", 10, 0, 127, INT8),
        Parameter("FENCE_ACTION", 1, 0, 5, INT8),
        Parameter("FENCE_ALT_MAX", 100.0, 10.0, 1000.0),
        Parameter("FENCE_ENABLE", 0, 0, 1, INT8),
        Parameter("FENCE_RADIUS", 300.0, 30.0, 10_000.0),
        Parameter("FENCE_TYPE", 7, 0, 15, INT8),
        Parameter("FS_EKF_ACTION", 1, 0, 3, INT8),
        Parameter("FS_GCS_ENABLE", 0, 0, 7, INT8),
        Parameter("FS_GCS_TIMEOUT", 5.0, 2.0, 120.0),
        Parameter("FS_OPTIONS", 16, 0, 63, INT32),
        Parameter("GUID_TIMEOUT", 3.0, 0.1, 5.0),
        Parameter("LAND_ALT_LOW", limits.land_slow_below_m * 100.0, 100.0, 10_000.0, INT16),
        Parameter("LAND_SPEED", limits.land_mps * 100.0, 30.0, 200.0, INT16),
        Parameter("MIS_RESTART", 0, 0, 1, INT8),
        Parameter("RALLY_LIMIT_KM", 0.3, 0.0, 100.0),
        Parameter("RTL_ALT", 1500, 30, 300_000, INT32),
        Parameter("RTL_CONE_SLOPE", 3.0, 0.0, 10.0),
        Parameter("RTL_LOIT_TIME", 5000, 0, 60_000, INT32),
        Parameter("SYSID_MYGCS", 255, 1, 255, INT16),
        Parameter("WPNAV_ACCEL", limits.acceleration_mps2 * 100.0, 50.0, 500.0),
        Parameter("WPNAV_ACCEL_Z", limits.climb_acceleration_mps2 * 100.0, 50.0, 500.0),
        Parameter("WPNAV_JERK", min(limits.jerk_mps3, 20.0), 1.0, 20.0),
        Parameter("WPNAV_RADIUS", 200.0, 5.0, 1000.0),
        Parameter("WPNAV_SPEED", limits.cruise_speed_mps * 100.0, 10.0, 2000.0),
        Parameter("WPNAV_SPEED_DN", limits.descend_mps * 100.0, 10.0, 500.0),
        Parameter("WPNAV_SPEED_UP", limits.climb_mps * 100.0, 10.0, 1000.0),
    ]


def ardupilot_tuning(values: Mapping[str, float]) -> Tuning:
    """Return what ArduCopter's parameters mean; it stores any number, and bounds it only where it is used."""
    return Tuning(
        limits=Limits(
            max_speed_mps=ARDUCOPTER_LIMITS.max_speed_mps,
            cruise_speed_mps=_at_least(values["WPNAV_SPEED"], 20.0) / 100.0,
            acceleration_mps2=_at_least(values["WPNAV_ACCEL"], 50.0) / 100.0,
            climb_mps=_at_least(values["WPNAV_SPEED_UP"], 10.0) / 100.0,
            descend_mps=_at_least(abs(values["WPNAV_SPEED_DN"]), 10.0) / 100.0,
            land_mps=_at_least(values["LAND_SPEED"], 30.0) / 100.0,
            land_slow_below_m=_at_least(values["LAND_ALT_LOW"], 100.0) / 100.0,
            climb_acceleration_mps2=_at_least(values["WPNAV_ACCEL_Z"], 50.0) / 100.0,
            descend_acceleration_mps2=_at_least(values["WPNAV_ACCEL_Z"], 50.0) / 100.0,
            jerk_mps3=_at_least(values["WPNAV_JERK"], 1.0),
        ),
        acceptance_radius_m=_at_least(values["WPNAV_RADIUS"], 5.0) / 100.0,
        altitude_radius_m=_at_least(values["WPNAV_RADIUS"], 5.0) / 100.0,
        takeoff_alt_m=0.0,
        return_alt_m=max(values["RTL_ALT"], 0.0) / 100.0,
        return_cone_m=0.0,
        return_loiter_s=max(values["RTL_LOIT_TIME"], 0.0) / 1000.0,
        disarm_after_landing_s=1.0,
        disarm_on_ground_s=values["DISARM_DELAY"] if values["DISARM_DELAY"] > 0 else None,
        setpoint_timeout_s=_at_least(values["GUID_TIMEOUT"], 0.1),
        battery_capacity_mah=_at_least(values["BATT_CAPACITY"], 1.0),
        arm_in_mission=bool(int(values["AUTO_OPTIONS"]) & _ARM_IN_AUTO),
        takeoff_without_throttle=bool(int(values["AUTO_OPTIONS"]) & _TAKEOFF_WITHOUT_THROTTLE),
        restart_mission=values["MIS_RESTART"] == 1,
        rally_limit_m=values["RALLY_LIMIT_KM"] * 1000.0 if values["RALLY_LIMIT_KM"] > 0.0 else math.inf,
        link_loss=LinkLoss(
            action=_ACTIONS.get(int(values["FS_GCS_ENABLE"]), Action.RETURN),
            timeout_s=_at_least(values["FS_GCS_TIMEOUT"], 2.0),
            gcs_system_id=int(values["SYSID_MYGCS"]),
            spare_mission=bool(int(values["FS_OPTIONS"]) & _CONTINUE_IN_AUTO_ON_GCS_LOSS),
            spare_landing=bool(int(values["FS_OPTIONS"]) & _CONTINUE_LANDING),
            spare_pilot=bool(int(values["FS_OPTIONS"]) & _CONTINUE_FLOWN_BY_A_PILOT),
        ),
        batteries=_batteries(values),
        position_loss=Action.NONE if values["FS_EKF_ACTION"] == 0 else Action.LAND,
        fence=_fence(values),
    )


def _batteries(values: Mapping[str, float]) -> tuple[LowBattery, ...]:
    capacity = _at_least(values["BATT_CAPACITY"], 1.0)
    levels = (
        ("BATT_LOW_MAH", "BATT_FS_LOW_ACT", "Battery 1 is low"),
        ("BATT_CRT_MAH", "BATT_FS_CRT_ACT", "Battery 1 is critical"),
    )
    return tuple(
        LowBattery(
            share=values[left] / capacity,
            action=_BATTERY_ACTIONS.get(int(values[act]), Action.DISARM),
            words=words,
        )
        for left, act, words in levels
        if values[left] > 0.0
    )


def _fence(values: Mapping[str, float]) -> FenceRule:
    if values["FENCE_ENABLE"] != 1:
        return FenceRule(shapes=False)
    kinds = int(values["FENCE_TYPE"])
    return FenceRule(
        action=_FENCE_ACTIONS.get(int(values["FENCE_ACTION"]), Action.RETURN),
        radius_m=values["FENCE_RADIUS"] if kinds & _CIRCLE else math.inf,
        ceiling_m=values["FENCE_ALT_MAX"] if kinds & _CEILING else math.inf,
        shapes=bool(kinds & _POLYGON),
    )


def _at_least(value: float, least: float) -> float:
    return max(value, least)
