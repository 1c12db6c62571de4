"""Line of sight by the angle of elevation.

A. Al-Hourani, S. Kandeepan, S. Lardner, "Optimal LAP Altitude for Maximum Coverage", IEEE Wireless Communications
Letters 3(6), 2014.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import Carrier, free_space_gain
from skyfolio.planner.channels.sight import SightChannel

Environment = Literal["suburban", "urban", "dense_urban", "highrise"]


class Surroundings(NamedTuple):
    """a, b of eq. (5); excess losses with and without line of sight, dB."""

    a: float
    b: float
    los_db: float
    nlos_db: float


SURROUNDINGS: dict[str, Surroundings] = {
    "suburban": Surroundings(4.88, 0.43, 0.1, 21.0),
    "urban": Surroundings(9.61, 0.16, 1.0, 20.0),
    "dense_urban": Surroundings(12.08, 0.11, 1.6, 23.0),
    "highrise": Surroundings(27.23, 0.08, 2.3, 34.0),
}
"""Excess losses at 2 GHz: table II of the source; a and b: as commonly tabulated for its fig. 2."""
Loss = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=100)]


class LosProbability(SightChannel):
    """`kind: los_probability`: the mean path loss of eqs. (5)-(8), free space and an excess by line of sight.

    environment: gives `excess_los_db` and `excess_nlos_db` where they are not given; they hold at 2 GHz. The loss is
    the mean of both in dB, as in the source.
    """

    kind: Literal["los_probability"] = "los_probability"
    carrier_hz: Carrier = 2e9
    environment: Environment = "urban"
    excess_los_db: Loss | None = Field(default=None, exclude_if=lambda value: value is None)
    excess_nlos_db: Loss | None = Field(default=None, exclude_if=lambda value: value is None)

    def los_probability(self, away_m: Array, height_m: Array) -> Array:
        """Return 1 / (1 + a exp(-b (theta - a))), theta the elevation of the UAV in degrees."""
        around = SURROUNDINGS[self.environment]
        theta = np.rad2deg(np.arctan2(height_m, away_m))
        probability: Array = 1.0 / (1.0 + around.a * np.exp(-around.b * (theta - around.a)))
        return probability

    def excess_db(self) -> tuple[float, float]:
        """Return the excess losses with and without line of sight."""
        around = SURROUNDINGS[self.environment]
        los = around.los_db if self.excess_los_db is None else self.excess_los_db
        nlos = around.nlos_db if self.excess_nlos_db is None else self.excess_nlos_db
        return los, max(los, nlos)

    def least_hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:  # noqa: ARG002
        """Return the gain without line of sight."""
        gain: Array = free_space_gain(self.carrier_hz, distance_m) * 10.0 ** (-self.excess_db()[1] / 10.0)
        return gain

    def power_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:
        """Return the gain of the mean loss."""
        los, nlos = self.excess_db()
        excess = nlos - (nlos - los) * self.los_probability(away_m, height_m)
        gain: Array = free_space_gain(self.carrier_hz, distance_m) * 10.0 ** (-excess / 10.0)
        return gain
