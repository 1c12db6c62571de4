"""Where to hover and who goes where: sketches, snapshots and settling against brute force and the exact links."""

from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from skyfolio.planner import MaxIterations, Scenario, Uav, Utility, violations
from skyfolio.planner.arrays import Array
from skyfolio.planner.fast import flyable, linked, optimise, served_rates_bps
from skyfolio.planner.fast.appraisal import look, worth
from skyfolio.planner.fast.arena import Arena, arena_of, mean_user_m, plain
from skyfolio.planner.fast.placement import Effort, effort_of, grounds_of, places, sites_m, sketched
from skyfolio.planner.fast.seeds import bound
from skyfolio.planner.fast.settling import settle
from skyfolio.planner.fast.sketch import exchange_users
from skyfolio.planner.fast.snapshots import Snapshots, aim, keep, snapshots_of, take_back
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.problem import Problem, problem_of
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon, zone_holds
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solve import plan
from skyfolio.planner.utility import utility_kbps

CASES = [("sum", 0.0), ("sum", -0.05), ("per_user", -0.1), ("pooled", -0.5)]


def _aim(arena: Arena, shots: Snapshots, u: int, x: float, y: float) -> None:
    aim(arena, shots, u, x, y, False)
    keep(shots)


def _worth(arena: Arena, shots: Snapshots) -> float:
    return worth(arena, shots)


def _exchanged_and_back(arena: Arena, shots: Snapshots, u: int, other: int) -> None:
    x, y = shots.place[0, u], shots.place[1, u]
    aim(arena, shots, u, shots.place[0, other], shots.place[1, other], False)
    aim(arena, shots, other, x, y, True)
    take_back(shots, u, other)


aimed, valued, exchanged_and_back = njit(_aim), njit(_worth), njit(_exchanged_and_back)


def fleet(kind: str = "sum", mu: float = 0.0, size: tuple[int, int, int] = (6, 30, 12), **changes: Any) -> Scenario:
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    return laid_out("uniform", *size, seed=4, utility=utility).with_changes(**changes)


def table_of(problem: Problem, chosen: tuple[int, ...]) -> float:
    """The sum rate, kbit/s, of UAVs that hover over the users `chosen` and serve them."""
    paths = np.repeat(problem.user_m[list(chosen)], problem.n_slots, axis=1)
    efficiency = spectral_efficiency(problem, paths)[np.arange(problem.n_uavs), list(chosen), -1]
    return float((efficiency * problem.bandwidth_hz).sum() / 1e3)


def exchanged(problem: Problem, chosen: list[int]) -> tuple[float, list[int]]:
    arena = arena_of(problem)
    grounds, users = grounds_of(arena), np.array(chosen)
    free = np.zeros(grounds.lost.shape)
    value = exchange_users(grounds.site_m, grounds.user_m, grounds.gain, arena.height2, arena.khz, free, users)
    return value, users.tolist()


def test_exchanging_users_ends_where_no_single_exchange_helps_and_finds_the_best_of_all_choices() -> None:
    scenario = fleet(size=(3, 8, 2))
    uneven = tuple(
        uav.model_copy(update={"bandwidth_hz": 1e4 * (1 + u), "altitude_m": 40.0 + 30 * u})
        for u, uav in enumerate(scenario.uavs)
    )
    problem = problem_of(scenario.with_changes(uavs=uneven))
    best = max(table_of(problem, chosen) for chosen in permutations(range(8), 3))
    rng, reached = np.random.default_rng(0), []
    for _ in range(12):
        value, chosen = exchanged(problem, rng.choice(8, 3, replace=False).tolist())
        assert value == pytest.approx(table_of(problem, tuple(chosen)), rel=1e-9)
        for u, k in ((u, k) for u in range(3) for k in set(range(8)) - set(chosen)):
            assert table_of(problem, (*chosen[:u], k, *chosen[u + 1 :])) <= value + 1e-6
        reached.append(value)
    assert 0.99 * best <= max(reached) <= best * (1 + 1e-9)


def test_a_price_on_time_keeps_uavs_nearer() -> None:
    arena = arena_of(problem_of(fleet(size=(6, 60, 12))))
    grounds = grounds_of(arena)

    def flown(price: float) -> float:
        made = [sketched(arena, grounds, np.random.default_rng(seed), price) for seed in range(8)]
        return float(np.mean([np.hypot(*(place - arena.start_m)).sum() for place in made]))

    assert flown(8.0) < 0.8 * flown(0.0)


def snapped(kind: str, mu: float) -> tuple[Problem, Arena, Snapshots]:
    """Four slots that are all moments, the fixed one left out: then the snapshots miss nothing."""
    scenario = fleet(kind, mu, (5, 12, 4))
    problem = problem_of(
        scenario.with_changes(utility=scenario.utility.model_copy(update={"exclude_fixed_slots": True}))
    )
    arena = arena_of(problem)
    shots = snapshots_of(arena)
    assert shots.slot.tolist() == [1, 2, 3]
    return problem, arena, shots


@pytest.mark.parametrize(("kind", "mu"), CASES)
def test_what_places_are_worth_is_what_flying_there_gives_with_good_links_and_never_more(kind: str, mu: float) -> None:
    problem, arena, shots = snapped(kind, mu)
    rng = np.random.default_rng(1)
    for _ in range(5):
        place = plain(rng.uniform(problem.low_m, problem.high_m, (5, 2)).T)
        value = look(arena, shots, place)
        paths = flyable(problem, np.repeat(place.T[:, None], problem.n_slots, axis=1))
        solution = linked(problem, paths)
        rates = served_rates_bps(problem, solution) / 1e3
        best = utility_kbps(problem.counted_kbps(rates), kind, mu)
        assert (0.9 if kind == "sum" else 0.7) * best <= value <= best * (1 + 1e-3)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30)
def test_moving_uavs_one_by_one_comes_to_the_same_as_looking_anew(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind, mu = CASES[seed % 4]
    if kind == "per_user":
        kind, mu = "pooled", -0.05  # whose worth does not depend on the last look
    problem = problem_of(fleet(kind, mu))
    arena = arena_of(problem)
    moved, fresh = snapshots_of(arena), snapshots_of(arena)
    look(arena, moved, plain(rng.uniform(problem.low_m, problem.high_m, (6, 2)).T))
    for _ in range(20):
        u, (x, y) = int(rng.integers(6)), rng.uniform(problem.low_m, problem.high_m)
        aimed(arena, moved, u, x, y)
    assert valued(arena, moved) == pytest.approx(look(arena, fresh, moved.place.copy()), rel=1e-9)
    loudest = np.take_along_axis(moved.signal, moved.heard.serving[:, None], axis=1)[:, 0]
    np.testing.assert_array_equal(loudest, moved.signal.max(axis=1))
    np.testing.assert_array_equal(loudest, moved.heard.own)
    signal, place = moved.signal.copy(), moved.place.copy()
    exchanged_and_back(arena, moved, 1, 4)
    np.testing.assert_array_equal(moved.signal, signal)
    np.testing.assert_array_equal(moved.place, place)


@pytest.mark.parametrize(("kind", "mu"), CASES)
def test_settling_never_loses_and_the_same_draws_end_at_the_same_places(kind: str, mu: float) -> None:
    arena = arena_of(problem_of(fleet(kind, mu)))
    draws = np.random.default_rng(2).random((400, 6))

    def settled(heat: float) -> tuple[float, float, Array]:
        shots = snapshots_of(arena)
        before = look(arena, shots, arena.start_m)
        return before, settle(arena, shots, mean_user_m(arena), draws, before, heat), shots.place.copy()

    for heat in (0.0, 0.5):
        before, after, place = settled(heat)
        assert after > before * 1.05
        np.testing.assert_array_equal(place, settled(heat)[2])


def test_places_keep_out_of_zones_within_reach_and_apart() -> None:
    scenario = fleet(size=(6, 30, 12))
    zones = (
        NoFlyDisc(center_m=(300.0, 300.0), radius_m=90.0),
        NoFlyPolygon(vertices_m=((400.0, 20.0), (550.0, 30.0), (480.0, 260.0))),
    )
    uavs = tuple(uav.model_copy(update={"end_m": uav.start_m}) for uav in scenario.uavs)
    scenario = scenario.with_changes(no_fly=zones, uavs=uavs, min_separation_m=30.0)
    problem = problem_of(scenario)
    arena = arena_of(problem)
    for east, north in sites_m(arena).T:
        assert not any(zone_holds(zone, (float(east), float(north))) for zone in zones)
    found = places(arena, np.random.default_rng(3), Effort(4, 2, 600))
    assert found
    for place in found:
        away = np.hypot(*(place - arena.start_m))
        assert (2 * away <= problem.step_m * (problem.n_slots - 1) + 1e-9).all()
        assert not any(zone_holds(zone, (float(e), float(n))) for zone in zones for e, n in place.T)
    made = plan(scenario)
    assert violations(made) == []


def test_more_uavs_than_users_still_find_places() -> None:
    arena = arena_of(problem_of(fleet(size=(6, 3, 12))))
    found = places(arena, np.random.default_rng(0), Effort(4, 2, 200))
    assert len(found) == 2
    assert all(place.shape == (2, 6) and np.isfinite(place).all() for place in found)


def test_who_halts_the_search_for_places_gets_what_there_is() -> None:
    arena = arena_of(problem_of(fleet()))
    asked = iter(range(100))
    found = places(arena, np.random.default_rng(0), Effort(24, 2, 2000), halted=lambda: next(asked) >= 3)
    assert len(found) == 2
    assert places(arena, np.random.default_rng(0), Effort(24, 2, 2000), halted=lambda: True) == []


def test_a_replan_hears_only_of_places_that_are_clearly_better() -> None:
    problem = problem_of(fleet())
    arena = arena_of(problem)
    best = places(arena, np.random.default_rng(0), Effort(24, 1, 3000))[0]
    effort = effort_of(arena, warm=True)
    assert places(arena, np.random.default_rng(1), effort, best) == []
    assert len(places(arena, np.random.default_rng(1), effort, arena.start_m)) == 1


def test_uavs_are_bound_for_where_they_hover_before_they_turn_home() -> None:
    scenario = fleet(size=(6, 30, 40))
    first, *others = scenario.uavs
    home = first.model_copy(update={"end_m": first.start_m})
    arena = arena_of(problem_of(scenario.with_changes(uavs=(home, *others))))
    path = np.repeat(np.arange(40.0)[:, None, None], 2, axis=1) * np.ones(6)
    np.testing.assert_array_equal(bound(arena, path)[:, 0], [19.0, 19.0])
    np.testing.assert_array_equal(bound(arena, path)[:, 1], [35.0, 35.0])


@pytest.mark.parametrize(("kind", "mu"), CASES)
def test_a_fleet_earns_much_more_than_from_where_it_hovers_first(kind: str, mu: float) -> None:
    problem = problem_of(fleet(kind, mu, (10, 100, 50)))
    hover = problem.hover()
    climbed = optimise(problem, MaxIterations(50), hover, n_starts=1).history[-1].utility_bps
    searched = optimise(problem, MaxIterations(50), n_starts=2).history[-1].utility_bps
    assert searched > climbed * (1.03 if kind == "pooled" else 1.06)


@pytest.mark.parametrize(("kind", "mu"), CASES)
def test_the_search_of_a_fleet_is_the_same_for_the_same_inputs_and_never_falls_back(kind: str, mu: float) -> None:
    scenario = fleet(kind, mu)
    made, again = plan(scenario, seed=5), plan(scenario, seed=5)
    assert made == again
    utilities = [one.utility_bps for one in made.history]
    assert utilities == sorted(utilities)
    assert made.summary.utility_bps == pytest.approx(utilities[-1], rel=1e-9)


def test_uavs_that_cannot_move_are_planned_for_too() -> None:
    scenario = fleet()
    still = tuple(Uav(id=uav.id, start_m=uav.start_m, max_speed_mps=0.0) for uav in scenario.uavs)
    made = plan(scenario.with_changes(uavs=still))
    assert violations(made) == []
    assert made.summary.utility_bps > 0
