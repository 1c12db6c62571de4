"""How a vehicle flies, from what its own parameters say about it."""

from __future__ import annotations

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.profile import Parameters
from skyfolio.mavlink_bridge.profiles import profile_of


def model_from_parameters(autopilot: Autopilot, parameters: Parameters) -> VehicleModel:
    """Return the model of a vehicle: from the parameters it has sent, with the autopilot's defaults for the others.

    Raises ValueError naming the field for a parameter that makes no sense (zero or negative speed or radius).
    """
    return profile_of(autopilot).model_of(parameters)
