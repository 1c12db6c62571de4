"""The power of rotary wings over airspeed, as arrays: expected, and at most within a gust (Zeng et al. 2019, eq. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.parts import Rotors


class Law(NamedTuple):
    """The constants of one or more UAVs, each an array that broadcasts against airspeeds; units as in `Rotors`."""

    blade_w: Array
    tip_mps: Array
    induced_w: Array
    induced_mps: Array
    parasite_w_per_mps3: Array

    def between_w(self, least_mps: Array, most_mps: Array) -> Array:
        """Return W that are never exceeded at any airspeed from `least_mps` to `most_mps`.

        Blade and parasite power grow with airspeed and induced power falls: each is taken at its worse end, which
        bounds their sum whatever the constants are. At one airspeed it is the power itself.
        """
        most2, ratio = most_mps**2, least_mps**2 / (2.0 * self.induced_mps**2)
        induced = self.induced_w * np.sqrt(np.sqrt(1.0 + ratio**2) - ratio)
        blade = self.blade_w * (1.0 + 3.0 * most2 / self.tip_mps**2)
        power: Array = blade + induced + self.parasite_w_per_mps3 * most2 * most_mps
        return power

    def expected_w(self, airspeed_mps: Array) -> Array:
        """Return the power at an airspeed, W."""
        return self.between_w(airspeed_mps, airspeed_mps)

    def worst_w(self, airspeed_mps: Array, gust_mps: float) -> Array:
        """Return W that are not exceeded while the airspeed is within `gust_mps` of the given one."""
        return self.between_w(np.maximum(airspeed_mps - gust_mps, 0.0), airspeed_mps + gust_mps)


def law_of(rotors: Sequence[Rotors]) -> Law:
    """Return the constants of some UAVs, each (U,)."""
    return Law(*(np.array([getattr(one, name) for one in rotors], dtype=float) for name in Law._fields))
