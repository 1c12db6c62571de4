"""Users of all sorts at once, through everything that is done with plans: checked by formulas written out here."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import Channel, Pins, Plan, Scenario, User, Utility, explain, plan, preview, replan, violations
from skyfolio.planner.certificate import prove
from skyfolio.planner.delivered import delivered_rates_bps
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.explanation.prices import band_prices
from skyfolio.planner.fast import flyable, linked, served_rates_bps
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.robustness.assess import assess
from skyfolio.planner.robustness.disturbances import Disturbances
from skyfolio.planner.robustness.trial import Losses, Trial

KINDS = ("sum", "per_user", "pooled")
SEEDS = st.integers(0, 2**31)


def some_user(user: User, rng: np.random.Generator, n_slots: int) -> User:
    """Return the user with fields beyond the letter's, drawn at random, each as likely as not."""
    fields: dict[str, Any] = {}
    if rng.random() < 0.3:
        steps = rng.normal(0.0, 15.0, (n_slots - 1, 2)).cumsum(axis=0) + user.position_m
        fields["positions_m"] = (user.position_m, *(tuple(map(float, place)) for place in steps))
    elif rng.random() < 0.5:
        fields["velocity_mps"] = tuple(map(float, rng.normal(0.0, 2.0, 2)))
    if rng.random() < 0.5:
        fields |= {"uncertainty_m": float(rng.uniform(0, 20)), "uncertainty_mps": float(rng.uniform(0, 2))}
    if rng.random() < 0.4:
        fields["arrives_at_slot"] = int(rng.integers(0, n_slots))
    if rng.random() < 0.4:
        fields["leaves_at_slot"] = fields.get("arrives_at_slot", 0) + int(rng.integers(1, n_slots))
    if rng.random() < 0.5:
        fields["weight"] = float(rng.uniform(0.2, 4.0))
    if rng.random() < 0.2:
        fields["min_rate_bps"] = float(rng.uniform(10, 200))
    if rng.random() < 0.5:
        fields["demand_bps"] = float(rng.uniform(3e3, 4e4))
    return user.model_copy(update=fields)


def mixed(seed: int, kind: str, *, most_uavs: int = 4, fading: str = "mean") -> Scenario:
    """Return a small fleet with up to eight users of all sorts."""
    rng = np.random.default_rng(seed)
    n_uavs, n_users, n_slots = (int(rng.integers(1, most + 1)) for most in (most_uavs, 8, 6))
    n_slots += 1
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": float(rng.choice([-0.02, -0.1, -0.5]))})
    plain = scattered(n_uavs, n_users, n_slots, seed=seed % 1000, utility=utility)
    channel = plain.channel.model_copy(update={"fading": fading})
    return plain.with_changes(users=tuple(some_user(user, rng, n_slots) for user in plain.users), channel=channel)


def rates_by_hand(made: Plan) -> dict[str, list[float]]:
    """Return the rates of eqs. (1)-(4) on the mean channel, bit/s, user by user and slot by slot."""
    scenario, channel = made.scenario, made.scenario.channel
    assert isinstance(channel, Channel)
    assert channel.noise_dbm is not None
    noise_w = 10 ** (channel.noise_dbm / 10 - 3)
    table: dict[str, list[float]] = {}
    for user in scenario.users:
        row = table.setdefault(user.id, [])
        for n in range(scenario.slots):
            seconds = n * scenario.slot_duration_s
            at = np.array(user.position_m)
            if user.positions_m is not None:
                at = np.array(user.positions_m[n])
            elif user.velocity_mps is not None:
                at = at + np.array(user.velocity_mps) * seconds
            radius = (user.uncertainty_m or 0.0) + (user.uncertainty_mps or 0.0) * seconds
            snr = {}
            for uav in scenario.uavs:
                if n <= scenario.last_slot(uav):
                    apart2 = ((np.array(made.trajectories_m[uav.id][n]) - at) ** 2).sum()
                    distance2 = apart2 + scenario.altitude_of(uav) ** 2 + radius**2 / 2
                    power_w = uav.transmit_power_w * 10 ** (channel.reference_gain_db / 10)
                    snr[uav.id] = power_w / distance2 / noise_w
            own = snr.get(made.association[user.id][n], 0.0)
            row.append(made.bandwidth_hz[user.id][n] * float(np.log2(1 + own / (1 + sum(snr.values()) - own))))
    return table


def utility_by_hand(made: Plan, past: dict[str, list[float]] | None = None) -> float:
    """Return the utility in bit/s, written out; past: rates of the slots before, bit/s."""
    scenario, mu = made.scenario, made.scenario.utility.mu_per_kbps / 1e3
    before = max((len(row) for row in (past or {}).values()), default=0)
    everything = before + scenario.slots
    counted: dict[str, list[tuple[int, float]]] = {}
    for user in scenario.users:
        row = [*(past or {}).get(user.id, [0.0] * before), *made.user_rates_bps[user.id]]
        most = np.inf if user.demand_bps is None else user.demand_bps
        counted[user.id] = [(n, min(rate, most)) for n, rate in enumerate(row) if user.is_there(n - before)]
    weight = {user.id: user.weight or 1.0 for user in scenario.users}
    if scenario.utility.kind == "sum":
        sums = [0.0] * everything
        for name, rates in counted.items():
            for n, rate in rates:
                sums[n] += weight[name] * rate
        return float(np.log(np.mean(np.exp(mu * np.array(sums)))) / mu)
    means = {user: np.array([np.exp(mu * rate) for _, rate in rates]) for user, rates in counted.items()}
    if scenario.utility.kind == "per_user":
        return sum(
            weight[user] * len(row) / everything * float(np.log(row.mean()) / mu)
            for user, row in means.items()
            if len(row)
        )
    number = sum(weight[user] * len(row) for user, row in means.items())
    total = sum(weight[user] * row.sum() for user, row in means.items())
    return float(number / everything * np.log(total / number) / mu) if number else 0.0


def is_right(made: Plan, past: dict[str, list[float]] | None = None) -> None:
    """Check a plan on the mean channel by the formulas above."""
    assert violations(made) == []
    for user, row in rates_by_hand(made).items():
        assert made.user_rates_bps[user] == pytest.approx(row, rel=1e-6, abs=1e-6)
    assert made.summary.utility_bps == pytest.approx(utility_by_hand(made, past), rel=1e-7, abs=1e-6)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps * (1 + 1e-9)


def after(made: Plan, slots: int, past: dict[str, list[float]] | None = None) -> dict[str, list[float]]:
    """Return what users had before slot `slots` of this plan."""
    return {user: [*(past or {}).get(user, []), *row[:slots]] for user, row in made.user_rates_bps.items()}


@settings(max_examples=20)
@given(SEEDS, st.sampled_from(KINDS))
def test_plans_and_replans_after_a_loss_are_worth_what_they_say(seed: int, kind: str) -> None:
    made = plan(mixed(seed, kind), n_starts=2)
    is_right(made)
    if len(made.scenario.uavs) == 1 or made.scenario.slots < 3:
        return
    second = replan(made, failed=[made.scenario.uav_ids[seed % len(made.scenario.uavs)]], at_slot=1)
    is_right(second, after(made, 1))
    third = replan(second, at_slot=2, disruption_weight=float(seed % 3))
    is_right(third, after(second, 1, after(made, 1)))
    slot_s = made.scenario.slot_duration_s
    for was, user in zip(made.scenario.users, third.scenario.users, strict=True):
        for n in range(third.scenario.slots):
            assert user.place_m(n, slot_s) == pytest.approx(was.place_m(n + 2, slot_s), abs=1e-6)
            assert user.radius_m(n, slot_s) == pytest.approx(was.radius_m(n + 2, slot_s))
            assert user.is_there(n) == was.is_there(n + 2)


def random_plan(problem: Problem, rng: np.random.Generator) -> float:
    """Return the utility of flyable random paths with their best links, kbit/s."""
    ways = rng.normal(0.0, problem.step_m[:, None, None], (problem.n_uavs, problem.n_slots, 2)).cumsum(axis=1)
    found = linked(problem, flyable(problem, problem.start_m[:, None] + ways))
    return problem.utility_kbps(served_rates_bps(problem, found) / 1e3)


@settings(max_examples=15)
@given(SEEDS, st.sampled_from(KINDS), st.sampled_from(["mean", "sampled"]))
def test_no_plan_is_better_than_what_is_proven_with_time_or_the_proof_is_refused(
    seed: int, kind: str, fading: str
) -> None:
    made = plan(mixed(seed, kind, most_uavs=6, fading=fading), n_starts=2)
    problem = problem_of(made.scenario)
    rates = np.array([made.user_rates_bps[user] for user in made.scenario.user_ids]) / 1e3
    moving = any(user.moves or user.uncertainty_m or user.uncertainty_mps for user in made.scenario.users)
    asked = iter(range(10**6))
    if problem.n_uavs > 3 and moving:
        with pytest.raises(ValueError, match=r"users: with more than 3 UAVs, and users that move"):
            prove(problem, rates)
        return
    proof = prove(problem, rates, stop=lambda: next(asked) > 8)
    rng = np.random.default_rng(seed)
    best = max(made.summary.utility_bps / 1e3, *(random_plan(problem, rng) for _ in range(5)))
    assert best <= proof.bound_kbps * (1 + 1e-9)
    assert proof.bound_kbps <= proof.root_kbps * (1 + 1e-9)


@settings(max_examples=10)
@given(SEEDS, st.sampled_from(KINDS))
def test_pins_hold_and_a_preview_says_what_the_change_makes_of_the_plan(seed: int, kind: str) -> None:
    made = plan(mixed(seed, kind), n_starts=2)
    scenario, rng = made.scenario, np.random.default_rng(seed)
    uav, user = str(rng.choice(scenario.uav_ids)), str(rng.choice(scenario.user_ids))
    pins = Pins(uavs=(uav,), associations={user: uav})
    held = plan(scenario, pins=pins, n_starts=2)
    is_right(held)
    assert held.trajectories_m[uav] == [scenario.uavs[scenario.uav_ids.index(uav)].start_m] * scenario.slots
    assert set(held.association[user]) == {uav}
    kept = replan(held, at_slot=1, keep_pins=True) if scenario.slots > 2 else held
    assert set(kept.association[user]) == {uav}


@settings(max_examples=10)
@given(SEEDS, st.sampled_from(KINDS))
def test_a_preview_compares_what_users_really_had_and_would_have(seed: int, kind: str) -> None:
    made = plan(mixed(seed, kind), n_starts=2)
    scenario = made.scenario
    same = preview(made, scenario=scenario, n_starts=2)
    assert same.utility_after_bps >= made.summary.utility_bps * (1 - 1e-4)
    everyone = {user: sum(row) / len(row) for user, row in made.user_rates_bps.items()}
    for one in (*same.gaining, *same.losing):
        assert one.before_bps == pytest.approx(everyone[one.user_id])
    if len(scenario.uavs) > 1 and scenario.slots > 2:
        lost = preview(made, failed=[scenario.uav_ids[0]], at_slot=1, n_starts=2)
        again = replan(made, failed=[scenario.uav_ids[0]], at_slot=1, n_starts=2)
        assert lost.utility_after_bps == again.summary.utility_bps


@settings(max_examples=10)
@given(SEEDS, st.sampled_from(KINDS))
def test_an_explanation_tells_what_users_get_while_they_are_there(seed: int, kind: str) -> None:
    made = plan(mixed(seed, kind), n_starts=2)
    said = explain(made)
    for user, row in zip(made.scenario.users, said.users, strict=True):
        there = [rate for n, rate in enumerate(made.user_rates_bps[user.id]) if user.is_there(n)]
        assert row.mean_rate_bps == pytest.approx(np.mean(there) if there else 0.0)
        most = np.inf if user.demand_bps is None else user.demand_bps * (1 + 1e-6)
        sated = all(rate >= most * (1 - 1e-5) for rate in there)
        assert (row.level == "satisfied") == sated
        assert all(reason.gain_bps >= -1e-6 for reason in row.reasons if reason.method == "bound")
        assert all(reason.rate_bps <= most for reason in row.reasons)
    more = {row.method: row.utility_gain_bps for row in said.worth if row.what == "one_more_uav"}
    bound = more.get("bound", np.inf)
    assert more.get("resolve", -np.inf) <= bound + 1e-9 * abs(bound) + 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_a_hertz_more_is_worth_what_a_little_more_band_gives_those_who_ask_for_more(kind: str) -> None:
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.05})
    plain = scattered(2, 6, 5, seed=3, utility=utility)
    asks = [4e3, None, 6e3, None, 5e3, None]
    users = tuple(u.model_copy(update={"demand_bps": most}) for u, most in zip(plain.users, asks, strict=True))
    made = plan(plain.with_changes(users=users))
    ledger = Ledger.of(made)
    prices = band_prices(ledger)
    for u in range(2):
        wider = replace(ledger.problem, bandwidth_hz=ledger.problem.bandwidth_hz + 0.5 * (np.arange(2) == u))
        found = linked(wider, ledger.paths_m)
        gain = wider.utility_kbps(served_rates_bps(wider, found) / 1e3) - ledger.utility_kbps(ledger.rates_kbps)
        assert prices[u] == pytest.approx(gain * 1e3 / 0.5, rel=0.02)


@settings(max_examples=10)
@given(SEEDS, st.sampled_from(KINDS))
def test_under_disturbances_no_user_takes_more_than_it_asks_for_or_is_served_while_away(seed: int, kind: str) -> None:
    made = plan(mixed(seed, kind), n_starts=2)
    scenario = made.scenario
    still = {"fading": False, "position_noise_m": 0.0, "wind_mps": 0.0, "gust_mps": 0.0}
    losses = Losses(at_once=1, recovery_s=0.0, starts=1)
    calm = assess(made, Trial(disturbances=Disturbances(draws=2, **still), losses=losses, outage_bps=1e9))
    for user, row in zip(scenario.users, calm.users, strict=True):
        rates = made.user_rates_bps[user.id]
        assert row.rate_bps.mean_bps == pytest.approx(np.mean(rates), rel=1e-6)
        there = [rate for n, rate in enumerate(rates) if user.is_there(n)]
        most = 1e9 if user.demand_bps is None else user.demand_bps * (1 - 1e-6)
        assert row.outage_probability == (pytest.approx(np.mean(np.array(there) < most)) if there else None)
    windy = assess(made, Trial(disturbances=Disturbances(draws=5), losses=Losses(at_once=0)))
    for user, row in zip(scenario.users, windy.users, strict=True):
        share = np.mean([user.is_there(n) for n in range(scenario.slots)])
        assert row.rate_bps.p95_bps <= (np.inf if user.demand_bps is None else user.demand_bps * share * (1 + 1e-9))


def test_who_is_nearer_than_planned_still_takes_no_more_than_it_asks_for() -> None:
    plain = scattered(1, 1, 4, seed=1)
    user = plain.users[0].model_copy(update={"demand_bps": 3000.0})
    made = plan(plain.with_changes(users=(user,)))
    above = np.full((4, 1, 2), user.position_m)
    got = delivered_rates_bps(made, np.arange(4), above, np.ones((4, 1), dtype=bool))
    assert got.ravel().tolist() == [3000.0] * 4
