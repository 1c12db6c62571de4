"""How far a fleet flies in a slot through the wind, what that costs it, and what it needs to come home.

A UAV flies straight at constant ground speed from where it is when a slot begins to where it is when the next does.
With wind w, m/s, it can do so when its airspeed |v - w|, and that in any gust, stays within what it flies at most: the
displacements of one slot lie in a disc around w times the slot that is smaller by the gust, and in the disc of `D_max`
around 0. Both hold 0, or the UAV could not hover, so every displacement can be shortened along itself until it is in
both. Proven energy is the worst within the gust throughout; expected energy is that of the steady wind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.energy.heights import HomeHeight
from skyfolio.planner.energy.parts import Battery, RallyPoint, Rotors, Wind
from skyfolio.planner.energy.power import Law, law_of

WITHIN = 1.0 - 1e-9
"""Planned airspeeds stay this much (relatively) below the limit: rounding."""
_TINY_MPS = 1e-9


class AirUav(Protocol):
    """What is needed of a UAV."""

    @property
    def start_m(self) -> tuple[float, float]: ...  # noqa: D102
    @property
    def max_speed_mps(self) -> float: ...  # noqa: D102
    @property
    def max_airspeed_mps(self) -> float | None: ...  # noqa: D102
    @property
    def battery(self) -> Battery | None: ...  # noqa: D102
    @property
    def rotors(self) -> Rotors | None: ...  # noqa: D102
    @property
    def home_m(self) -> tuple[float, float] | None: ...  # noqa: D102


class PerMetre(NamedTuple):
    """What each metre of height costs, Wh, (U,) each.

    before_wh, expected_before_wh: higher in slot 0, of a UAV that is on the ground before it; proven and expected.
    climb_wh: of climbing on the way, beside the power of flying. landing_wh: proven, higher when it turns home.
    """

    before_wh: Array
    expected_before_wh: Array
    climb_wh: Array
    landing_wh: Array


@dataclass(frozen=True, kw_only=True)
class Air:
    """Wind and energy of a fleet of U UAVs, in SI units but for Wh.

    wind_mps: (2,). gust_mps: a bound. slot_s: seconds. speed_mps, airspeed_mps: (U,), over ground and through the air;
    the latter is infinite where nothing limits it. law: of the rotors, (U,) each. budget_wh: (U,), what may be spent
    until landed, infinite without a battery; before_wh: (U,), proven to be spent before slot 0 (what was used, or the
    climb); expected_before_wh: the same in the steady wind; landing_wh: (U,), proven to suffice from over the landing
    place to the ground. homes_m: (U, H, 2), where each may land. All of it is for `height_m`, (U,), above home.
    ground_m: (U,), altitude of the ground at home, in the datum of a plan's altitudes. per_m: what other heights cost.
    """

    wind_mps: Array
    gust_mps: float
    slot_s: float
    speed_mps: Array
    airspeed_mps: Array
    law: Law
    budget_wh: Array
    before_wh: Array
    expected_before_wh: Array
    landing_wh: Array
    homes_m: Array
    height_m: Array
    ground_m: Array
    per_m: PerMetre

    @property
    def has_wind(self) -> bool:
        """Whether air limits how far a UAV flies, beside its `D_max`."""
        return bool(np.isfinite(self.airspeed_mps).any())

    @property
    def has_energy(self) -> bool:
        """Whether any UAV has a battery."""
        return bool(np.isfinite(self.budget_wh).any())

    @property
    def still_mps(self) -> Array:
        """How far from the wind the ground speed may be, m/s: (U,), the airspeed less the gust."""
        spare: Array = self.airspeed_mps * WITHIN - self.gust_mps
        return spare

    def of(self, uavs: Sequence[int] | NDArray[np.intp]) -> Air:
        """Return that of some UAVs."""
        few = np.asarray(uavs, dtype=np.intp)
        rows = {name: getattr(self, name)[few] for name in _PER_UAV}
        per_m = PerMetre(*(costs[few] for costs in self.per_m))
        return replace(self, law=Law(*(constants[few] for constants in self.law)), per_m=per_m, **rows)

    def without_limits(self) -> Air:
        """Return the same with batteries that never end."""
        return replace(self, budget_wh=np.full(len(self.budget_wh), np.inf))

    def and_one(self) -> Air:
        """Return that of a fleet with one UAV more, which nothing limits: the stand-in for what flies elsewhere."""
        more = self.of([*range(len(self.speed_mps)), 0])
        for array, value in ((more.airspeed_mps, np.inf), (more.budget_wh, np.inf), (more.speed_mps, 0.0)):
            array[-1] = value
        return more

    def most_spare_used_wh(self, slots: NDArray[np.intp] | int, extent_m: Array) -> Array:
        """Return a bound on what any path of so many steps costs more than hovering, and then more to come home: (U,).

        extent_m: (U,), how far at most a UAV is from its own home anywhere. Infinite where wind may keep it from home.
        """
        blows = float(np.linalg.norm(self.wind_mps))
        fastest = np.minimum(self.speed_mps + blows, np.where(self.has_wind, self.airspeed_mps, np.inf))
        worst_w = self.law.between_w(np.zeros(len(fastest)), fastest + self.gust_mps)
        slowest = np.minimum(self.speed_mps, self.still_mps - blows if self.has_wind else np.inf)
        home_s = np.where(slowest > _TINY_MPS, extent_m / np.maximum(slowest, _TINY_MPS), np.inf)
        hovering_wh = self.hover_wh() * slots
        most: Array = worst_w * (slots * self.slot_s + home_s) / 3600.0 - hovering_wh
        return most

    def longest_m(self, moves_m: Array) -> Array:
        """Return how far each UAV flies in one slot in the direction of each move (U, ..., 2): (U, ...) metres."""
        limit_mps = _over(self.speed_mps, moves_m[..., 0])
        if not self.has_wind:
            return np.broadcast_to(limit_mps, moves_m.shape[:-1]) * self.slot_s
        length = np.linalg.norm(moves_m, axis=-1)
        along = moves_m @ self.wind_mps / np.where(length > 0.0, length, 1.0)
        still2 = _over(self.still_mps, length) ** 2
        across2 = np.maximum(still2 - (self.wind_mps @ self.wind_mps) + along**2, 0.0)
        farthest: Array = np.minimum(limit_mps, np.maximum(along + np.sqrt(across2), 0.0)) * self.slot_s
        return farthest

    def spent_wh(self, moves_m: Array, *, proven: bool) -> Array:
        """Return what each slot's move (U, S, 2) costs: (U, S) Wh; proven to suffice, or expected."""
        airspeed = np.linalg.norm(moves_m / self.slot_s - self.wind_mps, axis=-1)
        law = self._law_over(airspeed)
        power = law.worst_w(airspeed, self.gust_mps) if proven else law.expected_w(airspeed)
        cost: Array = power * self.slot_s / 3600.0
        return cost

    def hover_wh(self) -> Array:
        """Return what a slot of hovering is proven to cost: (U,) Wh."""
        return self.spent_wh(np.zeros((len(self.speed_mps), 1, 2)), proven=True)[:, 0]

    def higher_m(self, altitudes_m: Array) -> Array:
        """Return how much higher above home than `height_m` altitudes (U, S) are: (U, S) metres."""
        higher: Array = altitudes_m - (self.ground_m + self.height_m)[:, None]
        return higher

    def home_wh(self, points_m: Array, altitudes_m: Array | None = None) -> Array:
        """Return what is proven to suffice from each point (U, S, 2) to the cheapest landing place: (U, S) Wh.

        It flies straight, as fast as its `max_speed_mps` and the wind allow, and lands there. Infinite where the wind
        lets it reach none. altitudes_m: (U, S), which it keeps on its way; `height_m` above home by default.
        """
        way = self.homes_m[:, None] - points_m[:, :, None]  # (U, S, H, 2)
        away = np.linalg.norm(way, axis=-1)
        speed = self.longest_m(way) / self.slot_s
        course = way / np.where(away > 0.0, away, 1.0)[..., None]
        airspeed = np.linalg.norm(course * speed[..., None] - self.wind_mps, axis=-1)
        power = self._law_over(airspeed).worst_w(airspeed, self.gust_mps)
        time_s = np.where(away > 0.0, np.where(speed > _TINY_MPS, away / np.maximum(speed, _TINY_MPS), np.inf), 0.0)
        flown: Array = (power * time_s).min(axis=-1) / 3600.0 + self.landing_wh[:, None]
        return flown if altitudes_m is None else flown + self.per_m.landing_wh[:, None] * self.higher_m(altitudes_m)

    def _law_over(self, table: Array) -> Law:
        return Law(*(_over(constants, table) for constants in self.law))


_PER_UAV = (
    "speed_mps", "airspeed_mps", "budget_wh", "before_wh", "expected_before_wh", "landing_wh", "homes_m", "height_m",
    "ground_m",
)  # fmt: skip


def _over(per_uav: Array, table: Array) -> Array:
    """Return (U,) as (U, 1, ...), to go with a table (U, ...)."""
    return per_uav.reshape(-1, *[1] * (table.ndim - 1))


def air_of(
    uavs: Sequence[AirUav],
    heights: Sequence[HomeHeight],
    wind: Wind | None,
    rally: Sequence[RallyPoint],
    slot_s: float,
) -> Air | None:
    """Return wind and energy of a fleet at these heights above home; None where it has neither."""
    if wind is None and all(uav.battery is None for uav in uavs):
        return None
    blows = wind or Wind()
    rotors = [uav.rotors or Rotors() for uav in uavs]
    law, wind_mps = law_of(rotors), np.array([blows.east_mps, blows.north_mps])
    still = np.full(len(uavs), float(np.linalg.norm(wind_mps)))
    height_m = np.array([one.height_m for one in heights], dtype=float)
    climb_mps, descend_mps = np.array([(one.climb_mps, one.descend_mps) for one in rotors]).T
    climb_s = height_m / climb_mps
    climb_wh = np.array([one.climb_w_per_mps for one in rotors]) / 3600.0
    lift_wh = np.array([one.climb_w_per_mps for one in rotors]) * height_m / 3600.0
    used_wh = np.array([np.nan if not uav.battery else _or_nan(uav.battery.used_wh) for uav in uavs])

    def before(power_w: Array) -> Array:
        return np.where(np.isnan(used_wh), power_w * climb_s / 3600.0 + lift_wh, used_wh)

    def before_per_m(power_w: Array) -> Array:
        return np.where(np.isnan(used_wh), power_w / climb_mps / 3600.0 + climb_wh, 0.0)

    worst_w, expected_w = law.worst_w(still, blows.gust_mps), law.expected_w(still)
    homes = [[uav.home_m or uav.start_m, *(point.position_m for point in rally)] for uav in uavs]
    limits = [np.inf if wind is None else _airspeed(uav) for uav in uavs]
    return Air(
        wind_mps=wind_mps,
        gust_mps=blows.gust_mps,
        slot_s=slot_s,
        speed_mps=np.array([uav.max_speed_mps for uav in uavs], dtype=float),
        airspeed_mps=np.array(limits, dtype=float),
        law=law,
        budget_wh=np.array([np.inf if uav.battery is None else uav.battery.budget_wh for uav in uavs]),
        before_wh=before(worst_w),
        expected_before_wh=before(expected_w),
        landing_wh=worst_w * height_m / descend_mps / 3600.0,
        homes_m=np.array(homes, dtype=float),
        height_m=height_m,
        ground_m=np.array([one.ground_m for one in heights], dtype=float),
        per_m=PerMetre(
            before_wh=before_per_m(worst_w),
            expected_before_wh=before_per_m(expected_w),
            climb_wh=climb_wh,
            landing_wh=worst_w / descend_mps / 3600.0,
        ),
    )


def _or_nan(number: float | None) -> float:
    return np.nan if number is None else number


def _airspeed(uav: AirUav) -> float:
    """Return what it flies at most through the air: where that is not given, no more than over ground."""
    return uav.max_speed_mps if uav.max_airspeed_mps is None else uav.max_airspeed_mps
