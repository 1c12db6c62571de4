"""Replans with another number of slots: what goes on beyond the old plan, who leaves when, and what still counts."""

from typing import Any

import numpy as np
import pytest

from skyfolio.planner import (
    EXAMPLES,
    Cause,
    Changes,
    Pins,
    Plan,
    ReplanError,
    Scenario,
    Uav,
    User,
    Utility,
    cause_of,
    plan,
    remaining,
    replan,
    rest_of_paths_m,
    violations,
)
from skyfolio.planner.disruption import former_of
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import Battery


def small(**changes: Any) -> Scenario:
    fields: dict[str, Any] = {
        "area_m": ((0.0, 0.0), (200.0, 100.0)),
        "slots": 6,
        "slot_duration_s": 5.0,
        "min_separation_m": 8.0,
        "uavs": (
            Uav(id="a", start_m=(20.0, 50.0), max_speed_mps=4.0),
            Uav(id="b", start_m=(150.0, 50.0), max_speed_mps=4.0),
        ),
        "users": tuple(User(id=f"user-{k}", position_m=(50.0 * k, 20.0 + 15.0 * k)) for k in range(4)),
        **changes,
    }
    return EXAMPLES["minimal"]().with_changes(**fields)


def test_a_plan_is_extended_from_any_of_its_slots_and_what_was_flown_stays(flown: Plan) -> None:
    again = replan(flown, at_slot=7, changes=Changes(slots=20), n_starts=2)
    assert (again.first_slot, again.scenario.slots, again.revision) == (7, 20, 2)
    assert {uav: path[0] for uav, path in again.trajectories_m.items()} == {
        uav: path[7] for uav, path in flown.trajectories_m.items()
    }
    assert again.cause.kind == "extended"
    assert violations(again) == []


def test_a_plan_is_cut_to_fewer_slots(flown: Plan) -> None:
    again = replan(flown, at_slot=7, changes=Changes(slots=3), disruption_weight=1.0, n_starts=1)
    assert {len(path) for path in again.trajectories_m.values()} == {3}
    assert violations(again) == []


def test_the_rest_of_a_path_hovers_on_at_its_last_place_beyond_the_old_plan(flown: Plan) -> None:
    rest = rest_of_paths_m(flown, 15, Changes(slots=8))
    for uav, path in flown.trajectories_m.items():
        assert rest[uav] == [*path[15:], *[path[-1]] * 3]
        assert rest_of_paths_m(flown, 15, Changes(slots=2))[uav] == path[15:17]


def test_pinned_uavs_and_users_stay_pinned_in_the_slots_that_are_new(flown: Plan) -> None:
    held = replan(flown, at_slot=2, pins=Pins(associations={"user-1": "uav-2"}), n_starts=1)
    pins = Pins(uavs=("uav-1",))
    again = replan(held, at_slot=10, changes=Changes(slots=20), pins=pins, keep_pins=True, n_starts=1)
    path = held.trajectories_m["uav-1"][8:]
    assert again.trajectories_m["uav-1"] == [*path, *[path[-1]] * 10]
    assert again.association["user-1"] == ["uav-2"] * 20
    assert again.dropped_pins == ()
    assert violations(again) == []


def test_users_move_on_and_those_on_a_track_stay_at_its_end() -> None:
    track = tuple((100.0 + 5.0 * n, 60.0) for n in range(6))
    users = (
        User(id="walker", position_m=(10.0, 10.0), velocity_mps=(1.0, 0.0)),
        User(id="tracked", positions_m=track, position_m=track[0]),
        User(id="late", position_m=(60.0, 60.0), arrives_at_slot=8, leaves_at_slot=11),
    )
    made = plan(small(users=users), n_starts=1)
    again = replan(made, at_slot=4, changes=Changes(slots=9), n_starts=1)
    walker, tracked, late = again.scenario.users
    assert walker.position_m == (30.0, 10.0)
    assert tracked.positions_m == (track[4], *[track[5]] * 8)
    assert (late.arrives_at_slot, late.leaves_at_slot) == (4, 7)
    served = [rate > 0.0 for rate in again.user_rates_bps["late"]]
    assert not any(served[:4] + served[7:])
    cut, _ = remaining(made, [], 2, changes=Changes(slots=2))
    assert cut.users[1].positions_m == track[2:4]
    assert violations(again) == []


def test_only_the_last_horizon_counts_of_what_was_achieved(flown: Plan) -> None:
    first = replan(flown, at_slot=10, changes=Changes(slots=12), n_starts=1)
    assert {len(row) for row in first.achieved_rates_bps.values()} == {10}
    second = replan(first, at_slot=20, changes=Changes(slots=12), n_starts=1)
    assert {len(row) for row in second.achieved_rates_bps.values()} == {12}
    user = flown.scenario.user_ids[0]
    promised = [*flown.user_rates_bps[user][:10], *first.user_rates_bps[user][:10]]
    assert second.achieved_rates_bps[user] == promised[-12:]
    lost = replan(second, at_slot=24, failed=["uav-1"], n_starts=1)
    assert {len(row) for row in lost.achieved_rates_bps.values()} == {16}


def test_rates_may_be_reported_for_the_whole_operation_when_only_the_last_count(flown: Plan) -> None:
    first = replan(flown, at_slot=10, changes=Changes(slots=6), n_starts=1)
    since_begin = {user: [1e3 * n for n in range(12)] for user in flown.scenario.user_ids}
    _, past = remaining(first, [], 12, achieved_rates_bps=since_begin, changes=Changes(slots=6))
    assert past.rates_bps.tolist() == [[1e3 * n for n in range(6, 12)]] * 9
    wrong = {user: [0.0] * 11 for user in flown.scenario.user_ids}
    with pytest.raises(ReplanError, match=r"achieved_rates_bps.user-1: has 11 slots, but 8 have passed"):
        remaining(first, [], 12, achieved_rates_bps=wrong, changes=Changes(slots=6))


def test_the_slot_that_is_excluded_is_the_operations_first_and_no_later_one(flown: Plan) -> None:
    utility = Utility(kind="per_user", mu_per_kbps=-0.1, exclude_fixed_slots=True)
    made = flown.model_copy(update={"scenario": flown.scenario.with_changes(utility=utility)})
    scenario, past = remaining(made, [], 8, changes=Changes(slots=5))
    assert past.rates_bps.shape == (9, 5)
    assert problem_of(scenario, past).past_kbps.shape == (9, 5)
    whole, since_begin = remaining(made, [], 8)
    assert problem_of(whole, since_begin).past_kbps.shape == (9, 7)


def test_a_uav_leaves_earlier_later_or_not_at_all_as_told(flown: Plan) -> None:
    early = replan(flown, at_slot=5, changes=Changes(leaves_at={"uav-1": 12}), n_starts=1)
    assert early.scenario.uav("uav-1").leaves_at_slot == 7
    assert "uav-1" not in {uav for row in early.association.values() for uav in row[7:]}
    assert early.cause == Cause(kind="ordered", uav_ids=("uav-1",))
    later, _ = remaining(early, [], 8, changes=Changes(slots=20, leaves_at={"uav-1": 26}))
    assert later.uav("uav-1").leaves_at_slot == 18
    stays, _ = remaining(early, [], 8, changes=Changes(slots=20, leaves_at={"uav-1": None}))
    assert stays.uav("uav-1").leaves_at_slot is None
    assert violations(early) == []


def test_a_uav_ends_where_it_is_told_to(flown: Plan) -> None:
    pad = flown.scenario.uav("uav-1").start_m
    changes = Changes(leaves_at={"uav-1": 14}, ends_m={"uav-1": pad})
    again = replan(flown, at_slot=5, changes=changes, n_starts=1)
    assert again.trajectories_m["uav-1"][8] == pytest.approx(pad)
    free, _ = remaining(again, [], 7, changes=Changes(leaves_at={"uav-1": None}, ends_m={"uav-1": None}))
    assert free.uav("uav-1").end_m is None
    assert violations(again) == []


def test_a_uav_with_a_battery_leaves_an_extended_plan_when_its_energy_ends() -> None:
    weak = Uav(id="a", start_m=(20.0, 50.0), max_speed_mps=4.0, battery=Battery(usable_wh=10.0))
    made = plan(small(uavs=(weak, small().uavs[1])), n_starts=1)
    again = replan(made, at_slot=3, changes=Changes(slots=60), n_starts=1)
    leaves = again.scenario.uav("a").leaves_at_slot
    assert leaves is not None
    assert 3 < leaves < 60
    assert min(again.energy_margin_wh["a"]) >= 0.0
    assert violations(again) == []


def test_more_slots_than_any_uav_can_stay_are_refused_with_how_many_there_can_be() -> None:
    uavs = tuple(uav.model_copy(update={"battery": Battery(usable_wh=10.0)}) for uav in small().uavs)
    made = plan(small(uavs=uavs), n_starts=1)
    with pytest.raises(ReplanError, match=r"slots: 60 are too many, every UAV has left after \d+ slots") as refused:
        remaining(made, [], 3, changes=Changes(slots=60))
    most = int(str(refused.value).split()[-2])
    assert remaining(made, [], 3, changes=Changes(slots=most))[0].slots == most
    with pytest.raises(ReplanError, match="slots"):
        remaining(made, [], 3, changes=Changes(slots=most + 1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (Changes(leaves_at={"uav-9": 12}), "leaves_at: 'uav-9' is not a UAV of the new plan"),
        (Changes(ends_m={"uav-9": (0.0, 0.0)}), "ends_m: 'uav-9' is not a UAV of the new plan"),
        (Changes(leaves_at={"uav-1": 5}), "leaves_at.uav-1: 5 must be greater than at_slot, 5"),
        (Changes(ends_m={"uav-1": (900.0, 0.0)}), r"ends_m: uavs.0.end_m: \(900.0, 0.0\) of 'uav-1' lies outside"),
        (Changes(leaves_at={f"uav-{u}": 9 for u in (1, 2, 3)}), "leaves_at: every UAV would have left after 4 of 15"),
        (Changes(slots=9, leaves_at={f"uav-{u}": 9 for u in (1, 2, 3)}), "slots: 9 are too many"),
        (Changes(leaves_at={"uav-1": 6}, ends_m={"uav-1": (500.0, 0.0)}), "ends_m: uavs.0.end_m: .* it can fly only"),
    ],
)
def test_leaves_and_ends_that_cannot_be_are_refused_by_field_and_rule(
    flown: Plan, changes: Changes, message: str
) -> None:
    with pytest.raises(ReplanError, match=message):
        remaining(flown, [], 5, changes=changes)


@pytest.mark.parametrize("field", [{"slots": 0}, {"slots": 2.0}, {"leaves_at": {"uav-1": 0}}, {"ends_m": {"u": [0.0]}}])
def test_malformed_extensions_are_refused(field: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(field))):
        Changes.model_validate(field)


def test_a_user_that_would_walk_out_of_the_frame_limits_the_slots(flown: Plan) -> None:
    walker = User(id="runner", position_m=(0.0, 0.0), velocity_mps=(900.0, 0.0))
    made = flown.model_copy(update={"scenario": flown.scenario.with_changes(users=(walker, *flown.scenario.users[1:]))})
    rates = {"runner": flown.user_rates_bps["user-1"], **flown.user_rates_bps}
    made = made.model_copy(update={"user_rates_bps": rates})
    with pytest.raises(ReplanError, match=r"slots: .*velocity_mps: 'runner' would be"):
        remaining(made, [], 5, changes=Changes(slots=30))


def test_there_is_no_price_on_what_the_old_plan_had_no_slots_for(flown: Plan) -> None:
    scenario, _ = remaining(flown, [], 15, changes=Changes(slots=12))
    former = former_of(flown, scenario, 15, set(flown.scenario.uav_ids), 1.0)
    assert np.isfinite(former.paths_m[:, :5]).all()
    assert np.isnan(former.paths_m[:, 5:]).all()
    assert (former.serving[:, :5] >= 0).all()
    assert (former.serving[:, 5:] == -1).all()
    assert not former.served[:, 5:].any()
    again = replan(flown, at_slot=15, changes=Changes(slots=12), disruption_weight=50.0, n_starts=1)
    assert violations(again) == []
    assert again.disruption is not None
    assert again.disruption.users_changed == 0


def test_the_cause_of_a_relief_names_both(flown: Plan) -> None:
    back = Uav(id="uav-4", start_m=(10.0, 10.0))
    changes = Changes(returned=(back,), leaves_at={"uav-1": 12})
    assert cause_of(changes) == Cause(kind="relief", uav_ids=("uav-4", "uav-1"))
    assert replan(flown, at_slot=5, changes=changes, n_starts=1).cause.kind == "relief"


def test_changes_without_extension_are_written_as_before() -> None:
    assert {"slots", "leaves_at", "ends_m"}.isdisjoint(Changes().model_dump())
    given = Changes(slots=20, leaves_at={"uav-1": 30}, ends_m={"uav-1": (1.0, 2.0)})
    assert Changes.model_validate_json(given.model_dump_json()) == given
