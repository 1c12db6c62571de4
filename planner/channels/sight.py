"""What kinds have in common that tell links with line of sight from others: behind a hill there is none."""

from __future__ import annotations

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import RadioChannel


class SightChannel(RadioChannel):
    """A kind whose `least_hidden_gain` is that without line of sight."""

    @property
    def counts_hills(self) -> bool:
        """Hills are in the way."""
        return True

    def hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array, edge: Array) -> Array:
        """Return the gain without line of sight where the ground is in the way."""
        hidden = self.least_hidden_gain(away_m, distance_m, height_m)
        gain: Array = np.where(edge > 0.0, hidden, self.power_gain(away_m, distance_m, height_m))
        return gain
