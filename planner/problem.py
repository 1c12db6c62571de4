"""The scenario as arrays: what every optimiser works on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import expected_gains, fading_gains, squared_distances
from skyfolio.planner.channels.bends import Bends, bends_of
from skyfolio.planner.channels.excess import Excess
from skyfolio.planner.corrections import are_of_uavs, uav_factors
from skyfolio.planner.energy.air import Air
from skyfolio.planner.heard import on_air_of
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, Scenario
from skyfolio.planner.tracks import absences_of, demands_bps, tracks_of
from skyfolio.planner.utility import utility_kbps


@dataclass(frozen=True, kw_only=True)
class Past:
    """What was flown before the plan begins: it counts in the utility and cannot be changed.

    `first_slot` is the plan's slot 0 on the operation's slot grid; `rates_bps` is (n_users, n_past_slots), bit/s, of
    the slots just before it, all or the last ones that count, NaN before a user was there. Such a slot is not in that
    user's expectation, which counts by the share of the slots in which the user was there.
    """

    first_slot: int = 0
    rates_bps: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Arrays of one planning problem; U UAVs, K users, N slots.

    start_m: (U, 2), metres east/north of the origin. user_m: (K, S, 2), where users are in each slot; S is 1 where
    none moves. spread_m2: (K, S), what is added to squared distances from there (`users.py`). step_m: (U,), `D_max`,
    metres per slot.
    altitude_m: (U,), `H`. low_m, high_m: (2,), the flying area. separation_m: `D_min`. bandwidth_hz: (U,), `B_u`.
    snr_gain: (U, K, N), `p_u rho |h_uk[n]|^2 / sigma^2` in m^2: divided by a squared distance it is an SNR (eq. 1).
    draws: (S, U, K), factors of it over which rates are averaged (`fading: "expected"`), else empty.
    past_kbps: (K, M) rates achieved before slot 0, NaN before a user was there. mu: 1/(kbit/s), at most 0. kind: the
    utility.
    n_flying: (U,), in how many slots it flies before it leaves; `snr_gain` is 0 from then on, and while it is silent.
    end_m: (U, 2), where it must be in its last slot, NaN where free. min_kbps: (K,), in every slot. discs: (D, 3),
    east, north, radius of no-fly discs; polygons: outlines (V, 2) of no-fly polygons, metres. counted_from: the first
    planned slot that counts in the utility. pinned_m: (U, N, 2), metres, where UAVs have to be, NaN for those that are
    free; pinned_to: (K, N), who has to serve each user, -1 where that is free; both empty without pins (`pins.py`).
    weight: (K,), as how many users each counts. absent: (K, N), whether it is not there, empty where all always are.
    demand_kbps: (K,), what it asks for in a slot: more is worth nothing; infinite where it has no limit.
    air: wind and energy, None without. bends: factors by which SNRs differ from `snr_gain / d^2`, None without;
    excess: others that depend on where the UAV is, None without.
    """

    start_m: Array
    user_m: Array
    spread_m2: Array
    step_m: Array
    altitude_m: Array
    low_m: Array
    high_m: Array
    separation_m: float
    bandwidth_hz: Array
    snr_gain: Array
    past_kbps: Array
    mu: float
    kind: str
    n_flying: NDArray[np.intp]
    end_m: Array
    min_kbps: Array
    discs: Array
    polygons: tuple[Array, ...] = ()
    counted_from: int = 0
    pinned_m: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    pinned_to: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.intp))
    draws: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    weight: Array
    absent: NDArray[np.bool_]
    demand_kbps: Array
    air: Air | None = None
    bends: Bends | None = None
    excess: Excess | None = None

    @cached_property
    def n_uavs(self) -> int:
        """The number of UAVs, U."""
        return len(self.start_m)

    @cached_property
    def n_users(self) -> int:
        """The number of users, K."""
        return len(self.user_m)

    @cached_property
    def n_slots(self) -> int:
        """The number of slots, N."""
        return int(self.snr_gain.shape[2])

    @cached_property
    def flying(self) -> NDArray[np.bool_]:
        """Whether each UAV flies in each slot: (U, N)."""
        there: NDArray[np.bool_] = np.arange(self.n_slots) < self.n_flying[:, None]
        return there

    def distances2(self, paths_m: Array) -> Array:
        """Return `d_uk^2[n]` of eq. (1) on these paths (U, N, 2), metres: (U, K, N) m^2."""
        return squared_distances(paths_m, self.user_m, self.altitude_m, self.spread_m2)

    def snr(self, paths_m: Array) -> Array:
        """Return the mean SNR of all links on these paths (U, N, 2), metres: (U, K, N)."""
        distances2 = self.distances2(paths_m)
        snr: Array = self.snr_gain / distances2
        if self.bends is not None:
            snr = snr * self.bends.at(self._over_ground2(distances2))
        return snr if self.excess is None else snr * self.excess.on_paths(paths_m)

    def snr_range(self, near2: Array, far2: Array, slots: NDArray[np.intp] | None = None) -> tuple[Array, Array]:
        """Return bounds of SNRs at squared distances from `near2` to `far2`, (U, K, S) m^2: an upper and a lower one.

        slots: (S,), which ones; default all. What depends on where UAVs are beyond that (`excess`) is left out.
        """
        gain = self.snr_gain if slots is None else self.snr_gain[:, :, slots]
        if self.bends is None:
            return gain / near2, gain / far2
        most, least = self.bends.gain_range(near2, far2)
        return gain * most, gain * least

    def bent(self, u: int, over2: Array) -> tuple[Array | float, Array | float]:
        """Return the factor of UAV u's SNR at squared distances over ground, m^2, and its slope in them, 1/m^2."""
        return (1.0, 0.0) if self.bends is None else self.bends.of_uav(u, over2)

    def _over_ground2(self, distances2: Array) -> Array:
        """Return squared distances over ground, users' spreads in them: (U, ...) m^2."""
        over2: Array = np.maximum(distances2 - (self.altitude_m**2).reshape(-1, *[1] * (distances2.ndim - 1)), 0.0)
        return over2

    @cached_property
    def mean_user_m(self) -> Array:
        """The mean place of each user over the slots: (K, 2) metres."""
        mean: Array = self.user_m[:, 0] if self.user_m.shape[1] == 1 else self.user_m.mean(axis=1)
        return mean

    def counted_kbps(self, rates_kbps: Array) -> Array:
        """Return the rate table that the utility counts: the past, then the planned slots that count; (K, M + ...).

        It holds NaN where a user is not there, and no more than each asks for.
        """
        planned = np.where(self.absent, np.nan, rates_kbps) if self.absent.size else rates_kbps
        if self.has_demand:
            planned = np.minimum(planned, self.demand_kbps[:, None])
        return np.hstack([self.past_kbps, planned[:, self.counted_from :]])

    def utility_kbps(self, rates_kbps: Array) -> float:
        """Return the utility of rates (K, N) in the planned slots, after the past, in kbit/s."""
        return utility_kbps(self.counted_kbps(rates_kbps), self.kind, self.mu, self.weight)

    @cached_property
    def has_demand(self) -> bool:
        """Whether any user asks for no more than some rate."""
        return bool(np.isfinite(self.demand_kbps).any())

    @cached_property
    def has_plain_users(self) -> bool:
        """Whether users stay where they are known to be, are always there, count once and take any rate."""
        stay = self.user_m.shape[1] == 1 and not self.spread_m2.any()
        return stay and not self.absent.size and not self.has_demand and bool((self.weight == 1.0).all())

    @cached_property
    def there(self) -> NDArray[np.bool_]:
        """Whether each user is there in each slot: (K, N)."""
        return ~self.absent if self.absent.size else np.ones((self.n_users, self.n_slots), dtype=bool)

    def only(self, uavs: NDArray[np.intp] | None = None, users: NDArray[np.intp] | None = None) -> Problem:
        """Return the problem of some UAVs and some users, given by their indices, as if there were no others.

        Default: all. Users who are pinned to a UAV that is left out may be served by any.
        """
        some = self if users is None else self._only_users(users)
        return some if uavs is None else some._only_uavs(uavs)

    def _only_users(self, users: NDArray[np.intp]) -> Problem:
        gain = self.snr_gain
        alike = np.broadcast_to(gain[:, :1], (len(gain), len(users), gain.shape[2]))
        return replace(
            self,
            snr_gain=alike if gain.strides[1] == 0 else gain[:, users],
            draws=self.draws[:, :, users] if self.draws.size else self.draws,
            user_m=self.user_m[users],
            spread_m2=self.spread_m2[users],
            past_kbps=self.past_kbps[users],
            min_kbps=self.min_kbps[users],
            weight=self.weight[users],
            absent=self.absent[users] if self.absent.size else self.absent,
            demand_kbps=self.demand_kbps[users],
            pinned_to=self.pinned_to[users] if self.pinned_to.size else self.pinned_to,
            excess=None if self.excess is None else self.excess.for_users(users),
        )

    def _only_uavs(self, uavs: NDArray[np.intp]) -> Problem:
        gain, number = self.snr_gain, np.full(self.n_uavs + 1, -1)
        number[uavs] = np.arange(len(uavs))  # and -1, whom any may serve, stays -1
        alike = np.broadcast_to(gain[uavs, :1], (len(uavs), *gain.shape[1:]))
        return replace(
            self,
            start_m=self.start_m[uavs],
            step_m=self.step_m[uavs],
            altitude_m=self.altitude_m[uavs],
            bandwidth_hz=self.bandwidth_hz[uavs],
            snr_gain=alike if gain.strides[1] == 0 else gain[uavs],
            draws=self.draws[:, uavs] if self.draws.size else self.draws,
            n_flying=self.n_flying[uavs],
            end_m=self.end_m[uavs],
            pinned_m=self.pinned_m[uavs] if self.pinned_m.size else self.pinned_m,
            pinned_to=number[self.pinned_to] if self.pinned_to.size else self.pinned_to,
            air=None if self.air is None else self.air.of(uavs),
            bends=None if self.bends is None else self.bends.of(uavs),
            excess=None if self.excess is None else self.excess.of(uavs),
        )

    def hover(self) -> Array:
        """Return paths on which every UAV stays at its start, which is always feasible: (U, N, 2) metres."""
        return np.repeat(self.start_m[:, None, :], self.n_slots, axis=1)


def problem_of(scenario: Scenario, past: Past | None = None) -> Problem:
    """Return the arrays of `scenario`, with the rates of `past` in user order.

    Raises ValueError when `past.rates_bps` does not have one row per user.
    """
    past = past or Past()
    n_users = len(scenario.users)
    past_kbps = np.asarray(past.rates_bps, dtype=float) / 1e3 if past.rates_bps.size else np.zeros((n_users, 0))
    if past_kbps.shape[0] != n_users:
        raise ValueError(f"past.rates_bps has {past_kbps.shape[0]} rows, but the scenario has {n_users} users")
    before = absences_of(scenario, -past_kbps.shape[1], past_kbps.shape[1])
    past_kbps = np.where(before, np.nan, past_kbps) if before.any() else past_kbps
    absent = absences_of(scenario)
    demand_kbps = demands_bps(scenario) / 1e3
    past_kbps = np.minimum(past_kbps, demand_kbps[:, None])
    excluded = scenario.utility.exclude_fixed_slots
    from_slot_0 = past_kbps.shape[1] == past.first_slot
    n_flying = np.array([scenario.last_slot(uav) + 1 for uav in scenario.uavs])
    no_end = (np.nan, np.nan)
    user_m, spread_m2 = tracks_of(scenario)
    altitude_m = np.array([scenario.altitude_of(uav) for uav in scenario.uavs], dtype=float)
    return Problem(
        start_m=np.array([uav.start_m for uav in scenario.uavs], dtype=float),
        user_m=user_m,
        spread_m2=spread_m2,
        step_m=np.array([uav.max_speed_mps * scenario.slot_duration_s for uav in scenario.uavs]),
        altitude_m=altitude_m,
        low_m=np.array(scenario.area_m[0], dtype=float),
        high_m=np.array(scenario.area_m[1], dtype=float),
        separation_m=float(scenario.min_separation_m),
        bandwidth_hz=np.array([uav.bandwidth_hz for uav in scenario.uavs], dtype=float),
        snr_gain=_snr_gain(scenario, past.first_slot),
        past_kbps=past_kbps[:, 1:] if excluded and from_slot_0 else past_kbps,
        mu=float(scenario.utility.mu_per_kbps),
        kind=scenario.utility.kind,
        n_flying=n_flying,
        end_m=np.array([uav.end_m or no_end for uav in scenario.uavs], dtype=float),
        min_kbps=np.array([user.min_rate_bps / 1e3 for user in scenario.users]),
        discs=np.array(
            [(*zone.center_m, zone.radius_m) for zone in scenario.no_fly if isinstance(zone, NoFlyDisc)], dtype=float
        ).reshape(-1, 3),
        polygons=tuple(np.array(zone.vertices_m) for zone in scenario.no_fly if isinstance(zone, NoFlyPolygon)),
        counted_from=1 if excluded and scenario.slots > 1 else 0,
        draws=_draws(scenario),
        demand_kbps=demand_kbps,
        weight=np.array([1.0 if user.weight is None else user.weight for user in scenario.users]),
        absent=absent if absent.any() else np.zeros((0, 0), dtype=bool),
        air=scenario.air,
        bends=bends_of(scenario.channel, altitude_m, _longest_m(scenario, user_m, spread_m2)),
        excess=scenario.channel.tables(altitude_m, user_m),
    )


def _longest_m(scenario: Scenario, user_m: Array, spread_m2: Array) -> float:
    """Return how far over ground a user can be from a UAV in the area, as links see it."""
    low, high = (np.array(corner, dtype=float) for corner in scenario.area_m)
    apart = np.maximum(np.abs(user_m - low), np.abs(user_m - high))
    return float(np.sqrt((apart**2).sum(axis=2) + spread_m2).max())


def _draws(scenario: Scenario) -> Array:
    if scenario.channel.fading != "expected":
        return np.zeros((0, 0, 0))
    return expected_gains(scenario.channel, scenario.uav_ids, scenario.user_ids)


def _snr_gain(scenario: Scenario, first_slot: int) -> Array:
    """Return `p_u rho |h_uk[n]|^2 / sigma^2`: (U, K, N) m^2, 0 where a UAV is silent; `rho` of the channel's kind.

    Under mean fading without corrections of single links, and under expected fading, whose draws are factors of it, all
    users share one row in memory, read-only: the fast path recognises this by the stride and saves a table of U K N
    numbers.
    """
    channel = scenario.channel
    power_w = np.array([uav.transmit_power_w for uav in scenario.uavs])
    noise_w = channel.noise_w(np.array([uav.bandwidth_hz for uav in scenario.uavs]))[:, None]
    alike = power_w[:, None] * channel.reference_gain / noise_w * on_air_of(scenario)  # (U, N)
    mean = channel.fading == "mean" and are_of_uavs(channel.corrections_db)
    if mean and channel.corrections_db:
        alike = alike * uav_factors(channel.corrections_db, scenario.uav_ids)[:, None]
    if mean or channel.fading == "expected":
        return np.broadcast_to(alike[:, None, :], (len(scenario.uavs), len(scenario.users), scenario.slots))
    fading = fading_gains(channel, scenario.uav_ids, scenario.user_ids, first_slot, scenario.slots)
    gain: Array = alike[:, None, :] * fading
    return gain
