"""What an operator must be able to trust: every constraint, on every plan and replan."""

from collections.abc import Iterator
from math import dist
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.planner import (
    Channel,
    Deadline,
    Origin,
    Plan,
    ReplanError,
    Scenario,
    StopToken,
    Uav,
    User,
    Utility,
    closest_approach,
    converged,
    plan,
    replan,
    violations,
)
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon
from skyfolio.planner.unreachable import UnreachableEndError

pytestmark = pytest.mark.long


def _zones(rng: np.random.Generator, side: float) -> Iterator[NoFlyDisc | NoFlyPolygon]:
    for _ in range(int(rng.integers(0, 3))):
        east, north = map(float, rng.uniform(0, side, 2))
        if rng.random() < 0.5:
            yield NoFlyDisc(center_m=(east, north), radius_m=float(rng.uniform(0.03, 0.2) * side))
            continue
        corners = int(rng.integers(3, 7))
        angle = 2 * np.pi * (np.arange(corners) + rng.uniform(0, 0.9, corners)) / corners
        reach = rng.uniform(0.03, 0.25) * side * rng.uniform(0.4, 1, corners)
        outline = zip(east + reach * np.cos(angle), north + reach * np.sin(angle), strict=True)
        yield NoFlyPolygon(vertices_m=tuple((float(e), float(n)) for e, n in outline))


def random_scenario(seed: int, fewest: int = 1, most: int = 4) -> Scenario | None:
    """Everything at once: speeds, bands, powers, altitudes, ends, leaving, zones, least rates, fading, utilities."""
    rng = np.random.default_rng(seed)
    side, slots = float(rng.choice([60.0, 200.0, 500.0])), int(rng.integers(1, 10))

    def point(margin: float = 0.0) -> tuple[float, float]:
        return float(rng.uniform(-margin, side + margin)), float(rng.uniform(-margin, side + margin))

    def uav(number: int) -> Uav:
        return Uav(
            id=f"uav-{number}",
            start_m=point(),
            max_speed_mps=float(rng.choice([0.0, 2.0, 5.0, 12.0])),
            bandwidth_hz=float(rng.choice([5e3, 1e4, 3e4])),
            transmit_power_w=float(rng.choice([0.05, 0.1, 1.0])),
            altitude_m=float(rng.choice([40.0, 90.0])) if rng.random() < 0.5 else None,
            end_m=point() if rng.random() < 0.4 else None,
            leaves_at_slot=int(rng.integers(1, slots + 1)) if rng.random() < 0.3 else None,
        )

    try:
        return Scenario(
            origin=Origin(lat_deg=1.0, lon_deg=1.0),
            area_m=((0.0, 0.0), (side, side)),
            slots=slots,
            slot_duration_s=5.0,
            altitude_m=60.0,
            min_separation_m=float(rng.choice([0.0, 4.0, 15.0])),
            uavs=tuple(uav(number) for number in range(rng.integers(fewest, most + 1))),
            users=tuple(
                User(
                    id=f"user-{k}",
                    position_m=point(20.0),
                    min_rate_bps=float(rng.choice([0, 0, 500.0, 3000.0, 8000.0])),
                )
                for k in range(rng.integers(1, 8))
            ),
            channel=Channel(
                noise_dbm=float(rng.choice([-55.0, -80.0])), fading="sampled" if rng.random() < 0.5 else "mean"
            ),
            utility=Utility.model_validate(
                {
                    "kind": str(rng.choice(["sum", "per_user", "pooled"])),
                    "mu_per_kbps": float(rng.choice([0.0, -0.01, -0.1, -1.0, -10.0])),
                    "exclude_fixed_slots": bool(rng.random() < 0.3),
                }
            ),
            no_fly=tuple(_zones(rng, side)),
        )
    except ValueError:
        return None


def test_five_hundred_random_plans_and_replans_pass_the_independent_checker() -> None:
    plans = replans = 0
    for seed in range(10_000):
        scenario = random_scenario(seed)
        if scenario is None:
            continue
        try:
            made = plan(scenario, n_starts=2, seed=seed)
        except UnreachableEndError:
            continue
        plans += 1
        assert violations(made) == [], seed
        gains = np.diff([one.utility_bps for one in made.history])
        assert (gains >= 0).all(), seed
        if len(scenario.uavs) > 1 and scenario.slots > 2:
            try:
                again = replan(made, failed=[scenario.uav_ids[0]], at_slot=scenario.slots // 2, n_starts=1)
            except (ReplanError, UnreachableEndError):
                continue
            replans += 1
            assert violations(again) == [], seed
        if plans >= 330 and replans >= 170:
            return
    pytest.fail("too few scenarios could be planned")


def test_random_plans_and_replans_of_fleets_pass_it_too_from_places_that_were_looked_for() -> None:
    plans = replans = 0
    for seed in range(10_000):
        scenario = random_scenario(seed, fewest=5, most=8)
        if scenario is None:
            continue
        try:
            made = plan(scenario, n_starts=3, seed=seed)
            plans += 1
            assert violations(made) == [], seed
            assert (np.diff([one.utility_bps for one in made.history]) >= 0).all(), seed
            if scenario.slots > 2:
                again = replan(made, failed=[scenario.uav_ids[0]], at_slot=scenario.slots // 2)
                replans += 1
                assert violations(again) == [], seed
        except (ReplanError, UnreachableEndError):
            continue
        if plans >= 30 and replans >= 20:
            return
    pytest.fail("too few scenarios could be planned")


@settings(max_examples=25)
@given(st.integers(0, 2**31))
def test_the_utility_never_decreases_and_is_what_the_plan_gives(seed: int) -> None:
    scenario = random_scenario(seed)
    if scenario is None:
        return
    try:
        made = plan(scenario, n_starts=3)
    except UnreachableEndError:
        return
    utilities = [one.utility_bps for one in made.history]
    assert utilities == sorted(utilities)
    if utilities:
        assert made.summary.utility_bps == pytest.approx(utilities[-1], rel=1e-6, abs=1e-3)


def field(slots: int = 12, **changes: Any) -> Scenario:
    """Two fast UAVs in a row, each far from the user with which it would serve best."""
    return Scenario(
        origin=Origin(lat_deg=1.0, lon_deg=1.0),
        area_m=((0.0, 0.0), (400.0, 200.0)),
        slots=slots,
        slot_duration_s=5.0,
        altitude_m=40.0,
        min_separation_m=20.0,
        uavs=(
            Uav(id="uav-1", start_m=(100.0, 100.0), max_speed_mps=10.0),
            Uav(id="uav-2", start_m=(300.0, 100.0), max_speed_mps=10.0),
        ),
        users=(User(id="user-1", position_m=(20.0, 100.0)), User(id="user-2", position_m=(380.0, 100.0))),
        channel=Channel(noise_dbm=-55.0),
    ).with_changes(**changes)


def test_uavs_that_must_cross_slide_past_each_other_between_the_slots_too() -> None:
    left, right = field().uavs
    crossing = field(
        uavs=(left.model_copy(update={"end_m": (300.0, 100.0)}), right.model_copy(update={"end_m": (100.0, 100.0)}))
    )
    made = plan(crossing)
    paths = np.array(list(made.trajectories_m.values()))
    assert violations(made) == []
    assert closest_approach(paths) >= 20.0 - 1e-9
    assert made.trajectories_m["uav-1"][-1] == (300.0, 100.0)


POCKET = (
    *((40.0, 50.0), (90.0, 50.0), (90.0, 70.0), (60.0, 70.0)),
    *((60.0, 130.0), (90.0, 130.0), (90.0, 150.0), (40.0, 150.0)),
)


@pytest.mark.parametrize(
    "wall",
    [
        NoFlyDisc(center_m=(60.0, 100.0), radius_m=25.0),
        NoFlyPolygon(vertices_m=((50.0, 60.0), (70.0, 60.0), (70.0, 140.0), (50.0, 140.0))),
        NoFlyPolygon(vertices_m=POCKET),
    ],
    ids=["disc", "wall", "pocket"],
)
def test_a_uav_finds_its_way_around_a_zone(wall: NoFlyDisc | NoFlyPolygon) -> None:
    made = plan(field(no_fly=(wall,)))
    assert violations(made) == []
    assert dist(made.trajectories_m["uav-1"][-1], (20.0, 100.0)) < 20.0


def test_a_uav_behind_a_wall_flies_home_around_it_in_time() -> None:
    wall = NoFlyPolygon(vertices_m=((50.0, 20.0), (70.0, 20.0), (70.0, 180.0), (50.0, 180.0)))
    left, right = field().uavs
    made = plan(field(no_fly=(wall,), uavs=(left.model_copy(update={"end_m": (20.0, 100.0)}), right)))
    assert violations(made) == []
    assert made.trajectories_m["uav-1"][-1] == (20.0, 100.0)


def test_an_end_that_cannot_be_reached_around_a_wall_is_refused() -> None:
    wall = NoFlyPolygon(vertices_m=((50.0, 0.0), (70.0, 0.0), (70.0, 200.0), (50.0, 200.0)))
    left, right = field().uavs
    with pytest.raises(UnreachableEndError, match=r"uavs\.0\.end_m: 'uav-1' finds no way around the no_fly zones"):
        plan(field(no_fly=(wall,), uavs=(left.model_copy(update={"end_m": (20.0, 100.0)}), right)))


def test_two_that_cannot_pass_each_other_in_a_corridor_are_named() -> None:
    west, east = (30.0, 2.0), (220.0, 2.0)
    left, right = field().uavs
    third = left.model_copy(update={"id": "uav-3", "start_m": (125.0, 2.0), "end_m": None})
    swap = (
        left.model_copy(update={"start_m": west, "end_m": east}),
        third,
        right.model_copy(update={"start_m": east, "end_m": west}),
    )
    corridor = field(area_m=((0.0, 0.0), (250.0, 4.0)), uavs=swap, min_separation_m=5.0, slots=40)
    with pytest.raises(UnreachableEndError, match=r"'uav-1' and 'uav-(2|3)' find no way past each other"):
        plan(corridor)


@settings(max_examples=60)
@given(
    east=st.floats(-90_000, 90_000),
    north=st.floats(-90_000, 90_000),
    angle=st.floats(0, 6.28),
    speed=st.floats(0.5, 40.0),
    slots=st.integers(2, 60),
    share=st.floats(0.999999, 1.0),
)
def test_an_end_at_exactly_the_reach_is_reached_at_full_speed(
    east: float, north: float, angle: float, speed: float, slots: int, share: float
) -> None:
    far = speed * 4.0 * (slots - 1) * share
    end = (east + far * float(np.cos(angle)), north + far * float(np.sin(angle)))
    uav = field().uavs[0].model_copy(update={"start_m": (east, north), "end_m": end, "max_speed_mps": speed})
    try:
        scenario = field(
            area_m=((-100_000.0, -100_000.0), (100_000.0, 100_000.0)), uavs=(uav,), slots=slots, slot_duration_s=4.0
        )
    except ValueError:
        return  # the rounding of `end` itself carried it out of reach
    made = plan(scenario, n_starts=1)
    assert violations(made) == []
    assert made.trajectories_m["uav-1"][-1] == end


def test_a_uav_that_leaves_serves_nobody_from_then_on_and_its_user_gets_another() -> None:
    left, right = field().uavs
    made = plan(field(uavs=(left.model_copy(update={"leaves_at_slot": 5}), right)))
    assert violations(made) == []
    assert "uav-1" in made.association["user-1"][:5]
    assert all(row[5:] == ["uav-2"] * 7 for row in made.association.values())


def test_least_rates_are_kept_and_what_cannot_be_served_is_said() -> None:
    users = tuple(user.model_copy(update={"min_rate_bps": 2_000.0}) for user in field().users)
    crowd = (
        *users,
        User(id="user-3", position_m=(90.0, 110.0), min_rate_bps=2_000.0),
        User(id="user-4", position_m=(200.0, 100.0)),
    )
    made = plan(field(users=crowd))
    assert made.status == "succeeded"
    assert min(min(made.user_rates_bps[f"user-{k}"]) for k in (1, 2, 3)) >= 2_000.0 * (1 - 1e-9)
    greedy = plan(field(users=(*crowd[:3], crowd[3].model_copy(update={"min_rate_bps": 1e6}))))
    assert greedy.status == "infeasible"
    assert greedy.unmet_min_rate_slots == {"user-4": list(range(12))}
    assert violations(greedy) == []


@pytest.mark.parametrize("polls", [0, 1, 2, 5, 20])
def test_a_plan_stopped_at_any_time_is_feasible_and_later_is_not_worse(polls: int) -> None:
    def stopped_after(count: int) -> Plan:
        left = iter(range(count))
        return plan(field(), n_starts=8, stop=StopToken(lambda: next(left, None) is None))

    made = stopped_after(polls)
    assert made.status == "cancelled"
    assert violations(made) == []
    assert stopped_after(polls + 5).summary.utility_bps >= made.summary.utility_bps


def test_a_deadline_ends_all_starts() -> None:
    clock = iter(range(1000))
    made = plan(field(), n_starts=32, stop=Deadline(6.5, clock=lambda: float(next(clock))))
    assert made.status == "cancelled"
    assert len(made.history) <= 6
    assert plan(field(), n_starts=32, stop=converged()).status == "succeeded"


def _extreme(least: float, most: float) -> st.SearchStrategy[float]:
    return st.sampled_from([least, most]) | st.floats(least, most)


@settings(max_examples=80)
@given(
    altitude_m=_extreme(0.1, 20_000),
    bandwidth_hz=_extreme(1, 1e11),
    power_w=_extreme(1e-12, 1e6),
    noise_dbm=_extreme(-250, 100),
    gain_db=_extreme(-200, 100),
    mu=st.sampled_from([0.0, -1e-9, -0.3, -1e6]),
    kind=st.sampled_from(["sum", "per_user", "pooled"]),
    least_bps=st.sampled_from([0.0, 1e3, 1e15]),
)
def test_every_scenario_within_the_limits_is_planned_with_finite_numbers(
    altitude_m: float,
    bandwidth_hz: float,
    power_w: float,
    noise_dbm: float,
    gain_db: float,
    mu: float,
    kind: Any,
    least_bps: float,
) -> None:
    users = tuple(user.model_copy(update={"min_rate_bps": least_bps}) for user in field().users)
    uavs = tuple(
        uav.model_copy(update={"bandwidth_hz": bandwidth_hz, "transmit_power_w": power_w}) for uav in field().uavs
    )
    scenario = field(
        altitude_m=altitude_m,
        uavs=uavs,
        users=users,
        channel=Channel(noise_dbm=noise_dbm, reference_gain_db=gain_db),
        utility=Utility(kind=kind, mu_per_kbps=mu),
    )
    made = plan(scenario, n_starts=4)
    assert violations(made) == []
    assert Plan.model_validate_json(made.model_dump_json()).summary == made.summary
