"""The rotors of a vehicle, fitted to the power and velocity that it has reported in flight."""

from __future__ import annotations

from math import hypot

import numpy as np
from pydantic import BaseModel

from skyfolio.api.common.errors import ConflictError
from skyfolio.mavlink_bridge import FleetLink
from skyfolio.planner.energy.fit import LEAST_SAMPLES, fit_rotors
from skyfolio.planner.scenario import Rotors, Wind

STEEPEST_MPS = 0.2
"""Samples of a descent faster than this are left out: the law has no term for it."""


class RotorFit(BaseModel):
    """Rotors as a scenario takes them, fitted to `samples` reports of this vehicle, which differ by `rms_w` watts.

    The fit is good between the airspeeds `least_mps` and `most_mps`; beyond them it is the shape of the law.
    """

    uav_id: str
    rotors: Rotors
    samples: int
    rms_w: float
    least_mps: float
    most_mps: float


def rotors_of(link: FleetLink, uav_id: str, system_id: int, wind: Wind) -> RotorFit:
    """Return the fit of a vehicle in a steady wind. Raises ConflictError while it has not flown and reported enough."""
    kept = [one for one in link.power_samples(system_id) if one.up_mps >= -STEEPEST_MPS]
    if len(kept) < LEAST_SAMPLES:
        raise ConflictError(
            f"uav_id: {uav_id!r} has reported its power in flight {len(kept)} times; a fit takes {LEAST_SAMPLES}"
        )
    power, east, north, climb = np.array(kept).T
    airspeed = np.array([hypot(e - wind.east_mps, n - wind.north_mps) for e, n in zip(east, north, strict=True)])
    fit = fit_rotors(airspeed, climb, power)
    return RotorFit(
        uav_id=uav_id,
        rotors=fit.rotors,
        samples=fit.samples,
        rms_w=round(fit.rms_w, 2),
        least_mps=round(fit.least_mps, 2),
        most_mps=round(fit.most_mps, 2),
    )
