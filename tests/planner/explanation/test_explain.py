"""Why a plan is as it is: hand-made scenarios whose reason is known, and numbers against independent plans."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skyfolio.planner import (
    Budget,
    Channel,
    Explanation,
    Origin,
    Past,
    Pins,
    Plan,
    Scenario,
    Uav,
    User,
    Utility,
    explain,
    letter,
    plan,
    replan,
)
from skyfolio.planner.explanation import resolving
from skyfolio.planner.explanation.findings import UserReasons, Worth
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.scenario import NoFlyDisc, NoFlyPolygon

FEW = Budget(starts=3)
BOUNDS_ONLY = Budget(most_cells=0)


def scene(uavs: tuple[Uav, ...], users: dict[str, tuple[float, float]], **changes: Any) -> Scenario:
    """A quiet scene 1,000 m by 400 m, with so much noise that a kilometre is too far."""
    return Scenario(
        origin=Origin(lat_deg=0.0, lon_deg=0.0),
        area_m=((0.0, 0.0), (1000.0, 400.0)),
        slots=12,
        slot_duration_s=5.0,
        altitude_m=30.0,
        min_separation_m=4.0,
        uavs=uavs,
        users=tuple(User(id=name, position_m=at) for name, at in users.items()),
        channel=Channel(noise_dbm=-60.0),
        **changes,
    )


def of(explanation: Explanation, user: str) -> UserReasons:
    return next(row for row in explanation.users if row.user_id == user)


def worth(explanation: Explanation, what: str, method: str, uav: str | None = None) -> Worth:
    return next(
        row
        for row in explanation.worth
        if row.what == what and row.method == method and (uav is None or row.uav_id == uav)
    )


@pytest.fixture(scope="module")
def letters_plan() -> Plan:
    return plan(letter())


@pytest.fixture(scope="module")
def explained(letters_plan: Plan) -> Explanation:
    return explain(letters_plan, budget=FEW)


def test_a_user_that_no_uav_can_get_near_in_time_is_out_of_reach() -> None:
    slow = Uav(id="slow", start_m=(50.0, 200.0), max_speed_mps=1.0)
    explanation = explain(plan(scene((slow,), {"near": (50.0, 200.0), "far": (950.0, 200.0)})))
    far = of(explanation, "far")
    assert (far.level, far.main) == ("none", "reach")
    assert far.price_per_bps is not None
    assert far.price_per_bps > 5.0, "its bits are dearer than those of the user under the UAV"
    assert of(explanation, "near").level == "served"
    assert of(explanation, "near").reasons == ()


def test_a_user_whom_a_uav_could_fly_to_but_does_not_is_too_far_from_the_plan() -> None:
    swift = Uav(id="swift", start_m=(50.0, 200.0), max_speed_mps=50.0)
    users = {"near": (50.0, 200.0), "far": (900.0, 200.0)}
    far = of(explain(plan(scene((swift,), users))), "far")
    assert (far.level, far.main) == ("none", "distance")
    [distance] = [reason for reason in far.reasons if reason.kind == "distance"]
    assert "within 850 m" in distance.detail


def test_a_user_next_to_the_one_that_gets_the_band_lacks_band() -> None:
    only = Uav(id="only", start_m=(50.0, 200.0), max_speed_mps=0.0)
    explanation = explain(plan(scene((only,), {"under": (50.0, 200.0), "beside": (50.0, 206.0)})))
    beside = of(explanation, "beside")
    assert (beside.level, beside.main) == ("none", "band")
    snr = 0.1 * 1e-2 / 1e-9 / np.array([30.0**2, 30.0**2 + 6.0**2])
    under, whole = 10_000.0 * np.log2(1.0 + snr)
    assert beside.reasons[0].rate_bps == pytest.approx(whole)
    assert beside.reasons[0].gain_bps == pytest.approx(whole)
    assert beside.price_per_bps == pytest.approx(under / whole - 1.0, rel=1e-6)


def test_a_user_beside_an_interferer_lacks_silence() -> None:
    """Four UAVs that cannot move around one user: whichever serves it is drowned by the other three."""
    still = [(500.0, 190.0), (500.0, 210.0), (490.0, 200.0), (50.0, 200.0)]
    uavs = tuple(Uav(id=f"uav-{u}", start_m=at, max_speed_mps=0.0) for u, at in enumerate(still))
    explanation = explain(plan(scene(uavs, {"alone": (50.0, 200.0), "amid": (500.0, 200.0)})))
    amid = of(explanation, "amid")
    assert amid.main == "interference"
    assert amid.reasons[0].kind == "interference"
    assert of(explanation, "alone").level == "served"


def test_a_user_behind_a_wall_that_no_uav_may_cross_is_kept_from_it_by_the_zone() -> None:
    wall = NoFlyPolygon(vertices_m=((300.0, 0.0), (320.0, 0.0), (320.0, 400.0), (300.0, 400.0)))
    uavs = (
        Uav(id="west", start_m=(200.0, 100.0), max_speed_mps=8.0),
        Uav(id="other", start_m=(280.0, 300.0), max_speed_mps=8.0),
    )
    walled = scene(uavs, {"home": (200.0, 100.0), "behind": (600.0, 300.0)}, no_fly=(wall,))
    walled = walled.with_changes(channel=Channel(noise_dbm=-45.0))
    made = plan(walled)
    behind = of(explain(made, budget=FEW), "behind")
    assert behind.level == "little"
    assert behind.main == "no_fly"
    [reason] = [reason for reason in behind.reasons if reason.method == "resolve"]
    independent = plan(walled.with_changes(no_fly=()))
    rate = float(np.mean(independent.user_rates_bps["behind"]))
    assert reason.rate_bps == pytest.approx(rate, rel=0.02)


def test_a_user_inside_a_zone_is_kept_from_the_uavs_by_it_even_without_a_resolve() -> None:
    zone = NoFlyDisc(center_m=(500.0, 200.0), radius_m=180.0)
    uav = Uav(id="uav", start_m=(300.0, 200.0), max_speed_mps=20.0)
    made = plan(scene((uav,), {"inside": (500.0, 200.0), "outside": (300.0, 200.0)}, no_fly=(zone,)))
    inside = of(explain(made, budget=BOUNDS_ONLY), "inside")
    assert {reason.method for reason in inside.reasons} == {"bound"}
    kinds = [reason.kind for reason in inside.reasons]
    assert "no_fly" in kinds
    assert inside.main == "no_fly"


def test_a_user_that_a_uav_leaves_behind_lacks_its_battery() -> None:
    stays = Uav(id="stays", start_m=(50.0, 200.0), max_speed_mps=0.0)
    leaves = Uav(id="leaves", start_m=(950.0, 200.0), max_speed_mps=0.0, leaves_at_slot=2)
    made = plan(scene((stays, leaves), {"kept": (50.0, 200.0), "left": (950.0, 200.0)}))
    explanation = explain(made)
    left = of(explanation, "left")
    assert (left.level, left.main) == ("little", "battery")
    [reason] = [reason for reason in left.reasons if reason.method == "resolve"]
    assert reason.rate_bps == pytest.approx(6 * left.mean_rate_bps, rel=1e-3), "twelve slots instead of two"
    [price] = [row for row in explanation.constraints if row.constraint == "battery"]
    assert (price.uav_ids, price.slots, price.per, price.method) == (("leaves",), 10, "lifted", "resolve")
    assert price.price_bps is not None
    assert 0.0 < price.price_bps < reason.gain_bps, "its signal disturbs the other user"


def test_the_steps_of_the_ladder_add_up_to_a_uav_overhead_and_alone(explained: Explanation) -> None:
    overhead = 10_000.0 * np.log2(1.0 + 0.1 * 1e-2 / 1e-11 / 60.0**2)
    short = [row for row in explained.users if row.level != "served"]
    assert short
    for row in short:
        steps = [reason for reason in row.reasons if reason.method == "bound"]
        assert max(step.rate_bps for step in steps) == pytest.approx(overhead)
        total = row.mean_rate_bps + sum(step.gain_bps for step in steps)
        assert total == pytest.approx(overhead, rel=0.02), "tiny steps are left out"


def test_what_more_band_is_worth_is_what_an_independent_plan_gains(letters_plan: Plan, explained: Explanation) -> None:
    scenario = letter()
    first, *others = scenario.uavs
    wider = scenario.with_changes(uavs=(first.model_copy(update={"bandwidth_hz": 11_000.0}), *others))
    paths = np.array([letters_plan.trajectories_m[uav] for uav in scenario.uav_ids])
    again = plan(wider, past=Past(), warm_start_m=paths, n_starts=3)
    row = worth(explained, "more_band", "resolve", "uav-1")
    assert row.utility_gain_bps == pytest.approx(again.summary.utility_bps - explained.searched_utility_bps)
    cold = plan(wider).summary.utility_bps
    assert explained.searched_utility_bps + row.utility_gain_bps == pytest.approx(cold, rel=5e-3)
    derivative = worth(explained, "more_band", "derivative", "uav-1")
    assert derivative.utility_gain_bps == pytest.approx(row.utility_gain_bps, rel=0.05)


def test_what_a_moved_start_is_worth_is_what_an_independent_plan_gains(explained: Explanation) -> None:
    row = worth(explained, "moved_start", "resolve", "uav-2")
    east, north = (float(part) for part in row.detail.split("(")[1].split(")")[0].split(","))
    uavs = tuple(
        uav.model_copy(update={"start_m": (east, north)}) if uav.id == "uav-2" else uav for uav in letter().uavs
    )
    cold = plan(letter().with_changes(uavs=uavs)).summary.utility_bps
    assert explained.searched_utility_bps + row.utility_gain_bps == pytest.approx(cold, rel=5e-3)


def test_what_one_more_uav_is_worth_lies_below_its_bound_and_is_what_an_independent_plan_gains() -> None:
    made = plan(laid_out("clustered", 2, 8, 10, seed=3))
    explanation = explain(made)
    row, bound = (worth(explanation, "one_more_uav", method) for method in ("resolve", "bound"))
    assert row.utility_gain_bps <= bound.utility_gain_bps
    place = row.detail.split("start_m (")[1].split(")")[0].split(",")
    uav = made.scenario.uavs[0].model_copy(
        update={"id": "extra", "start_m": (round(float(place[0]), 1), round(float(place[1]), 1))}
    )
    cold = plan(made.scenario.with_changes(uavs=(*made.scenario.uavs, uav))).summary.utility_bps
    assert explanation.searched_utility_bps + row.utility_gain_bps == pytest.approx(cold, rel=0.02)


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
def test_the_price_of_speed_is_what_a_little_more_of_it_gains(kind: str) -> None:
    """One UAV and one user 300 m away: it flies there at full speed, and arrives."""
    uav = Uav(id="uav", start_m=(100.0, 200.0), max_speed_mps=10.0)
    scenario = scene((uav,), {"user": (400.0, 200.0)}, utility=Utility(kind=kind, mu_per_kbps=-0.02))
    [price] = [row for row in explain(plan(scenario)).constraints if row.constraint == "speed"]
    assert price.slots in {5, 6}
    faster = scenario.with_changes(uavs=(uav.model_copy(update={"max_speed_mps": 10.02}),))
    gain = plan(faster).summary.utility_bps - plan(scenario).summary.utility_bps
    assert price.price_bps == pytest.approx(gain / 0.02, rel=0.05)


def test_the_price_of_a_hertz_is_what_a_little_more_of_it_gains(two_uavs_four_users: Any) -> None:
    made = plan(two_uavs_four_users())
    explanation = explain(made)
    prices = [row for row in explanation.constraints if row.constraint == "band"]
    assert [row.price_bps for row in prices] == pytest.approx([3.0, 3.0]), "SINR 7: 3 bit/s of utility a hertz"
    assert [row.slots for row in prices] == [3, 3]


def test_two_uavs_that_would_share_a_place_are_kept_apart_at_a_price() -> None:
    """Both want to be over the same spot between two users who stand close together; 60 m is too much for that."""
    uavs = tuple(Uav(id=f"uav-{u}", start_m=(470.0 + 60.0 * u, 200.0), max_speed_mps=5.0) for u in range(2))
    users = {"a": (500.0, 200.0), "b": (400.0, 200.0)}
    made = plan(scene(uavs, users, utility=Utility(kind="sum")).with_changes(min_separation_m=60.0))
    [price] = [row for row in explain(made).constraints if row.constraint == "separation"]
    assert price.uav_ids == ("uav-0", "uav-1")
    assert price.slots >= 1
    assert price.price_bps is not None
    assert price.price_bps >= 0.0


def test_large_fleets_get_bounds_and_derivatives_only_and_are_told_so() -> None:
    made = plan(laid_out("uniform", 6, 20, 10, seed=1))
    explanation = explain(made, budget=Budget(most_cells=1_000))
    assert explanation.resolves == 0
    assert explanation.complete
    assert "bounds and derivatives only" in explanation.notes[0]
    assert {row.method for row in explanation.worth} == {"bound", "derivative"}
    assert {row.method for user in explanation.users for row in user.reasons} == {"bound"}
    assert [row.price_bps for row in explanation.constraints if row.per == "lifted"] == [None]


def test_a_spent_budget_and_a_stop_leave_bounds_and_say_so(letters_plan: Plan) -> None:
    spent = explain(letters_plan, budget=Budget(most_resolves=2))
    assert spent.resolves == 2
    assert "all 2 resolves are spent" in spent.notes[0]
    calls = iter([False] * 40)
    stopped = explain(letters_plan, stop=lambda: next(calls, True))
    assert not stopped.complete
    assert "time was up" in stopped.notes[0]
    assert worth(stopped, "more_band", "derivative", "uav-1")
    full = explain(letters_plan)
    assert stopped.resolves < full.resolves
    known = {(row.what, row.uav_id): row for row in full.worth if row.method == "resolve"}
    for row in stopped.worth:
        if row.method == "resolve":
            assert row == known[row.what, row.uav_id], "no half-done resolve is shown"


def test_a_replan_is_explained_with_its_past_and_on_its_own_slots(letters_plan: Plan) -> None:
    again = replan(letters_plan, failed=["uav-3"], at_slot=8)
    explanation = explain(again)
    assert explanation.utility_bps == again.summary.utility_bps
    assert explanation.searched_utility_bps == pytest.approx(again.summary.utility_bps, rel=5e-3)
    assert {row.uav_id for row in explanation.worth} >= {"uav-1", "uav-2"}
    served = [row for row in explanation.users if row.level == "served"]
    for row in served:
        assert row.mean_rate_bps == pytest.approx(float(np.mean(again.user_rates_bps[row.user_id])))


def test_the_same_plan_has_the_same_explanation(letters_plan: Plan, explained: Explanation) -> None:
    assert explain(letters_plan, budget=FEW) == explained


@pytest.mark.parametrize("kind", ["sum", "per_user", "pooled"])
@pytest.mark.parametrize("slots", [1, 2, 9])
def test_every_constraint_there_is_can_be_explained(kind: str, slots: int) -> None:
    """Ends, departures, zones, minimum rates, own altitudes, sampled fading, and slot 0 left out."""
    easy = laid_out("uniform", 3, 6, slots, seed=slots)
    first, second, third = easy.uavs
    zone = NoFlyDisc(center_m=(easy.users[0].position_m[0], easy.users[0].position_m[1]), radius_m=5.0)
    scenario = easy.with_changes(
        uavs=(
            first.model_copy(update={"end_m": first.start_m}),
            second.model_copy(update={"leaves_at_slot": max(1, slots // 2)}),
            third.model_copy(update={"altitude_m": 90.0}),
        ),
        users=(easy.users[0].model_copy(update={"min_rate_bps": 2_000.0}), *easy.users[1:]),
        no_fly=(zone,),
        channel=Channel(fading="sampled", noise_dbm=-60.0, seed=3),
        utility=Utility(kind=kind, mu_per_kbps=-0.1, exclude_fixed_slots=True),
    )
    explanation = explain(plan(scenario))
    assert explanation.complete
    there = {row.constraint for row in explanation.constraints if row.per == "lifted"}
    assert there == {"separation", "no_fly", "end", "min_rate"} | ({"battery"} if slots > 1 else set())
    prices = {row.constraint: row.price_bps for row in explanation.constraints if row.per == "lifted"}
    assert None not in prices.values()
    assert min(price or 0.0 for constraint, price in prices.items() if constraint != "battery") >= 0.0
    assert Explanation.model_validate_json(explanation.model_dump_json()) == explanation


def test_users_that_all_get_nothing_have_reasons_too() -> None:
    deaf = scene((Uav(id="uav", start_m=(0.0, 0.0), max_speed_mps=0.0),), {"a": (900.0, 0.0)})
    made = plan(deaf)
    silent = made.model_copy(update={"user_rates_bps": {"a": [0.0] * 12}, "bandwidth_hz": {"a": [0.0] * 12}})
    assert of(explain(silent, budget=BOUNDS_ONLY), "a").level == "none"


def test_a_budget_without_a_start_is_refused() -> None:
    with pytest.raises(ValueError, match="starts: 0 must be at least 1"):
        Budget(starts=0)


@pytest.fixture(scope="module")
def held() -> Plan:
    """A UAV pinned to hover far from everybody, and a user pinned to it beside the other UAV."""
    uavs = (Uav(id="far", start_m=(900.0, 200.0)), Uav(id="near", start_m=(100.0, 200.0)))
    users = {"pinned": (100.0, 230.0), "free": (100.0, 170.0), "east": (700.0, 200.0)}
    pins = Pins(uavs=("far",), associations={"pinned": "far"})
    return plan(scene(uavs, users), pins=pins)


def test_resolves_of_a_pinned_plan_hold_its_pins(held: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Plan] = []

    def noted(*args: Any, **options: Any) -> Plan:
        made.append(plan(*args, **options))
        return made[-1]

    monkeypatch.setattr(resolving, "plan", noted)
    explanation = explain(held, budget=FEW)
    assert explanation.resolves == len(made) >= 6
    free = [one for one in made if not one.pins]
    assert len(free) == 1, "only the price of the pins is found without them"
    for one in made:
        if one.pins:
            assert one.trajectories_m["far"] == held.trajectories_m["far"]
            assert set(one.association["pinned"]) == {"far"}


def test_pins_have_a_price_and_are_the_reason_of_a_user_that_they_keep_from_its_server(held: Plan) -> None:
    explanation = explain(held, budget=FEW)
    (price,) = (row for row in explanation.constraints if row.constraint == "pins")
    free = plan(held.scenario)
    gain = free.summary.utility_bps - explanation.searched_utility_bps
    assert price.price_bps == pytest.approx(gain, rel=0.02)
    assert price.slots == 12 + 12  # the hovering path, and the user's slots
    kept = of(explanation, "pinned")
    assert (kept.level, kept.main) == ("none", "pins")
    ladder = of(explain(held, budget=BOUNDS_ONLY), "pinned")
    assert ladder.main == "pins", "bounds alone know it too"


def test_nothing_is_said_of_what_a_pinned_uav_may_not_do(held: Plan) -> None:
    explanation = explain(held, budget=FEW)
    assert {row.uav_id for row in explanation.worth if row.what == "moved_start"} <= {"near"}
    assert "far" not in {uav for row in explanation.constraints if row.constraint == "speed" for uav in row.uav_ids}
    assert {row.uav_id for row in explanation.worth if row.what == "more_band" and row.method == "derivative"} == {
        "far",
        "near",
    }


def test_a_replan_that_was_to_change_little_says_that_resolves_were_not(letters_plan: Plan) -> None:
    again = replan(letters_plan, failed=["uav-3"], at_slot=10, disruption_weight=5.0, n_starts=2)
    assert "disruption_weight 5" in explain(again, budget=BOUNDS_ONLY).notes[-1]


def test_a_plan_that_is_too_large_is_refused_with_the_limit(
    letters_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(explain.__globals__, "MOST_CELLS", 100)
    with pytest.raises(ValueError, match=r"slots: .* UAVs x users x slots are too many to be explained; at most 100"):
        explain(letters_plan)
