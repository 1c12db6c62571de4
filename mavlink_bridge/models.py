"""What a vehicle's own parameters say about how it flies: the constants of its `VehicleModel`."""

from __future__ import annotations

from collections.abc import Mapping

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.pace import VehicleModel

_DEPARTURE_SHARE = 0.6
"""PX4 waits for a vehicle that lags behind its setpoint: from rest, so much of MPC_ACC_HOR is left (measured, 1.18)."""
PX4 = VehicleModel(jerk_from_rest_mps3=4.0, departure_mps2=1.8)
"""PX4 with its default parameters."""

ARDUCOPTER = VehicleModel(
    acceleration_mps2=2.5,
    braking_mps2=2.0,
    max_speed_mps=15.0,
    acceptance_radius_m=2.0,
    jerk_mps3=1.0,
    cruise_mps=10.0,
    rests_in_plan=True,
    settle_s=2.2,
    hold_step_s=1.0,
)
"""ArduCopter 4.x with its default parameters; settling measured in software-in-the-loop."""

DEFAULTS = {Autopilot.PX4: PX4, Autopilot.ARDUPILOT: ARDUCOPTER}

_BRAKING_SHARE = 0.8
"""Stops and corners are planned with less than the acceleration limit, so that wind does not make them late."""
_LEAST_MPS2 = 0.1
_LEAST_MPS3 = 0.5
"""The least MPC_JERK_AUTO there is; WPNAV_JERK begins at 1."""
_COPTER_SPEED_FACTOR = 1.5
"""ArduCopter flies DO_CHANGE_SPEED above WP_SPD; beyond this factor its corners and stops grow out of proportion."""

Parameters = Mapping[str, float]


def _px4(parameters: Parameters) -> VehicleModel:
    acceleration = max(parameters.get("MPC_ACC_HOR", PX4.acceleration_mps2), _LEAST_MPS2)
    return VehicleModel(
        acceleration_mps2=acceleration,
        braking_mps2=round(_BRAKING_SHARE * acceleration, 6),
        max_speed_mps=parameters.get("MPC_XY_VEL_MAX", PX4.max_speed_mps),
        jerk_from_rest_mps3=max(parameters.get("MPC_JERK_AUTO", PX4.jerk_from_rest_mps3), _LEAST_MPS3),
        departure_mps2=round(_DEPARTURE_SHARE * acceleration, 6),
        cruise_mps=parameters.get("MPC_XY_CRUISE", PX4.cruise_mps),
        acceptance_radius_m=PX4.acceptance_radius_m,  # sent with each waypoint, so NAV_ACC_RAD does not matter
    )


def _arducopter(parameters: Parameters) -> VehicleModel:
    """Names and units changed in 4.7: WPNAV_* are centimetres, WP_* metres."""
    acceleration = max(_metres(parameters, "WP_ACC", "WPNAV_ACCEL", ARDUCOPTER.acceleration_mps2), _LEAST_MPS2)
    cruise = _metres(parameters, "WP_SPD", "WPNAV_SPEED", ARDUCOPTER.cruise_mps)
    return VehicleModel(
        acceleration_mps2=acceleration,
        braking_mps2=round(_BRAKING_SHARE * acceleration, 6),
        max_speed_mps=max(cruise * _COPTER_SPEED_FACTOR, VehicleModel().min_speed_mps),
        acceptance_radius_m=_metres(parameters, "WP_RADIUS_M", "WPNAV_RADIUS", ARDUCOPTER.acceptance_radius_m),
        jerk_mps3=parameters.get("WP_JERK", parameters.get("WPNAV_JERK", ARDUCOPTER.jerk_mps3)),
        cruise_mps=cruise,
        rests_in_plan=True,
        settle_s=ARDUCOPTER.settle_s,
        hold_step_s=ARDUCOPTER.hold_step_s,
    )


def _metres(parameters: Parameters, metres: str, centimetres: str, default: float) -> float:
    if metres in parameters:
        return parameters[metres]
    return parameters[centimetres] / 100.0 if centimetres in parameters else default


_MAKERS = {Autopilot.PX4: _px4, Autopilot.ARDUPILOT: _arducopter}

MODEL_PARAMETERS = {
    Autopilot.PX4: ("MPC_ACC_HOR", "MPC_JERK_AUTO", "MPC_XY_CRUISE", "MPC_XY_VEL_MAX"),
    Autopilot.ARDUPILOT: (
        *("WP_ACC", "WP_JERK", "WP_RADIUS_M", "WP_SPD"),
        *("WPNAV_ACCEL", "WPNAV_JERK", "WPNAV_RADIUS", "WPNAV_SPEED"),
    ),
}
"""Parameters a model is made of; a vehicle knows the old or the new names, and may know none."""


def model_from_parameters(autopilot: Autopilot, parameters: Parameters) -> VehicleModel:
    """The model of a vehicle: its own parameters where it told them, the autopilot's defaults where not.

    Raises ValueError naming the field for a parameter that makes no sense (zero or negative speed or radius).
    """
    return _MAKERS[autopilot](parameters)
