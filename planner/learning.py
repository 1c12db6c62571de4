"""What measurements in flight say about single links: by how many dB each is better than the channel model says.

A user's SINR (eq. 4) depends on the gains of all its links: the serving one and the interfering ones. Each link's
correction is taken as the sum of what all links of the fleet have in common, what the links of one UAV have in common
(its power is wrong), and what is the link's own (it is shadowed), each with a prior that pulls it to 0. The most likely
corrections are found by Gauss-Newton steps; a measurement that fits badly counts less, and one that does not fit at all
counts nothing (errors by Student's t: Lange, Little and Taylor, "Robust Statistical Modeling Using the t Distribution",
doi:10.1080/01621459.1989.10478852; from a start by Huber's weights, which has no choice of optima). Links without
measurements get what is common. Where interference drowns the noise, what all links have in common changes no SINR, and
stays 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyfolio.planner.arrays import Array
from skyfolio.planner.channel import fading_gains, sum_of_others
from skyfolio.planner.corrections import OTHERS, by_id
from skyfolio.planner.heard import factors, reference_snr
from skyfolio.planner.scenario import Point, Scenario

OF_MEASUREMENT_DB = 3.0
"""Standard deviation of one measured SINR: fading, and where the UAV really is."""
OF_DRIFT_DB = 5.0
"""Standard deviation by which a link changes in a slot: what was measured some slots ago says less of today."""
OF_LINK_DB, OF_UAV_DB, OF_FLEET_DB = 6.0, 4.0, 6.0
"""Standard deviations of what is a link's own, a UAV's, and the whole fleet's."""
HUBER = 1.345
"""At the start, errors above so many standard deviations count less."""
FREEDOM = 4.0
"""Degrees of freedom of the errors: the fewer, the more outliers are expected."""
STARTING_STEPS, STEPS = 8, 16
MOST_OBSERVATIONS = 1500
"""So many of the last ones are used: the work grows with their cube."""
MOST_DB = 40.0
PER_DB = float(np.log(10.0) / 10.0)


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One measured SINR of a user, dB, served by a UAV in a slot of the operation.

    positions_m: where every UAV that transmitted was, metres east/north of the origin.
    """

    user_id: str
    uav_id: str
    sinr_db: float
    slot: int
    positions_m: Mapping[str, Point]


@dataclass(frozen=True, kw_only=True)
class _Heard:
    """S measurements. snr: (S, U), of every UAV by the model; serving, user: (S,) indices; sinr_db: (S,).

    spread_db2: (S,), the variance of each as a measurement of today's link, dB^2.
    """

    snr: Array
    serving: NDArray[np.intp]
    user: NDArray[np.intp]
    sinr_db: Array
    spread_db2: Array


def learned_corrections_db(scenario: Scenario, observations: Sequence[Observation]) -> dict[str, dict[str, float]]:
    """Return the most likely corrections of all links, by UAV and user, dB; {} without a measurement.

    Of a fleet that is planned by areas it is those of its UAVs (`*`), since links are not told apart there: the median
    over the users whom each served.
    Corrections that the scenario has already do not matter: they are learned anew from all measurements. Raises
    ValueError for an observation of a user or a UAV that the scenario does not have.
    """
    if not observations:
        return {}
    from skyfolio.planner.areas.size import is_large  # noqa: PLC0415 - loads the optimiser, which a service starts without

    plain = scenario.channel.model_copy(update={"corrections_db": {}})
    scenario = scenario.model_copy(update={"channel": plain})
    heard, users = _heard(scenario, observations[-MOST_OBSERVATIONS:])
    of_links, of_fleet = _corrections_db(heard, len(users))
    if is_large(scenario):
        return by_id(_of_uavs_db(heard, of_links, of_fleet)[:, None], scenario.uav_ids, [OTHERS])
    found = np.repeat(of_fleet[:, None], len(scenario.users), axis=1)
    found[:, users] = of_links
    return by_id(found, scenario.uav_ids, scenario.user_ids)


def _of_uavs_db(heard: _Heard, of_links: Array, of_fleet: Array) -> Array:
    """Return one correction for each UAV: (U,) dB, what all have in common for those that served no user."""
    found = of_fleet.copy()
    for u in np.unique(heard.serving).tolist():
        found[u] = np.median(of_links[u, np.unique(heard.user[heard.serving == u])])
    return found


def _heard(scenario: Scenario, observations: Sequence[Observation]) -> tuple[_Heard, NDArray[np.intp]]:
    """Return what was measured, and which users were: `_Heard.user` counts among these."""
    uav_of = {uav: u for u, uav in enumerate(scenario.uav_ids)}
    user_of = {user: k for k, user in enumerate(scenario.user_ids)}
    for one in observations:
        if one.user_id not in user_of or one.uav_id not in uav_of or one.uav_id not in one.positions_m:
            raise ValueError(f"observations: {one.uav_id!r} serving {one.user_id!r} is no link of the scenario")
    slots = np.array([one.slot for one in observations])
    user = np.array([user_of[one.user_id] for one in observations], dtype=np.intp)
    users, among = np.unique(user, return_inverse=True)
    heard = _Heard(
        snr=_snr(scenario, observations, user),
        serving=np.array([uav_of[one.uav_id] for one in observations], dtype=np.intp),
        user=among.astype(np.intp),
        sinr_db=np.array([one.sinr_db for one in observations]),
        spread_db2=OF_MEASUREMENT_DB**2 + OF_DRIFT_DB**2 * (slots.max() - slots),
    )
    return heard, users


def _snr(scenario: Scenario, observations: Sequence[Observation], user: NDArray[np.intp]) -> Array:
    """Return the SNR of every UAV at the user of every observation by the model without corrections: (S, U)."""
    channel = scenario.channel
    nowhere = (np.inf, np.inf)
    at_m = np.array([[one.positions_m.get(uav, nowhere) for uav in scenario.uav_ids] for one in observations])
    users_m = np.array([one.position_m for one in scenario.users])[user]
    altitude_m = np.array([scenario.altitude_of(uav) for uav in scenario.uavs])
    over2 = ((at_m - users_m[:, None, :]) ** 2).sum(axis=2)
    squared_m2 = over2 + altitude_m**2
    gain = reference_snr(scenario)
    factor = factors(channel, over2, altitude_m, places_m=(users_m[:, None, :], at_m))
    snr: Array = gain / squared_m2 * factor
    if channel.fading in {"mean", "expected"}:  # every draw has the mean 1: no table of all links is made
        return snr
    slots = np.array([one.slot for one in observations])
    first = int(slots.min())
    fading = fading_gains(channel, scenario.uav_ids, scenario.user_ids, first, int(slots.max()) - first + 1)
    faded: Array = snr * fading[:, user, slots - first].T
    return faded


def _corrections_db(heard: _Heard, n_users: int) -> tuple[Array, Array]:
    """Return the most likely corrections of all links that were measured, (U, K) dB, and of all others, (U,).

    Each step is a regression of Gaussian processes (kriging): with H the slopes of the S expected SINR, P the prior's
    covariance and R that of the errors, the corrections are `P H' (H P H' + R)^-1 r`; only S x S numbers are solved.
    """
    each = np.arange(len(heard.user))
    found, of_fleet = np.zeros((heard.snr.shape[1], n_users)), np.zeros(heard.snr.shape[1])
    for step in range(STEPS):
        own = found[:, heard.user].T
        signal = heard.snr * np.exp(PER_DB * own)
        others = 1.0 + sum_of_others(signal.T).T[each, heard.serving]
        slope = -signal / others[:, None]
        slope[each, heard.serving] = 1.0
        residual = heard.sinr_db - 10.0 * np.log10(signal[each, heard.serving] / others)
        error = _errors(residual, heard.spread_db2, starting=step < STARTING_STEPS)
        told = np.linalg.solve(_covariance(slope, heard.user) + np.diag(error), residual + (slope * own).sum(axis=1))
        found, of_fleet = (np.clip(one, -MOST_DB, MOST_DB) for one in _spread(slope, heard.user, told, n_users))
    return found, of_fleet


def _errors(residual: Array, spread_db2: Array, *, starting: bool) -> Array:
    """Return the variance with which each measurement counts, given how badly it fits: (S,) dB^2."""
    if starting:
        huber: Array = spread_db2 * np.maximum(1.0, np.abs(residual) / (HUBER * np.sqrt(spread_db2)))
        return huber
    student: Array = (spread_db2 * FREEDOM + residual**2) / (FREEDOM + 1.0)
    return student


def _covariance(slope: Array, user: NDArray[np.intp]) -> Array:
    """Return the prior's covariance of the expected SINR: (S, S) dB^2; slope: (S, U), user: (S,)."""
    of_all, alike = slope.sum(axis=1), slope @ slope.T
    same = user[:, None] == user
    covariance: Array = OF_FLEET_DB**2 * np.outer(of_all, of_all) + (OF_UAV_DB**2 + OF_LINK_DB**2 * same) * alike
    return covariance


def _spread(slope: Array, user: NDArray[np.intp], told: Array, n_users: int) -> tuple[Array, Array]:
    """Return what each link learns from what the S measurements told, (U, K) dB, and those that were not measured."""
    pulls = slope * told[:, None]
    of_links = np.zeros((n_users, slope.shape[1]))
    np.add.at(of_links, user, pulls)
    of_uavs = pulls.sum(axis=0)
    of_fleet: Array = OF_FLEET_DB**2 * of_uavs.sum() + OF_UAV_DB**2 * of_uavs
    return of_fleet[:, None] + OF_LINK_DB**2 * of_links.T, of_fleet
