"""Patterns of the antennas that UAVs carry: alike around the vertical axis, as UAVs may fly with any heading."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from skyfolio.planner.arrays import Array
from skyfolio.planner.parts import Frozen

Degrees = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=180)]


class Pattern(Frozen):
    """A pattern: its gain falls on both sides of one angle. Angles are below the horizon; straight down is pi/2."""

    @property
    @abstractmethod
    def peak_rad(self) -> float:
        """Where the gain is greatest."""

    @abstractmethod
    def gain(self, below_rad: Array) -> Array:
        """Return the power gain over an isotropic antenna at angles below the horizon, -pi/2 to pi/2. Above 0."""

    def gain_bounds(self, low_rad: Array, high_rad: Array) -> tuple[Array, Array]:
        """Return the greatest and the least gain between two angles each."""
        most = self.gain(np.clip(self.peak_rad, low_rad, high_rad))
        return most, np.minimum(self.gain(low_rad), self.gain(high_rad))


class Beam(Pattern):
    """A beam that looks down, 3GPP TR 36.814, table A.2.1.1-2: -min(12 ((theta - tilt) / beamwidth)^2, SLA) dB.

    tilt_deg: of the axis below the horizon; 90 is straight down. beamwidth_deg: at -3 dB. side_lobe_db: how far below
    the axis everything else is at most. gain_dbi: on the axis.
    """

    kind: Literal["beam"] = "beam"
    tilt_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-90, le=90)] = 90.0
    beamwidth_deg: Degrees = 65.0
    side_lobe_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=60)] = 20.0
    gain_dbi: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-20, le=40)] = 8.0

    @property
    def peak_rad(self) -> float:
        """The tilt."""
        return float(np.deg2rad(self.tilt_deg))

    def gain(self, below_rad: Array) -> Array:
        """Return the pattern."""
        off = (np.rad2deg(below_rad) - self.tilt_deg) / self.beamwidth_deg
        gain: Array = 10.0 ** ((self.gain_dbi - np.minimum(12.0 * off * off, self.side_lobe_db)) / 10.0)
        return gain


class Dipole(Pattern):
    """A vertical half-wave dipole, C. A. Balanis, Antenna Theory, eq. 4-84: no gain straight down.

    What airframe and ground scatter fills the null: null_db below the greatest gain, 2.15 dBi, is left there.
    """

    kind: Literal["dipole"] = "dipole"
    null_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1, le=60)] = 20.0

    @property
    def peak_rad(self) -> float:
        """The horizon."""
        return 0.0

    def gain(self, below_rad: Array) -> Array:
        """Return 1.643 (cos(pi/2 sin e) / cos e)^2, and what fills its null."""
        left = 10.0 ** (-self.null_db / 10.0)
        cos = np.maximum(np.cos(below_rad), 1e-9)
        shape = (np.cos(0.5 * np.pi * np.sin(below_rad)) / cos) ** 2
        gain: Array = 1.643 * (left + (1.0 - left) * shape)
        return gain


Antenna = Annotated[Beam | Dipole, Field(discriminator="kind")]
