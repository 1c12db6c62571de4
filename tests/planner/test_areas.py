"""Large fleets by areas: as good as planning at once where that can run, never worse for a round, and flyable."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import (
    Changes,
    Channel,
    MaxIterations,
    Pins,
    Scenario,
    User,
    Utility,
    delivered_rates_bps,
    plan,
    replan,
    violations,
)
from skyfolio.planner.areas import size
from skyfolio.planner.areas.blocks import AreaProblem, Outside
from skyfolio.planner.areas.ceiling import slot_ceilings_kbps
from skyfolio.planner.areas.joint import joint_of
from skyfolio.planner.areas.partition import MOST, Area, cut, nearby, waves
from skyfolio.planner.areas.search import _one_by_one, _with_area
from skyfolio.planner.certificate import prove
from skyfolio.planner.fast import flyable, linked, served_rates_bps
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.problem import problem_of
from skyfolio.planner.remainder import places_changed_m
from skyfolio.planner.scenario import NoFlyDisc
from skyfolio.planner.sinr import spectral_efficiency
from skyfolio.planner.solution import Solution

BEYOND_THE_LETTER: tuple[dict[str, Any], ...] = (
    {"positions_m": ((1.0, 2.0), (3.0, 4.0), (5.0, 6.0)), "position_m": (1.0, 2.0)},
    {"velocity_mps": (1.0, 0.0)},
    {"uncertainty_m": 5.0},
    {"uncertainty_mps": 0.5},
    {"arrives_at_slot": 1},
    {"leaves_at_slot": 2},
    {"weight": 2.0},
    {"demand_bps": 5000.0},
)
LIKE_THE_LETTER: tuple[dict[str, Any], ...] = (
    {"velocity_mps": (0.0, 0.0)},
    {"uncertainty_m": 0.0, "uncertainty_mps": 0.0},
    {"arrives_at_slot": -4, "leaves_at_slot": 3},
    {"weight": 1.0},
)


@pytest.mark.parametrize(("kind", "mu"), [("sum", 0.0), ("sum", -0.01), ("per_user", -0.1), ("pooled", -0.1)])
def test_areas_come_within_one_per_cent_of_planning_at_once(kind: str, mu: float) -> None:
    scenario = laid_out(
        "clustered", 30, 200, 40, seed=2, utility=Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    )
    at_once, apart = plan(scenario), plan(scenario, method="areas")
    assert violations(apart) == []
    assert apart.summary.utility_bps >= 0.99 * at_once.summary.utility_bps
    assert at_once.summary.utility_bps <= apart.summary.upper_bound_bps
    gained = [one.utility_bps for one in apart.history]
    assert gained == sorted(gained)
    assert gained[-1] == pytest.approx(apart.summary.utility_bps)


@given(
    n_uavs=st.integers(1, 120),
    seed=st.integers(0, 10_000),
    turn=st.integers(0, 5),
    most=st.integers(1, 20),
    few=st.booleans(),
)
def test_every_uav_is_in_just_one_area(n_uavs: int, seed: int, turn: int, most: int, *, few: bool) -> None:
    rng = np.random.default_rng(seed)
    places_m = np.round(rng.uniform(0.0, 3000.0, (n_uavs, 2)), -2)  # some at the same place
    among = np.flatnonzero(rng.random(n_uavs) < 0.5) if few else np.arange(n_uavs)
    areas = cut(places_m, turn=turn, most=most, among=among)
    assert sorted(uav for area in areas for uav in area.own.tolist()) == among.tolist()
    for area in areas:
        assert 1 <= len(area.own) <= most
        assert len(set(area.uavs.tolist())) == len(area.uavs)
    for wave in waves(areas):
        together = np.concatenate([area.uavs for area in wave])
        assert len(set(together.tolist())) == len(together)  # no UAV is in two problems that are planned at once


@settings(max_examples=15)
@given(
    seed=st.integers(0, 10_000), kind=st.sampled_from(["per_user", "pooled"]), least_bps=st.sampled_from([0.0, 200.0])
)
def test_every_user_belongs_to_one_area_and_no_band_is_given_twice(seed: int, kind: str, least_bps: float) -> None:
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": -0.1})
    scenario = laid_out("uniform", MOST + 4, 60, 4, seed=seed, utility=utility)
    users = tuple(user.model_copy(update={"min_rate_bps": least_bps}) for user in scenario.users[:5])
    problem = problem_of(scenario.with_changes(users=(*users, *scenario.users[5:])))
    wish = problem.hover() + np.cumsum(np.random.default_rng(seed).normal(0.0, 20.0, (MOST + 4, 4, 2)), axis=1)
    paths_m = flyable(problem, wish)
    joint = joint_of(problem, paths_m, partial(_one_by_one, MaxIterations(50)))
    late = (0.9 * 3.0) // 1.0
    area_of = np.empty(MOST + 4, dtype=int)
    for number, area in enumerate(cut(paths_m[:, int(late)])):
        area_of[area.own] = number
    assert (np.ptp(area_of[joint.solution.serving], axis=1) == 0).all()
    assert _most_of_a_band(joint.solution, MOST + 4) <= 10_000.0 * (1 + 1e-9)


def _most_of_a_band(solution: Solution, n_uavs: int) -> float:
    """Return the most hertz that any UAV gives in any slot."""
    slots = solution.serving.shape[1]
    return max(
        float(np.bincount(solution.serving[:, n], solution.bandwidth_hz[:, n], n_uavs).max()) for n in range(slots)
    )


def test_an_areas_plan_takes_no_band_that_somebody_else_keeps() -> None:
    """User 1 is served by both UAVs, by the second one more, so it is left to the second; the first is planned anew."""
    whole = Solution(
        np.zeros((2, 3, 2)), np.array([[0, 0, 0], [0, 1, 1]]), np.array([[5e3, 1e4, 1e4], [5e3, 1e4, 1e4]]), []
    )
    nobody = np.zeros((1, 3), dtype=bool)
    empty = np.zeros((0, 3))
    outside = Outside(
        gain=empty,
        paths_m=np.zeros((0, 3, 2)),
        altitude_m=np.zeros(0),
        serves=nobody,
        sum_kbps=np.zeros(3),
        decayed=0.0,
    )
    area = Area(np.array([0]), np.zeros(0, dtype=np.int64))
    inner = AreaProblem(problem=problem_of(laid_out("uniform", 1, 1, 3, seed=1)), outside=outside)
    found = Solution(np.zeros((1, 3, 2)), np.zeros((1, 3), dtype=int), np.full((1, 3), 1e4), [])
    made = _with_area(whole, area, np.array([0]), inner, found)
    assert _most_of_a_band(made, 2) <= 1e4
    assert made.bandwidth_hz.tolist() == [[1e4, 1e4, 1e4], [0.0, 1e4, 1e4]]


def test_a_user_whom_another_area_serves_meanwhile_keeps_that() -> None:
    whole = Solution(np.zeros((2, 2, 2)), np.array([[1, 1]]), np.array([[1e4, 1e4]]), [])
    outside = Outside(
        gain=np.zeros((0, 2)),
        paths_m=np.zeros((0, 2, 2)),
        altitude_m=np.zeros(0),
        serves=np.zeros((1, 2), dtype=bool),  # as it was before the other area's plan was taken
        sum_kbps=np.zeros(2),
        decayed=0.0,
    )
    area = Area(np.array([0]), np.zeros(0, dtype=np.int64))
    inner = AreaProblem(problem=problem_of(laid_out("uniform", 1, 1, 2, seed=1)), outside=outside)
    found = Solution(np.zeros((1, 2, 2)), np.zeros((1, 2), dtype=int), np.array([[0.0, 1e4]]), [])
    made = _with_area(whole, area, np.array([0]), inner, found)
    assert made.serving.tolist() == [[1, 0]]
    assert made.bandwidth_hz.tolist() == [[1e4, 1e4]]


def _troubled(kind: str, mu: float) -> Scenario:
    """Return 24 UAVs in two areas at least, of which some leave, some have ends, and users with minimum rates."""
    utility = Utility.model_validate({"kind": kind, "mu_per_kbps": mu})
    scenario = laid_out("clustered", 24, 120, 16, seed=3, utility=utility)
    uavs = list(scenario.uavs)
    uavs[0] = uavs[0].model_copy(update={"end_m": uavs[0].start_m})
    uavs[10] = uavs[10].model_copy(update={"end_m": (uavs[10].start_m[0] + 80.0, uavs[10].start_m[1])})
    uavs[12] = uavs[12].model_copy(update={"leaves_at_slot": 9})
    users = [
        user.model_copy(update={"min_rate_bps": 50.0 if k % 40 == 0 else 0.0}) for k, user in enumerate(scenario.users)
    ]
    middle = scenario.area_m[1][0] / 2
    zone = NoFlyDisc(center_m=(middle + 140.0, middle + 70.0), radius_m=50.0)
    return scenario.with_changes(uavs=tuple(uavs), users=tuple(users), no_fly=(zone,), min_separation_m=30.0)


@pytest.mark.parametrize(("kind", "mu"), [("sum", -0.01), ("per_user", -0.1), ("pooled", -0.1)])
def test_all_constraints_hold_across_the_borders_of_areas(kind: str, mu: float) -> None:
    scenario = _troubled(kind, mu)
    made = plan(scenario, method="areas")
    assert violations(made) == []
    assert not made.unmet_min_rate_slots
    paths_m = np.array([made.trajectories_m[uav] for uav in scenario.uav_ids])
    serving = np.array([[scenario.uav_ids.index(uav) for uav in made.association[user]] for user in scenario.user_ids])
    hertz = np.array([made.bandwidth_hz[user] for user in scenario.user_ids])
    efficiency = np.take_along_axis(spectral_efficiency(problem_of(scenario), paths_m), serving[None], axis=0)[0]
    told_bps = np.array([made.user_rates_bps[user] for user in scenario.user_ids])
    np.testing.assert_allclose(told_bps, hertz * efficiency, rtol=1e-9, atol=1e-6)
    assert made.summary.utility_bps <= made.summary.upper_bound_bps


@settings(max_examples=8)
@given(
    seed=st.integers(0, 1000),
    utility=st.sampled_from([("sum", 0.0), ("sum", -0.02), ("per_user", -0.2), ("pooled", -0.2)]),
)
def test_no_round_makes_the_joint_utility_less_and_no_plan_exceeds_the_bound(
    seed: int, utility: tuple[str, float]
) -> None:
    wanted = Utility.model_validate({"kind": utility[0], "mu_per_kbps": utility[1]})
    made = plan(laid_out("two_towns", 20, 60, 8, seed=seed, utility=wanted), method="areas", n_starts=1)
    gained = [one.utility_bps for one in made.history]
    assert gained == sorted(gained)
    assert made.summary.utility_bps == pytest.approx(gained[-1])
    assert made.summary.utility_bps <= made.summary.upper_bound_bps


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), speed=st.floats(0.0, 1.0))
def test_no_flight_exceeds_the_ceiling_of_a_slot(seed: int, speed: float) -> None:
    problem = problem_of(laid_out("uniform", 6, 30, 24, seed=seed % 5))
    rng = np.random.default_rng(seed)
    wish = problem.hover() + speed * np.cumsum(rng.normal(0.0, 20.0, (6, 24, 2)), axis=1)
    solution = linked(problem, flyable(problem, wish))
    rates_kbps = served_rates_bps(problem, solution) / 1e3
    assert (rates_kbps.sum(axis=0) <= slot_ceilings_kbps(problem, rates_kbps) + 1e-9).all()


def test_other_fading_and_pins_are_refused_by_name() -> None:
    scenario = laid_out("uniform", 4, 10, 3, seed=1)
    for fading in ("sampled", "expected"):
        with pytest.raises(ValueError, match="fading"):
            plan(scenario.with_changes(channel=Channel(fading=fading)), method="areas", stop=MaxIterations(1))
    with pytest.raises(ValueError, match="pins"):
        plan(scenario, method="areas", pins=Pins(uavs=("uav-1",)), stop=MaxIterations(1))


def with_first_user(scenario: Scenario, fields: dict[str, Any]) -> Scenario:
    first, *others = scenario.users
    return scenario.with_changes(users=(first.model_copy(update=fields), *others))


@pytest.mark.parametrize("fields", BEYOND_THE_LETTER, ids=lambda fields: next(iter(fields)))
def test_users_beyond_the_letter_are_refused_by_name_and_planned_at_once(
    fields: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = with_first_user(laid_out("uniform", 4, 10, 3, seed=1), fields)
    with pytest.raises(
        ValueError, match=r"^users: the method 'areas' knows no tracks, windows, weights or demands; use 'fast'$"
    ):
        plan(scenario, method="areas", stop=MaxIterations(1))
    monkeypatch.setattr(size, "MOST_AT_ONCE", 4 * 10 * 3 - 1)
    made = plan(scenario, n_starts=1)
    assert made.method == "fast"
    assert violations(made) == []
    assert made.summary.utility_bps <= made.summary.upper_bound_bps * (1 + 1e-9)


@pytest.mark.parametrize("fields", LIKE_THE_LETTER, ids=lambda fields: next(iter(fields)))
def test_fields_that_say_nothing_new_leave_a_plan_by_areas_as_it_is(fields: dict[str, Any]) -> None:
    scenario = laid_out("uniform", 20, 60, 3, seed=1)
    said = plan(with_first_user(scenario, fields), method="areas", n_starts=1)
    plain = plan(scenario, method="areas", n_starts=1)
    assert said.trajectories_m == plain.trajectories_m
    assert said.bandwidth_hz == plain.bandwidth_hz


def test_a_large_fleet_is_planned_at_once_when_a_user_that_will_leave_joins(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = laid_out("uniform", 4, 10, 6, seed=1)
    made = plan(scenario, method="areas", n_starts=1)
    monkeypatch.setattr(size, "MOST_AT_ONCE", 1)
    guest = User(id="guest", position_m=(10.0, 10.0), leaves_at_slot=2)
    again = replan(made, at_slot=2, changes=Changes(users_joined=(guest,)))
    assert again.method == "fast"
    assert violations(again) == []
    later = replan(again, at_slot=5, changes=Changes())
    assert violations(later) == []


def test_a_loss_changes_only_the_paths_of_those_who_are_near(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = laid_out("corridor", 60, 240, 10, seed=1)
    monkeypatch.setattr(size, "MOST_AT_ONCE", 1000)
    before = plan(scenario, n_starts=1)
    lost = scenario.uav_ids[0]
    after = replan(before, failed=[lost], at_slot=2)
    assert before.method == after.method == "areas"
    at_m = np.array(before.trajectories_m[lost])[[2, -1]]
    rest = [uav for uav in scenario.uav_ids if uav != lost]
    places_m = np.array([before.trajectories_m[uav][8] for uav in rest])
    near = {rest[u] for u in nearby(places_m, at_m)}
    off_m = {
        uav: np.abs(np.array(after.trajectories_m[uav]) - np.array(before.trajectories_m[uav][2:])).max()
        for uav in rest
    }
    changed = {uav for uav, away_m in off_m.items() if away_m > 1e-9}
    assert changed
    assert changed <= near
    assert len(near) < len(rest)
    gone_on = problem_of(after.scenario)
    paths_m = flyable(gone_on, np.array([before.trajectories_m[uav][2:] for uav in rest]))
    unchanged = joint_of(gone_on, paths_m, partial(_one_by_one, MaxIterations(50)))
    now_bps = np.array([after.user_rates_bps[user] for user in scenario.user_ids])
    assert now_bps.sum() / 1e3 > unchanged.rates_kbps.sum()


@pytest.mark.parametrize(
    ("changes", "places"),
    [
        (Changes(utility=Utility(kind="sum", mu_per_kbps=-0.1)), "everywhere"),
        (Changes(), "everywhere"),
        (Changes(users_joined=(User(id="new", position_m=(10.0, 20.0)),)), [(10.0, 20.0)]),
        (Changes(users_left=("user-2",)), "user-2"),
    ],
)
def test_a_replan_looks_where_something_is_different(changes: Changes, places: object) -> None:
    made = plan(laid_out("uniform", 2, 4, 4, seed=1), n_starts=1)
    found = places_changed_m(made, 1, (), changes)
    wanted = {"everywhere": None, "user-2": [made.scenario.users[1].position_m]}
    assert found == (wanted[places] if isinstance(places, str) else places)


def test_large_fleets_are_proven_without_a_table_of_all_pairs_and_slots(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = laid_out("clustered", 24, 100, 12, seed=2)
    problem = problem_of(scenario)
    made = plan(scenario, method="areas", n_starts=1)
    rates_kbps = np.array([made.user_rates_bps[user] for user in scenario.user_ids]) / 1e3
    monkeypatch.setattr(size, "MOST_AT_ONCE", 1000)
    told: list[float] = []
    proven = prove(problem, rates_kbps, told=told.append)
    assert made.summary.utility_bps / 1e3 <= proven.bound_kbps <= proven.root_kbps
    assert proven.finished
    assert told == sorted(told, reverse=True)
    early = prove(problem, rates_kbps, stop=lambda: True)
    assert early.bound_kbps == early.root_kbps == proven.root_kbps
    assert not early.finished


def test_only_large_fleets_on_the_mean_channel_are_planned_by_areas(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = laid_out("uniform", 4, 10, 3, seed=1)
    assert plan(scenario, n_starts=1).method == "fast"
    monkeypatch.setattr(size, "MOST_AT_ONCE", 4 * 10 * 3 - 1)
    assert plan(scenario, n_starts=1).method == "areas"
    assert plan(scenario, n_starts=1, pins=Pins(uavs=("uav-1",))).method == "fast"
    for fading in ("sampled", "expected"):
        assert plan(scenario.with_changes(channel=Channel(fading=fading)), n_starts=1).method == "fast"


def test_a_fleet_that_is_planned_by_areas_is_corrected_uav_by_uav(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(size, "MOST_AT_ONCE", 1000)
    first = plan(laid_out("uniform", 20, 60, 10, seed=3, utility=Utility(kind="sum", mu_per_kbps=-0.01)))
    weak, strong = first.scenario.uav_ids[0], first.scenario.uav_ids[1]
    measured = {
        weak: {user: -9.0 - 0.5 * (k % 3) for k, user in enumerate(first.scenario.user_ids)},
        strong: {first.scenario.user_ids[0]: 8.0},
    }
    corrected = replan(first, at_slot=2, corrections_db=measured)
    assert corrected.method == "areas"
    assert corrected.scenario.channel.corrections_db == {weak: {"*": -9.5}}
    assert violations(corrected) == []
    problem, plain = problem_of(corrected.scenario), problem_of(first.scenario)
    assert problem.snr_gain[0, 0, 0] == pytest.approx(plain.snr_gain[0, 0, 0] * 10**-0.95)
    assert problem.snr_gain[1:, 0, 0] == pytest.approx(plain.snr_gain[1:, 0, 0])
    paths_m = np.array([corrected.trajectories_m[uav] for uav in corrected.scenario.uav_ids]).transpose(1, 0, 2)
    slots = np.arange(corrected.scenario.slots)
    delivered = delivered_rates_bps(corrected, slots, paths_m, np.ones((len(slots), 20), dtype=bool)).T
    promised = [corrected.user_rates_bps[user] for user in corrected.scenario.user_ids]
    np.testing.assert_allclose(delivered, promised, rtol=1e-9)
    assert corrected.summary.utility_bps <= corrected.summary.upper_bound_bps
    again = replan(corrected, at_slot=4)
    assert again.scenario.channel.corrections_db == {weak: {"*": -9.5}}
