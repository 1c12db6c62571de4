"""The letter's channel, eqs. (1)-(2): free space from a reference gain at one metre, with Rician fading."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import RadioChannel
from skyfolio.planner.parts import Frozen


class _Reference(Frozen):
    reference_gain_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-200, le=100)] = -20.0


class Channel(RadioChannel, _Reference):
    """Rician air-to-ground channel, eqs. (1)-(2): `reference_gain_db` at one metre, over the squared distance."""

    kind: Literal["rician"] = Field(default="rician", exclude_if=lambda value: value == "rician")

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
