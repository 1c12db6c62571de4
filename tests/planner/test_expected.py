"""`fading: "expected"`: rates averaged over the planner's own draws, against single draws and brute force."""

from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES, Channel, Origin, Plan, Scenario, Uav, User, Utility, explain, plan, replan
from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import upper_bound_kbps
from skyfolio.planner.certificate import prove
from skyfolio.planner.channel import expected_gains, fading_gains
from skyfolio.planner.delivered import delivered_rates_bps
from skyfolio.planner.fast import Tolls, linked, served_rates_bps
from skyfolio.planner.fast.arena import arena_of, links_of
from skyfolio.planner.fast.assigning import assigned
from skyfolio.planner.fast.climb import climb
from skyfolio.planner.layouts import scattered
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.repair import within_limits
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.utility import utility_kbps
from tests.planner.slopes import slopes

KINDS = ("sum", "per_user", "pooled")


def expecting(scenario: Scenario, draws: int = 8, seed: int = 3, **changes: Any) -> Scenario:
    channel = scenario.channel.model_copy(update={"fading": "expected", "draws": draws, "seed": seed})
    return scenario.with_changes(channel=channel, **changes)


def small(kind: str = "sum", mu: float = 0.0, n_uavs: int = 3, n_users: int = 5, **changes: Any) -> Scenario:
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    return expecting(scattered(n_uavs, n_users, 6, seed=4), utility=utility, **changes)


def in_one_draw(problem: Problem, draw: int = 0) -> Problem:
    """The same problem where one of the draws is known to be the channel in all slots."""
    gain = problem.snr_gain * problem.draws[draw][:, :, None]
    return replace(problem, snr_gain=gain, draws=np.zeros((0, 0, 0)))


def rates_kbps(made: Plan) -> Array:
    return np.array([made.user_rates_bps[user] for user in made.scenario.user_ids]) / 1e3


def test_draws_have_mean_one_and_no_link_is_luckier_than_another() -> None:
    channel = Channel(fading="expected", draws=32, seed=1)
    gains = expected_gains(channel, [f"uav-{u}" for u in range(10)], [f"user-{k}" for k in range(50)])
    assert gains.shape == (32, 10, 50)
    assert gains.mean() == pytest.approx(1.0, abs=0.01)
    assert gains.mean(axis=0).std() < 0.5 * gains.std() / np.sqrt(32)
    assert abs(np.corrcoef(gains[:, 0].ravel(), gains[:, 1].ravel())[0, 1]) < 0.1


def test_draws_depend_on_the_link_and_the_seed_alone() -> None:
    channel = Channel(fading="expected", draws=4, seed=1)
    everyone = expected_gains(channel, ["a", "b", "c"], ["x", "y"])
    assert (expected_gains(channel, ["c", "a"], ["y"]) == everyone[:, [2, 0], 1:]).all()
    assert (expected_gains(channel.model_copy(update={"seed": 2}), ["a"], ["x"]) != everyone[:, :1, :1]).all()


def test_no_draw_of_the_planner_is_one_of_the_channel() -> None:
    held = expected_gains(Channel(fading="expected", draws=64, seed=7), ["a"], ["x"])
    drawn = fading_gains(Channel(fading="sampled", seed=7), ["a"], ["x"], 0, 1000)
    assert np.abs(held.reshape(-1, 1) - drawn.reshape(1, -1)).min() > 0


def test_a_single_draw_is_a_plain_one() -> None:
    gains = expected_gains(
        Channel(fading="expected", draws=1), [f"u{i}" for i in range(50)], [f"k{i}" for i in range(50)]
    )
    rician = 10**0.3
    assert gains.mean() == pytest.approx(1.0, abs=0.06)
    assert gains.var() == pytest.approx((1 + 2 * rician) / (1 + rician) ** 2, rel=0.15)


def test_rates_are_the_mean_of_the_rates_in_each_draw() -> None:
    problem = problem_of(small())
    paths = problem.hover()
    each = [spectral_efficiency(in_one_draw(problem, draw), paths) for draw in range(8)]
    assert spectral_efficiency(problem, paths) == pytest.approx(np.mean(each, axis=0), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_one_draw_plans_as_if_that_draw_were_the_channel(kind: str) -> None:
    problem = problem_of(
        small(kind, -0.1 if kind != "sum" else 0.0).with_changes(channel=Channel(fading="expected", draws=1))
    )
    known = in_one_draw(problem)
    links, known_links = (linked(one, one.hover()) for one in (problem, known))
    assert (links.serving == known_links.serving).all()
    assert links.bandwidth_hz == pytest.approx(known_links.bandwidth_hz, rel=1e-6, abs=1e-3)
    climbed = []
    for one in (problem, known):
        arena = arena_of(one)
        path, tables = np.ascontiguousarray(one.hover().transpose(1, 2, 0)), links_of(arena)
        climb(arena, path, tables, 0, 1e-6)
        climbed.append([climb(arena, path, tables, 100, 1e-6)[1] for _ in range(5)][-1])
    assert climbed[0] == pytest.approx(climbed[1], rel=1e-6)


def test_links_of_a_slot_are_the_best_of_all_assignments() -> None:
    problem = problem_of(small(n_uavs=2, n_users=4))
    paths = problem.hover()
    solution = linked(problem, paths)
    whole = problem.bandwidth_hz[:, None, None] * spectral_efficiency(problem, paths)
    best = [
        max(whole[0, one, n] + whole[1, other, n] for one, other in permutations(range(4), 2))
        for n in range(problem.n_slots)
    ]
    assert served_rates_bps(problem, solution).sum(axis=0) == pytest.approx(best, rel=1e-9)


def test_a_flight_ends_at_the_best_place_of_a_fine_grid() -> None:
    users = (User(id="user-1", position_m=(60.0, 20.0)), User(id="user-2", position_m=(20.0, 60.0)))
    scenario = Scenario(
        origin=Origin(lat_deg=0.0, lon_deg=0.0),
        area_m=((0.0, 0.0), (100.0, 100.0)),
        slots=2,
        slot_duration_s=5.0,
        altitude_m=20.0,
        min_separation_m=4.0,
        uavs=tuple(
            Uav(id=f"uav-{u}", start_m=at, max_speed_mps=speed)
            for u, (at, speed) in enumerate((((40.0, 40.0), 5.0), ((90.0, 20.0), 0.0)))
        ),
        users=users,
        channel=Channel(fading="expected", draws=16, seed=2),
    )
    problem = problem_of(scenario)
    made = plan(scenario)
    grid = np.stack(np.meshgrid(np.arange(-25, 25.5, 0.5), np.arange(-25, 25.5, 0.5)), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= 25.0] + (40.0, 40.0)
    best = 0.0
    paths = problem.hover()
    for at in grid:
        paths[0, 1] = at
        rate = problem.bandwidth_hz[:, None] * spectral_efficiency(problem, paths)[:, :, 1]
        best = max(best, rate[0, 0] + rate[1, 1], rate[0, 1] + rate[1, 0])
    assert rates_kbps(made)[:, 1].sum() >= best / 1e3 * (1 - 1e-6)


def test_the_gradient_is_that_of_finite_differences() -> None:
    for told, differs in slopes(problem_of(small()), 5, 1e-4, (1, 0, 0), (3, 1, 1), (5, 0, 2)):
        assert told == pytest.approx(differs, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_the_promise_is_what_is_delivered_at_the_planned_places(kind: str) -> None:
    made = plan(small(kind, -0.1))
    paths = np.array([made.trajectories_m[uav] for uav in made.scenario.uav_ids])
    slots = np.arange(made.scenario.slots)
    sending = np.ones((len(slots), len(paths)), dtype=bool)
    got = delivered_rates_bps(made, slots, paths.transpose(1, 0, 2), sending).T / 1e3
    assert got == pytest.approx(rates_kbps(made), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_planning_for_the_expectation_beats_planning_on_the_mean_by_its_own_measure(kind: str) -> None:
    scenario = small(kind, -0.05)
    on_mean = plan(scenario.with_changes(channel=scenario.channel.model_copy(update={"fading": "mean"})))
    problem = problem_of(scenario)
    told = on_mean.model_copy(update={"scenario": scenario})
    paths = np.array([on_mean.trajectories_m[uav] for uav in scenario.uav_ids])
    slots = np.arange(scenario.slots)
    sending = np.ones((len(slots), len(paths)), dtype=bool)
    got = delivered_rates_bps(told, slots, paths.transpose(1, 0, 2), sending).T / 1e3
    before = utility_kbps(got, problem.kind, problem.mu)
    assert plan(scenario).summary.utility_bps / 1e3 >= before * (1 - 1e-6)


@given(seed=st.integers(0, 10_000), n_uavs=st.integers(1, 5))
def test_no_feasible_plan_exceeds_the_bound(seed: int, n_uavs: int) -> None:
    rng = np.random.default_rng(seed)
    kind, mu = KINDS[seed % 3], float(-(10 ** rng.uniform(-3, 1)))
    scenario = expecting(scattered(n_uavs, int(rng.integers(2, 6)), 4, seed=seed), seed=seed)
    problem = replace(problem_of(scenario), kind=kind, mu=mu)
    free = problem.start_m[:, None] + rng.normal(0, 30, (n_uavs, 4, 2))
    free[:, 0] = problem.start_m
    paths = within_limits(problem, free)
    solution = linked(problem, paths)
    rates = served_rates_bps(problem, solution) / 1e3
    bound = upper_bound_kbps(problem, rates)
    assert utility_kbps(rates, kind, mu) <= bound * (1 + 1e-9)


def test_survivors_replan_with_the_draws_that_they_had() -> None:
    first = plan(small())
    second = replan(first, failed=["uav-2"], at_slot=3)
    assert second.scenario.channel == first.scenario.channel
    kept = [0, 2]
    assert (problem_of(second.scenario).draws == problem_of(first.scenario).draws[:, kept]).all()


def test_what_knows_one_gain_of_each_link_refuses_by_name() -> None:
    scenario = small()
    made = plan(scenario)
    with pytest.raises(ValueError, match=r"channel\.fading: the method 'paper'"):
        plan(scenario, method="paper")
    with pytest.raises(ValueError, match=r"channel\.fading: of 'expected' rates only the bound"):
        prove(problem_of(scenario), rates_kbps(made))
    with pytest.raises(ValueError, match=r"channel\.fading: a plan of 'expected' rates cannot be explained"):
        explain(made)


def test_baselines_take_expected_rates_too() -> None:
    scenario = expecting(EXAMPLES["paper"]())
    rates = {
        method: plan(scenario, method=method).summary.mean_sum_rate_bps for method in ("sr_max", "static", "baseline1")
    }
    assert rates["sr_max"] >= rates["static"] >= rates["baseline1"]


def test_bands_assigned_at_a_toll_are_worth_what_they_give_over_all_draws() -> None:
    problem = problem_of(small(n_users=12))
    paths = np.repeat(problem.start_m[:, None], problem.n_slots, axis=1)
    best = linked(problem, paths)
    nobody = replace(best, serving=np.zeros_like(best.serving), bandwidth_hz=np.zeros_like(best.bandwidth_hz))
    free = Tolls(
        former_m=paths,
        serving=np.full_like(best.serving, -1),
        served=np.zeros(best.serving.shape, dtype=bool),
        per_metre=0.0,
        per_user=0.0,
    )
    serving, hertz = assigned(problem, free, nobody)
    got = served_rates_bps(problem, replace(best, serving=serving, bandwidth_hz=hertz)).sum(axis=0)
    assert got == pytest.approx(served_rates_bps(problem, best).sum(axis=0), rel=1e-9)
