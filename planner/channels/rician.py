"""The letter's channel, eqs. (1)-(2): free space from a reference gain at one metre, with Rician fading."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import LIGHT_MPS, Carrier, RadioChannel
from skyfolio.planner.parts import Frozen, left_out


class _Reference(Frozen):
    reference_gain_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-200, le=100)] = -20.0


class Channel(RadioChannel, _Reference):
    """Rician air-to-ground channel, eqs. (1)-(2): `reference_gain_db` at one metre, over the squared distance."""

    kind: Literal["rician"] = Field(default="rician", exclude_if=lambda value: value == "rician")

    carrier_hz: Carrier | None = left_out("With it, and over terrain, hills cost what diffraction at their edge does.")

    @property
    def counts_hills(self) -> bool:
        """Whether the wavelength is known that diffraction depends on."""
        return self.carrier_hz is not None

    def hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array, edge: Array) -> Array:
        """Return the gain behind the edge of the hill that reaches highest into the line of sight."""
        assert self.carrier_hz is not None  # noqa: S101 - hills do not count without
        loss_db = knife_edge_db(edge / np.sqrt(LIGHT_MPS / self.carrier_hz))
        gain: Array = self.power_gain(away_m, distance_m, height_m) * 10.0 ** (-loss_db / 10.0)
        return gain

    def least_hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:  # noqa: ARG002
        """Return nothing: diffraction has no limit."""
        return np.zeros(np.shape(distance_m))

    def power_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:  # noqa: ARG002 - in space alone
        """Return `rho / d^2`."""
        gain: Array = self.reference_gain / distance_m**2
        return gain

    @property
    def is_inverse_square(self) -> bool:
        """Whether no antenna makes it another one."""
        return self.antenna is None

    @property
    def reference_gain(self) -> float:
        """The letter's `rho`."""
        return float(10 ** (self.reference_gain_db / 10))


def knife_edge_db(v: Array) -> Array:
    """Return the loss by diffraction at one knife edge, ITU-R P.526-15, eq. (31): 0 for v of -0.78 and below."""
    above = np.maximum(v, -0.78) - 0.1
    loss: Array = np.where(v > -0.78, 6.9 + 20.0 * np.log10(np.sqrt(above * above + 1.0) + above), 0.0)
    return np.maximum(loss, 0.0)
