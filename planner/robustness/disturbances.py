"""What a plan does not know: the channel's fading, the wind, and where UAVs really are."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import fading_gains
from skyfolio.planner.scenario import Frozen, Scenario

Metres = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1000)]
Speed = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=50)]
RAYLEIGH_MEAN = float(np.sqrt(np.pi / 2))
"""The mean of a Rayleigh distribution of scale 1."""


class Disturbances(Frozen):
    """What is drawn, and how often.

    fading: Rician gains of every UAV, user and slot (eq. 2) with the scenario's factor, even where the plan was made
    for the mean channel; False keeps the channel of the plan. position_noise_m: standard deviation of a UAV's position
    error on each axis; it changes slowly, as errors of satellite navigation do, with the time constant
    position_noise_s (first-order Gauss-Markov). wind_mps: the mean speed of a wind that is steady over the operation,
    Rayleigh, from any direction; gust_mps: standard deviation of each UAV's gusts on each axis, new in every slot.
    pushed_s: how many metres a UAV is off its path for each m/s of wind.
    """

    draws: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 200
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**31)] = 0
    fading: bool = True
    position_noise_m: Metres = 1.0
    position_noise_s: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=100_000)] = 30.0
    wind_mps: Speed = 5.0
    gust_mps: Speed = 1.5
    pushed_s: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10)] = 0.2

    def gains(self, scenario: Scenario, first_slot: int, draw: int) -> Array:
        """Return |h|^2 of this draw: (U, K, N), mean 1. first_slot: of the plan on the operation's grid."""
        channel = scenario.channel
        if self.fading:
            seed = int(np.random.default_rng((self.seed, draw, 0)).integers(2**62))
            channel = channel.model_copy(update={"fading": "sampled", "seed": seed})
        return fading_gains(channel, scenario.uav_ids, scenario.user_ids, first_slot, scenario.slots)

    def errors_m(self, scenario: Scenario, draw: int) -> Array:
        """Return how far each UAV is off its path in each slot of this draw: (U, N, 2) metres east/north."""
        rng = np.random.default_rng((self.seed, draw, 1))
        shape = (len(scenario.uavs), scenario.slots, 2)
        speed, direction = rng.rayleigh(self.wind_mps / RAYLEIGH_MEAN), rng.uniform(0.0, 2 * np.pi)
        wind_mps = speed * np.array([np.cos(direction), np.sin(direction)]) + self.gust_mps * rng.normal(size=shape)
        errors: Array = self.pushed_s * wind_mps + self._position_errors(
            rng.normal(size=shape), scenario.slot_duration_s
        )
        return errors

    def _position_errors(self, shocks: Array, slot_s: float) -> Array:
        """Return first-order Gauss-Markov errors, stationary from the first slot on: (U, N, 2) metres."""
        kept = float(np.exp(-slot_s / self.position_noise_s))
        errors = shocks * self.position_noise_m
        fresh = np.sqrt(1.0 - kept**2)
        for n in range(1, errors.shape[1]):
            errors[:, n] = kept * errors[:, n - 1] + fresh * errors[:, n]
        return errors
