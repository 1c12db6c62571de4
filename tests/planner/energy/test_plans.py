"""Plans in wind and with batteries come home from every slot, and who would not is refused by name."""

from math import hypot
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from skyfolio.planner import EXAMPLES, MaxIterations, PinError, Pins, Plan, Scenario, plan, replan, violations
from skyfolio.planner.energy.account import account_of, idle_paths_m
from skyfolio.planner.energy.outlook import Landing, charge_needed, landing_of, outlook_of
from skyfolio.planner.fast.arena import arena_of
from skyfolio.planner.fast.optimise import _affordable_starts
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import Battery, NoFlyDisc, Origin, RallyPoint, Uav, User, Wind
from skyfolio.planner.unreachable import UnreachableEndError

QUICK: dict[str, Any] = {"n_starts": 3, "stop": MaxIterations(4)}


def far_user(usable_wh: float | None = None, wind: Wind | None = None, slots: int = 40, **uav: Any) -> Scenario:
    """One UAV that would like to fly 800 m east, to its only user."""
    battery = {} if usable_wh is None else {"battery": Battery(usable_wh=usable_wh)}
    return Scenario(
        origin=Origin(lat_deg=47.0, lon_deg=8.0),
        area_m=((0.0, -200.0), (1000.0, 200.0)),
        slots=slots,
        slot_duration_s=5.0,
        altitude_m=60.0,
        min_separation_m=4.0,
        uavs=(Uav(id="uav-1", start_m=(50.0, 0.0), **{"max_speed_mps": 8.0, **battery, **uav}),),
        users=(User(id="user-1", position_m=(850.0, 0.0)),),
        **({} if wind is None else {"wind": wind}),
    )


def least_for(scenario: Scenario) -> float:
    """Return Wh with which the UAV could just stay at its start."""
    air = scenario.with_changes(uavs=(scenario.uavs[0].model_copy(update={"battery": Battery(usable_wh=1e4)}),)).air
    assert air is not None
    start = np.array([[scenario.uavs[0].start_m]], dtype=float)
    needed = air.before_wh[0] + air.hover_wh()[0] * scenario.slots + air.home_wh(start)[0, 0]
    return float(needed) / 0.8


def farthest_m(made: Plan) -> float:
    return max(hypot(e - 50.0, n) for e, n in made.trajectories_m["uav-1"])


def test_a_uav_flies_only_as_far_as_it_can_come_home_from() -> None:
    least = least_for(far_user())
    free, bound = plan(far_user(4 * least), **QUICK), plan(far_user(1.03 * least), **QUICK)
    assert farthest_m(free) == pytest.approx(800.0, abs=1.0)
    assert 50.0 < farthest_m(bound) < 700.0
    assert 0.0 <= min(bound.energy_margin_wh["uav-1"]) + 1e-9 < 0.01
    assert violations(bound) == []


def test_one_that_could_not_even_stay_is_refused_with_who_when_and_how_much() -> None:
    least = least_for(far_user())
    with pytest.raises(ValueError, match=r"uavs\.0\.battery: 'uav-1' would not come home .* after slot \d") as raised:
        far_user(0.9 * least)
    assert "Wh" in str(raised.value)
    leaves = int(str(raised.value).split("leaves_at_slot: ")[1].split(")")[0])
    assert plan(far_user(4 * least), **QUICK).status == "succeeded"
    two = far_user(4 * least)
    short = two.uavs[0].model_copy(
        update={"id": "uav-2", "start_m": (50.0, 100.0), "battery": Battery(usable_wh=0.9 * least)}
    )
    both = two.with_changes(uavs=(*two.uavs, short.model_copy(update={"leaves_at_slot": leaves})))
    assert violations(plan(both, **QUICK)) == []
    with pytest.raises(ValueError, match=r"uavs\.1\.battery: 'uav-2'"):
        two.with_changes(uavs=(*two.uavs, short.model_copy(update={"leaves_at_slot": leaves + 1})))


def test_a_rally_point_lets_it_fly_farther() -> None:
    least = least_for(far_user())
    near_user = (RallyPoint(position_m=(840.0, 0.0)),)
    without, with_rally = far_user(1.05 * least), far_user(1.05 * least).with_changes(rally_points=near_user)
    assert farthest_m(plan(with_rally, **QUICK)) >= farthest_m(plan(without, **QUICK))
    assert violations(plan(with_rally, **QUICK)) == []


def test_a_headwind_slows_the_way_there_and_a_tailwind_does_not() -> None:
    def arrives(east: float) -> int:
        made = plan(far_user(wind=Wind(east_mps=east, gust_mps=1.0), max_airspeed_mps=10.0), **QUICK)
        path = made.trajectories_m["uav-1"]
        return next((n for n, (e, _) in enumerate(path) if e > 849.0), len(path))

    assert arrives(5.0) == 20
    assert arrives(-5.0) == len(range(40))


def test_a_wind_that_it_cannot_hold_its_place_in_is_refused() -> None:
    with pytest.raises(ValueError, match=r"uavs\.0\.max_airspeed_mps: 'uav-1' flies 8 m/s through the air"):
        far_user(wind=Wind(east_mps=6.0, north_mps=4.0, gust_mps=1.0))


def test_an_end_that_the_wind_keeps_it_from_is_refused() -> None:
    far_user(end_m=(700.0, 0.0))
    with pytest.raises(ValueError, match=r"uavs\.0\.end_m: 'uav-1' is 650 m from its end, but through this wind"):
        far_user(end_m=(700.0, 0.0), wind=Wind(east_mps=-5.5, gust_mps=0.5), max_airspeed_mps=9.0)


def test_a_pinned_path_from_which_it_would_not_come_home_is_refused() -> None:
    scenario = far_user(1.03 * least_for(far_user()))
    path = tuple((50.0 + min(n, 20) * 40.0, 0.0) for n in range(40))
    with pytest.raises(
        PinError, match=r"pins\.paths_m\.uav-1: 'uav-1' would not come home with its reserve after slot"
    ):
        plan(scenario, pins=Pins(paths_m={"uav-1": path}), **QUICK)
    windy = far_user(wind=Wind(east_mps=-5.0), max_airspeed_mps=9.0)
    with pytest.raises(PinError, match="it can fly only"):
        plan(windy, pins=Pins(paths_m={"uav-1": path}), **QUICK)


def random_windy(seed: int) -> Scenario | None:
    """Several UAVs, some with batteries that hardly suffice, some with ends, in any wind."""
    rng = np.random.default_rng(seed)
    slots, side = int(rng.integers(2, 12)), 400.0
    speed = rng.uniform(0.0, 6.0)
    angle = rng.uniform(0.0, 2 * np.pi)
    wind = Wind(
        east_mps=float(speed * np.cos(angle)), north_mps=float(speed * np.sin(angle)), gust_mps=float(rng.uniform(0, 2))
    )

    def point() -> tuple[float, float]:
        return float(rng.uniform(0, side)), float(rng.uniform(0, side))

    uavs = tuple(
        Uav(
            id=f"uav-{u}",
            start_m=point(),
            max_speed_mps=float(rng.uniform(4, 12)),
            max_airspeed_mps=float(rng.uniform(8, 14)),
            battery=Battery(usable_wh=float(rng.uniform(8, 13)), reserve_share=0.1) if rng.random() < 0.7 else None,
            end_m=point() if rng.random() < 0.2 else None,
            home_m=point() if rng.random() < 0.3 else None,
            leaves_at_slot=int(rng.integers(1, slots + 1)) if rng.random() < 0.2 else None,
        )
        for u in range(int(rng.integers(1, 4)))
    )
    users = tuple(User(id=f"user-{k}", position_m=point()) for k in range(int(rng.integers(1, 6))))
    try:
        return Scenario(
            origin=Origin(lat_deg=1.0, lon_deg=1.0),
            area_m=((0.0, 0.0), (side, side)),
            slots=slots,
            slot_duration_s=5.0,
            altitude_m=60.0,
            min_separation_m=10.0,
            uavs=uavs,
            users=users,
            wind=wind,
            rally_points=(RallyPoint(position_m=point()),) if rng.random() < 0.3 else (),
        )
    except ValueError:
        return None


@example(93)  # the edge of the area turns a step, and the wind nearly keeps the UAV from its end
@given(st.integers(0, 10**6))
@settings(max_examples=150, suppress_health_check=[HealthCheck.filter_too_much])
def test_every_plan_and_replan_keeps_its_energy_and_flies_through_the_wind(seed: int) -> None:
    scenario = random_windy(seed)
    assume(scenario is not None)
    assert scenario is not None
    try:
        made = plan(scenario, n_starts=2, stop=MaxIterations(3))
    except UnreachableEndError:
        return
    assert violations(made) == []
    half = scenario.slots // 2
    flying = tuple(uav.id for uav in scenario.uavs if scenario.last_slot(uav) >= half)
    try:
        again = replan(made, at_slot=half, n_starts=2, stop=MaxIterations(3))
    except UnreachableEndError:
        return
    assert violations(again) == []
    assert again.scenario.uav_ids == flying


def test_a_replan_goes_on_with_the_battery_as_the_plan_has_proven_it() -> None:
    made = plan(far_user(1.03 * least_for(far_user())), **QUICK)
    again = replan(made, at_slot=15, **QUICK)
    battery = again.scenario.uavs[0].battery
    assert battery is not None
    assert again.scenario.uavs[0].home_m == (50.0, 0.0)
    assert again.scenario.uavs[0].leaves_at_slot is None
    assert made.energy_wh["uav-1"][14] <= (battery.used_wh or 0.0) + 1e-9
    assert violations(again) == []


def test_a_replan_lets_a_uav_leave_as_late_as_its_energy_lasts() -> None:
    least = least_for(far_user())
    one = far_user(4 * least)
    second = one.uavs[0].model_copy(
        update={"id": "uav-2", "start_m": (50.0, 100.0), "battery": Battery(usable_wh=1.001 * least)}
    )
    made = plan(one.with_changes(uavs=(*one.uavs, second)), **QUICK)
    adrift = replan(made, at_slot=10, positions_m={"uav-2": (600.0, 100.0)}, **QUICK)
    leaves = adrift.scenario.uav("uav-2").leaves_at_slot
    assert leaves is not None
    assert 1 <= leaves < 30
    assert violations(adrift) == []


@pytest.mark.parametrize(
    ("field", "change", "constraint"),
    [
        ("energy_margin_wh", 0.5, "energy"),
        ("energy_wh", -0.5, "energy"),
    ],
)
def test_the_check_finds_energy_that_is_told_better_than_it_is(field: str, change: float, constraint: str) -> None:
    made = plan(far_user(60.0, Wind(east_mps=2.0, gust_mps=1.0), slots=6), **QUICK)
    table = {uav: [value + change for value in row] for uav, row in getattr(made, field).items()}
    found = violations(made.model_copy(update={field: table}))
    assert {one.constraint for one in found} == {constraint}
    assert len(found) == 6


def test_the_check_finds_who_flies_too_fast_through_the_air_and_who_would_not_come_home() -> None:
    least = least_for(far_user())
    flown = plan(far_user(4 * least), **QUICK)
    against = flown.scenario.with_changes(wind=Wind(east_mps=-4.0))
    assert ("wind", "uav-1 slot 0") in {
        (one.constraint, one.where) for one in violations(flown.model_copy(update={"scenario": against}))
    }
    poor = far_user(1.01 * least)
    lacking = [one for one in violations(flown.model_copy(update={"scenario": poor})) if "lacks" in one.message]
    assert lacking
    assert lacking[0].constraint == "energy"


def test_a_scenario_without_wind_and_batteries_says_nothing_of_them() -> None:
    written = EXAMPLES["paper"]().model_dump_json()
    assert not any(f'"{field}"' in written for field in ("wind", "battery", "rotors", "rally_points", "home_m"))
    assert "energy" not in plan(EXAMPLES["minimal"](), **QUICK).model_dump_json()


def test_a_scenario_with_them_comes_back_as_it_was() -> None:
    scenario = far_user(50.0, Wind(east_mps=2.0, gust_mps=1.0), home_m=(60.0, 0.0)).with_changes(
        rally_points=(RallyPoint(position_m=(10.0, 10.0)),)
    )
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


def test_an_outlook_takes_what_was_used_beyond_the_plan_off_the_margin() -> None:
    made = plan(far_user(60.0, slots=10), **QUICK)
    used, margins = made.energy_wh["uav-1"], made.energy_margin_wh["uav-1"]
    as_planned = outlook_of(made, "uav-1", 5.0, 1.0 - used[4] / 60.0)
    assert as_planned is not None
    assert as_planned.expected_wh == pytest.approx(used[4])
    assert as_planned.at_end_wh == pytest.approx(used[-1])
    assert as_planned.margin_wh == pytest.approx(min(margins[5:]))
    thirsty = outlook_of(made, "uav-1", 5.0, 1.0 - (used[4] + 3.0) / 60.0)
    assert thirsty is not None
    assert thirsty.margin_wh == pytest.approx(min(margins[5:]) - 3.0)
    assert thirsty.at_end_wh == pytest.approx(used[-1] + 3.0)
    assert charge_needed(made, "uav-1") == pytest.approx(1.0 - min(margins) / 60.0)
    assert outlook_of(plan(far_user(slots=4), **QUICK), "uav-1", 1.0, 0.5) is None


def test_how_a_uav_comes_home_is_told_from_its_last_slot_with_the_reserve_and_only_with_a_battery() -> None:
    staying = Uav(id="uav-2", start_m=(50.0, 100.0), max_speed_mps=1.0)
    first = far_user(60.0, slots=10)
    leaving = first.uavs[0].model_copy(update={"leaves_at_slot": 7})
    made = plan(first.with_changes(uavs=(leaving, staying)), **QUICK)
    used, margins = made.energy_wh["uav-1"], made.energy_margin_wh["uav-1"]
    told = landing_of(made, "uav-1")
    assert told == Landing(
        used_wh=used[6], home_wh=margins[6] + 12.0, reserve_wh=12.0, spare_wh=min(margins[:7]), usable_wh=60.0
    )
    assert told.used_wh + told.home_wh < told.usable_wh  # the way home takes the rest
    assert landing_of(made, "uav-2") is None


def test_a_plan_that_spends_all_that_it_has_can_be_replanned_again_and_again() -> None:
    made = plan(far_user(1.03 * least_for(far_user())), **QUICK)
    for at_slot in (3, 9, 10, 17, 25, 38):
        made = replan(made, at_slot=at_slot, **QUICK)
        assert violations(made) == []
        assert made.scenario.uavs[0].leaves_at_slot is None


def test_an_end_from_the_way_to_which_it_would_not_come_home_is_refused_for_that_reason() -> None:
    scenario = far_user(max_speed_mps=20.0, end_m=END)
    with pytest.raises(ValueError, match=r"uavs\.0\.battery: 'uav-1' would not come home .* flew straight to its end"):
        far_user(0.998 * straight_wh(scenario), max_speed_mps=20.0, end_m=END)
    assert violations(plan(far_user(1.002 * straight_wh(scenario), max_speed_mps=20.0, end_m=END), **QUICK)) == []
    zone = NoFlyDisc(center_m=(450.0, 0.0), radius_m=150.0)
    around = far_user(1.002 * straight_wh(scenario), max_speed_mps=20.0, end_m=END).with_changes(no_fly=(zone,))
    with pytest.raises(UnreachableEndError, match=r"uavs\.0\.battery: 'uav-1' finds no way to its end_m"):
        plan(around, **QUICK)
    rich = far_user(2.0 * straight_wh(scenario), max_speed_mps=20.0, end_m=END).with_changes(no_fly=(zone,))
    assert violations(plan(rich, **QUICK)) == []


END = (950.0, 0.0)


def straight_wh(scenario: Scenario) -> float:
    """Return Wh with which the UAV can just fly straight to its end, and home from there."""
    ample = scenario.with_changes(uavs=(scenario.uavs[0].model_copy(update={"battery": Battery(usable_wh=1e4)}),))
    assert ample.air is not None
    last = np.array([scenario.slots])
    paths = idle_paths_m(np.array([scenario.uavs[0].start_m]), np.array([END]), last, scenario.slots)
    return float(8e3 - account_of(ample.air, paths, last).margin_wh.min()) / 0.8


def test_where_energy_is_short_half_as_many_starts_are_climbed_from() -> None:
    still = problem_of(EXAMPLES["minimal"]())
    short = problem_of(far_user(1.03 * least_for(far_user())))
    assert _affordable_starts(arena_of(still), 32) == 32
    assert _affordable_starts(arena_of(short), 32) == 16
    assert _affordable_starts(arena_of(problem_of(far_user(1e4))), 32) == 32
