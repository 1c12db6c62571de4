"""3GPP TR 36.777 V15.0.0, annex B: aerial UEs and terrestrial cells, tables B-1 (line of sight) and B-2 (path loss).

The roles are exchanged here, and paths are the same both ways: `h_UT` is the height of the UAV, which carries the cell.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.radio import Carrier
from skyfolio.planner.channels.sight import SightChannel

Environment = Literal["UMa-AV", "UMi-AV", "RMa-AV"]
HEIGHTS_M: dict[str, tuple[float, float]] = {"UMa-AV": (22.5, 300.0), "UMi-AV": (22.5, 300.0), "RMa-AV": (10.0, 300.0)}
ALWAYS_ABOVE_M: dict[str, float] = {"UMa-AV": 100.0, "UMi-AV": np.inf, "RMa-AV": 40.0}
"""Above that there is always line of sight."""
LEAST_M = 18.0
"""Within that distance over ground at least there is line of sight."""


class Aerial3gpp(SightChannel):
    """`kind: 3gpp_uav`: urban macro, urban micro or rural macro cells, by the height of the UAV.

    The gain is the mean of those with and without line of sight, by their probabilities; shadowing is not drawn.
    """

    kind: Literal["3gpp_uav"] = "3gpp_uav"
    carrier_hz: Carrier = 2e9
    environment: Environment = "UMa-AV"

    @property
    def heights_m(self) -> tuple[float, float]:
        """The heights for which the tables have the formulas used here."""
        return HEIGHTS_M[self.environment]

    def los_probability(self, away_m: Array, height_m: Array) -> Array:
        """Return the probability of line of sight, table B-1."""
        log_h = np.log10(height_m)
        if self.environment == "UMa-AV":
            p1, d1 = 4300.0 * log_h - 3800.0, np.maximum(460.0 * log_h - 700.0, LEAST_M)
        elif self.environment == "UMi-AV":
            p1, d1 = 233.98 * log_h - 0.95, np.maximum(294.05 * log_h - 432.94, LEAST_M)
        else:
            p1 = np.maximum(15021.0 * log_h - 16053.0, 1000.0)
            d1 = np.maximum(1350.8 * log_h - 1602.0, LEAST_M)
        share = d1 / np.maximum(away_m, d1)
        beyond = share + np.exp(-away_m / p1) * (1.0 - share)
        probability: Array = np.where(height_m > ALWAYS_ABOVE_M[self.environment], 1.0, beyond)
        return probability

    def losses_db(self, distance_m: Array, height_m: Array) -> tuple[Array, Array]:
        """Return the path loss with and without line of sight, table B-2."""
        log_h, log_d, ghz = np.log10(height_m), np.log10(np.maximum(distance_m, 1.0)), self.carrier_hz / 1e9
        log_f, from_1m_db = 20.0 * np.log10(ghz), 20.0 * np.log10(40.0 * np.pi * ghz / 3.0)
        if self.environment == "UMa-AV":
            los = 28.0 + 22.0 * log_d + log_f
            nlos = -17.5 + (46.0 - 7.0 * log_h) * log_d + from_1m_db
        elif self.environment == "UMi-AV":
            los = np.maximum(from_1m_db + 20.0 * log_d, 30.9 + (22.25 - 0.5 * log_h) * log_d + log_f)
            nlos = 32.4 + (43.2 - 7.6 * log_h) * log_d + log_f
        else:
            los = np.maximum(23.9 - 1.8 * log_h, 20.0) * log_d + from_1m_db
            nlos = -12.0 + (35.0 - 5.3 * log_h) * log_d + from_1m_db
        return los, np.maximum(los, nlos)

    def least_hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:  # noqa: ARG002
        """Return the gain without line of sight."""
        gain: Array = 10.0 ** (-self.losses_db(distance_m, height_m)[1] / 10.0)
        return gain

    def power_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:
        """Return the mean gain."""
        probability = self.los_probability(away_m, height_m)
        los_db, nlos_db = self.losses_db(distance_m, height_m)
        gain: Array = probability * 10.0 ** (-los_db / 10.0) + (1.0 - probability) * 10.0 ** (-nlos_db / 10.0)
        return gain
