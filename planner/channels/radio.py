"""The port that every kind of channel fills: the mean power gain of a link, and what bounds need to know of it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from math import inf
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from skyfolio.planner.arrays import Array
from skyfolio.planner.channels.antennas import Antenna
from skyfolio.planner.channels.excess import Excess
from skyfolio.planner.parts import Frozen, Identifier, Point, left_out

Fading = Literal["mean", "sampled", "held", "expected"]
"""The small-scale gain of a link: its mean, drawn in every slot, or drawn once and held."""
Decibels = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100, le=100)]
Corrected = Annotated[str, Field(strict=True, pattern=r"^(\*|[A-Za-z0-9][A-Za-z0-9._-]{0,63})$")]
"""A user, or `*`."""
Carrier = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e8, le=1e11)]
Places = tuple[Array, Array]
"""Of users and of UAVs, (..., 2) metres east/north."""
LIGHT_MPS = 299_792_458.0
THERMAL_DBM_PER_HZ = -174.0
"""k T at 290 K, to a hundredth."""
NOISE_DBM = -80.0


class RadioChannel(Frozen):
    """What all kinds of channels have: noise, fading about the mean gain, corrections, the antenna of the UAVs.

    `noise_dbm` is what a user receives of noise, or `noise_figure_db` that of its receiver: then noise is -174 dBm/Hz
    and the noise figure over the band of each UAV; its users receive their shares of power and noise alike.
    `fading="mean"` sets the small-scale gain |h|^2 to 1; `"sampled"` draws it per (uav, user, slot) from `seed`;
    `"held"` draws it once per (uav, user), for all slots. `"expected"` is for planners that know the statistics and not
    the draws: a rate is the mean of the rates over `draws` draws from `seed` (only then has `draws` a meaning).
    `corrections_db`: by UAV and user, by how much a link is better than this model says, as measured in flight
    (`corrections.py`); `*` stands for all users whom a UAV's row does not name; 0 where nothing is said.
    """

    noise_dbm: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-250, le=100)] | None = Field(
        default=NOISE_DBM, exclude_if=lambda value: value is None
    )
    rician_k_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-100, le=100)] = 3.0
    fading: Fading = "mean"
    draws: Annotated[int, Field(strict=True, ge=1, le=256)] = 64
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = 0
    corrections_db: dict[Identifier, dict[Corrected, Decibels]] = Field(
        default_factory=dict, exclude_if=lambda value: not value
    )
    noise_figure_db: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=50)] | None = left_out(
        "Of users' receivers, dB; instead of `noise_dbm`."
    )
    antenna: Antenna | None = left_out("The pattern of the UAVs' antennas; without it, alike in all directions.")

    @model_validator(mode="before")
    @classmethod
    def _one_noise(cls, given: Any) -> Any:
        if not isinstance(given, Mapping) or given.get("noise_figure_db") is None:
            return given
        if given.get("noise_dbm") is not None:
            raise ValueError("noise_figure_db: noise is given by noise_dbm or by noise_figure_db, not by both")
        return {**given, "noise_dbm": None}

    @model_validator(mode="after")
    def _some_noise(self) -> Self:
        if self.noise_dbm is None and self.noise_figure_db is None:
            raise ValueError("noise_dbm: a channel needs noise_dbm or noise_figure_db")
        return self

    @abstractmethod
    def power_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:
        """Return the mean power gain of links between antennas that are alike in all directions, fading aside.

        away_m: distances over ground; distance_m: in space; height_m: of the UAV over the user; of one shape. With the
        two others kept, it must not rise with either distance, nor fall with the height: bounds build on that.
        """
        raise NotImplementedError

    @property
    def counts_hills(self) -> bool:
        """Whether a hill between UAV and user costs anything; if so, the two methods that follow say what."""
        return False

    def excess(self, user_m: Array, uav_m: Array, height_m: Array) -> Array | None:  # noqa: ARG002
        """Return by what links differ from `power_gain` because of where their ends are; None where by nothing.

        user_m, uav_m: (..., 2), metres east/north; height_m: (...), of UAVs over users; of shapes that broadcast.
        """
        return None

    def tables(self, altitude_m: Array, user_m: Array) -> Excess | None:  # noqa: ARG002
        """Return the same for optimisers: for UAVs at altitudes (U,) and users (K, S, 2), metres."""
        return None

    def refusal_of_area(self, area_m: tuple[Point, Point]) -> str | None:  # noqa: ARG002
        """Return why UAVs cannot fly in an area with this kind, or None."""
        return None

    def hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array, edge: Array) -> Array:
        """Return the gain where the ground reaches into the line of sight by `edge` (`ground.hidden`), m^(1/2).

        It is never more than `power_gain` of the same link.
        """
        raise NotImplementedError

    def least_hidden_gain(self, away_m: Array, distance_m: Array, height_m: Array) -> Array:
        """Return what remains behind any hill at least; as monotone as `power_gain`."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        """The kind, as scenarios name it."""
        return str(getattr(self, "kind", "rician"))

    @property
    def is_inverse_square(self) -> bool:
        """Whether the gain is `reference_gain` over the squared distance, as in the letter."""
        return False

    @property
    def heights_m(self) -> tuple[float, float]:
        """For which heights of a UAV over users the kind is defined."""
        return 0.0, inf

    @property
    def reference_gain(self) -> float:
        """The gain at one metre of the inverse square of which `factor` is the multiple."""
        return 1.0

    def factor(
        self, away_m: Array, height_m: Array, edge: Array | None = None, places_m: Places | None = None
    ) -> Array:
        """Return the gain as a multiple of `reference_gain / d^2`, with the antenna; fading aside.

        away_m: distances over ground, height_m: heights over users, metres, of one shape. edge: of hills, or None.
        places_m: of users and of UAVs, of shapes that broadcast; without them, `excess` is left out.
        """
        squared = away_m**2 + height_m**2
        link = away_m, np.sqrt(squared), self.known_height_m(height_m)
        gain = self.power_gain(*link) if edge is None else self.hidden_gain(*link, edge)
        if self.antenna is not None:
            gain = gain * self.antenna.gain(np.arctan2(height_m, away_m))
        if places_m is not None:
            excess = self.excess(*places_m, height_m)
            gain = gain if excess is None else gain * excess
        factor: Array = gain * squared / self.reference_gain
        return factor

    def gain_at(
        self, away_m: float, height_m: float, edge: Array | None = None, places_m: Places | None = None
    ) -> float:
        """Return the mean power gain of one link, with the antenna. Metres, over ground and over the user."""
        link = np.array([away_m]), np.array([height_m])
        factor = self.factor(*link, None if edge is None else edge.reshape(1), places_m)[0]
        return float(self.reference_gain * factor / (away_m**2 + height_m**2))

    def gain_bounds(
        self,
        least_away2: Array,
        most_away2: Array,
        near2: Array,
        far2: Array,
        lowest_m: Array,
        highest_m: Array,
        *,
        hills: bool = False,
    ) -> tuple[Array, Array]:
        """Return the greatest and the least gain over `reference_gain`, for links that vary between these limits.

        least_away2, most_away2: squared distances over ground, near2, far2: in space, m^2; lowest_m, highest_m: heights
        over the user. Each limit counts by itself. hills: whether some may be in the way.
        """
        shapes = np.broadcast_arrays(least_away2, most_away2, near2, far2, lowest_m, highest_m)
        least_away, most_away, near2, far2, lowest_m, highest_m = (np.asarray(one) for one in shapes)
        least_away, most_away = np.sqrt(least_away), np.sqrt(most_away)
        low, high = self.known_height_m(lowest_m), self.known_height_m(highest_m)
        most = self.power_gain(least_away, np.sqrt(near2), high)
        remaining = self.least_hidden_gain if hills and self.counts_hills else self.power_gain
        least = remaining(most_away, np.sqrt(far2), low)
        if self.antenna is not None:
            angles = [np.arctan2(h, away) for h in (lowest_m, highest_m) for away in (least_away, most_away)]
            strongest, weakest = self.antenna.gain_bounds(np.min(angles, axis=0), np.max(angles, axis=0))
            most, least = most * strongest, least * weakest
        return most / self.reference_gain * (1.0 + 1e-12), least / self.reference_gain * (1.0 - 1e-12)

    def known_height_m(self, height_m: Array) -> Array:
        """Return the heights within those for which the kind is defined: over hills a link has its nearest one."""
        clipped: Array = height_m if self.heights_m == (0.0, inf) else np.clip(height_m, *self.heights_m)
        return clipped

    def noise_w(self, bandwidth_hz: Array) -> Array:
        """Return the noise in the bands of UAVs: (U,) W."""
        if self.noise_figure_db is not None:
            figure: Array = 10.0 ** ((THERMAL_DBM_PER_HZ + self.noise_figure_db) / 10 - 3) * bandwidth_hz
            return figure
        assert self.noise_dbm is not None  # noqa: S101 - one of them is given
        return np.full(len(bandwidth_hz), 10 ** (self.noise_dbm / 10 - 3))

    def refusal_of_heights(self, low_m: float, high_m: float) -> str | None:
        """Return why a UAV cannot fly between these heights with this kind, or None."""
        least, most = self.heights_m
        if least <= low_m and high_m <= most:
            return None
        return f"the channel {self.name!r} is defined for altitudes of {least:g} to {most:g} m"


def free_space_gain(carrier_hz: float, distance_m: Array) -> Array:
    """Return Friis' gain between isotropic antennas (lambda / (4 pi d))^2."""
    gain: Array = (LIGHT_MPS / (4.0 * np.pi * carrier_hz * distance_m)) ** 2
    return gain
