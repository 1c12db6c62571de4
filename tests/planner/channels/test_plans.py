"""Plans, bounds and gradients under every kind of channel."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import Plan, Scenario, Utility, delivered_rates_bps, explain, plan, replan, violations
from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import upper_bound_kbps
from skyfolio.planner.certificate import prove
from skyfolio.planner.channels.kinds import channel_of
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.explanation.prices import slope_kbps
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.repair import within_limits
from skyfolio.planner.sinr import spectral_efficiency
from tests.planner.channels.any_kind import CHANNELS
from tests.planner.slopes import slopes

PLAIN = {name: doc for name, doc in CHANNELS.items() if doc.get("fading", "mean") == "mean"}


def fleet(name: str, n_uavs: int = 3, n_users: int = 6, n_slots: int = 5, seed: int = 1, **utility: Any) -> Scenario:
    easy = scattered(n_uavs, n_users, n_slots, seed=seed, utility=Utility.model_validate(utility))
    return easy.with_changes(channel=channel_of(CHANNELS[name]))


def rates_by_hand(made: Plan) -> dict[str, list[float]]:
    """Return eqs. (3)-(4) with the formulas of the channel, from the emitted plan alone; for mean fading."""
    scenario = made.scenario
    rates: dict[str, list[float]] = {}
    for user in scenario.users:
        row = rates.setdefault(user.id, [])
        for n in range(scenario.slots):
            snr = {}
            for uav in scenario.uavs:
                away = math.dist(made.trajectories_m[uav.id][n], user.position_m)
                noise_w = float(scenario.channel.noise_w(np.array([uav.bandwidth_hz]))[0])
                places_m = np.array(user.position_m), np.array(made.trajectories_m[uav.id][n])
                gain = scenario.channel.gain_at(away, scenario.altitude_of(uav), places_m=places_m)
                snr[uav.id] = uav.transmit_power_w * gain / noise_w
            own = snr[made.association[user.id][n]]
            row.append(made.bandwidth_hz[user.id][n] * math.log2(1.0 + own / (1.0 + sum(snr.values()) - own)))
    return rates


@pytest.mark.parametrize("name", PLAIN)
def test_a_plan_promises_what_the_formulas_give_at_its_places(name: str) -> None:
    made = plan(fleet(name, kind="per_user", mu_per_kbps=-0.1), n_starts=4)
    by_hand = rates_by_hand(made)
    for user, row in made.user_rates_bps.items():
        assert row == pytest.approx(by_hand[user], rel=0.01, abs=1.0)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_plan_is_feasible_better_than_staying_and_within_its_bound(name: str) -> None:
    scenario = fleet(name)
    made, stay = plan(scenario, n_starts=4), plan(scenario, method="static")
    assert violations(made) == []
    assert made.summary.utility_bps >= stay.summary.utility_bps * (1 - 1e-9)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps
    assert plan(scenario, n_starts=4) == made
    assert violations(replan(made, failed=["uav-2"], at_slot=2)) == []


@pytest.mark.parametrize("name", CHANNELS)
def test_what_is_delivered_at_the_planned_places_is_what_was_planned(name: str) -> None:
    made = plan(fleet(name), n_starts=2)
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    slots = np.arange(made.scenario.slots)
    got = delivered_rates_bps(made, slots, paths.transpose(1, 0, 2), np.ones((len(slots), len(paths)), dtype=bool))
    planned = np.array([made.user_rates_bps[user] for user in made.scenario.user_ids])
    assert planned == pytest.approx(got.T, rel=0.01, abs=1.0)


@pytest.mark.parametrize("name", CHANNELS)
@settings(max_examples=15)
@given(st.integers(0, 2**31), st.integers(1, 5), st.sampled_from(["sum", "per_user", "pooled"]))
def test_no_random_plan_is_better_than_the_bound(name: str, seed: int, n_uavs: int, kind: str) -> None:
    mu = 0.0 if seed % 3 == 0 else -0.1
    problem = problem_of(fleet(name, n_uavs, 4, 4, seed=seed % 1000, kind=kind, mu_per_kbps=mu))
    rng = np.random.default_rng(seed)
    bound = upper_bound_kbps(problem)
    for _ in range(3):
        steps = np.linspace(0, 1, problem.n_slots)[:, None] * rng.normal(size=(n_uavs, 1, 2)) * 80
        paths = within_limits(problem, problem.hover() + steps)
        rates = problem.bandwidth_hz[:, None, None] * spectral_efficiency(problem, paths) / 1e3
        serving = rng.integers(0, n_uavs, (problem.n_users, problem.n_slots))
        share = np.zeros(rates.shape)
        for n in range(problem.n_slots):  # each UAV's band to one of its users
            for u in range(n_uavs):
                mine = np.flatnonzero(serving[:, n] == u)
                if len(mine):
                    share[u, rng.choice(mine), n] = 1.0
        assert problem.utility_kbps((share * rates).sum(axis=0)) <= bound * (1 + 1e-9) + 1e-9


@pytest.mark.parametrize("name", CHANNELS)
def test_the_gradient_of_the_kernels_is_that_of_finite_differences(name: str) -> None:
    for told, differs in slopes(problem_of(fleet(name)), 8, 1e-5, (1, 0, 0), (2, 1, 1), (4, 0, 2)):
        assert told == pytest.approx(differs, rel=1e-3, abs=1e-5)


def test_a_uav_with_a_null_below_it_hovers_beside_its_user() -> None:
    alone = scattered(1, 1, 30, seed=2).with_changes(channel=channel_of(CHANNELS["letter, dipole"]))
    made = plan(alone)
    away = math.dist(made.trajectories_m["uav-1"][-1], alone.users[0].position_m)
    gains = [(alone.channel.gain_at(at, 60.0), at) for at in np.arange(0.0, 300.0, 0.5).tolist()]
    assert max(gains)[1] > 20.0
    assert away == pytest.approx(max(gains)[1], abs=2.0)


@pytest.mark.parametrize("name", PLAIN)
def test_an_explanation_knows_the_channel(name: str) -> None:
    made = plan(fleet(name, n_slots=8), n_starts=2)
    told = explain(made)
    ledger = Ledger.of(made)
    assert ledger.total_snr == pytest.approx(snr_of(ledger).sum(axis=0), rel=1e-12)
    assert {user.user_id for user in told.users} <= set(made.scenario.user_ids)
    slope = slope_kbps(ledger, 0)
    for n in (2, 6):
        apart = np.zeros(ledger.paths_m.shape)
        apart[0, n, 0] = 1e-4
        ahead, behind = (
            ledger.utility_kbps(rates_with(replace(ledger, paths_m=ledger.paths_m + by))) for by in (apart, -apart)
        )
        assert slope[n, 0] == pytest.approx((ahead - behind) / 2e-4, rel=1e-3, abs=1e-7)


def snr_of(ledger: Ledger) -> Array:
    return ledger.problem.snr(ledger.paths_m)


def rates_with(ledger: Ledger) -> Array:
    """Return the rates of the plan's links at other places: (K, N) kbit/s."""
    efficiency = spectral_efficiency(ledger.problem, ledger.paths_m)
    served: Array = np.take_along_axis(efficiency, ledger.serving[None], axis=0)[0]
    return ledger.bandwidth_hz * served / 1e3


REFUSED = "channel.kind, channel.antenna: "


def test_what_cannot_be_done_with_a_kind_is_refused_by_the_name_of_the_field() -> None:
    scenario = fleet("UMa-AV")
    for method in ("paper", "areas"):
        with pytest.raises(ValueError, match=REFUSED):
            plan(scenario, method=method)
    problem = problem_of(scenario)
    with pytest.raises(ValueError, match=REFUSED):
        prove(problem, np.zeros((problem.n_users, problem.n_slots)))


@pytest.mark.parametrize("method", ["sr_max", "static", "baseline1", "baseline2", "baseline2_fixed"])
def test_baselines_use_the_channel(method: str) -> None:
    made = plan(fleet("RMa-AV, beam"), method=method)
    by_hand = rates_by_hand(made)
    for user, row in made.user_rates_bps.items():
        assert row == pytest.approx(by_hand[user], rel=0.01, abs=1.0)


def test_a_wider_band_has_more_noise_and_interferes_less_in_a_narrow_one() -> None:
    scenario = fleet("UMa-AV")
    first = scenario.uavs[0].model_copy(update={"bandwidth_hz": 40_000.0})
    wide: Problem = problem_of(scenario.with_changes(uavs=(first, *scenario.uavs[1:])))
    narrow = problem_of(scenario)
    assert wide.snr_gain[0] == pytest.approx(narrow.snr_gain[0] / 4.0)
    assert wide.snr_gain[1:] == pytest.approx(narrow.snr_gain[1:])
