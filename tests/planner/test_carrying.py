"""Pins that a replan keeps by itself: what still applies holds, and what no longer does is told with its reason."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skyfolio.planner import (
    EXAMPLES,
    Changes,
    DroppedPin,
    PinError,
    Pins,
    Plan,
    Uav,
    User,
    Utility,
    plan,
    preview,
    replan,
    violations,
)

KEPT: dict[str, Any] = {"keep_pins": True, "n_starts": 2}


@pytest.fixture(scope="module")
def held() -> Plan:
    """The letter's scenario with two pinned UAVs, and users pinned in all slots, and in some."""
    scenario = EXAMPLES["paper"]()
    row = [None if n % 2 else "uav-3" for n in range(scenario.slots)]
    pins = Pins(uavs=("uav-1", "uav-3"), associations={"user-1": "uav-2", "user-2": "uav-3", "user-3": tuple(row)})
    return plan(scenario, pins=pins, n_starts=2)


def test_pins_of_survivors_hold_on_and_those_of_a_lost_uav_are_dropped_with_the_reason(held: Plan) -> None:
    again = replan(held, failed=["uav-3"], at_slot=5, **KEPT)
    assert again.trajectories_m["uav-1"] == held.trajectories_m["uav-1"][5:]
    assert again.pins.pinned_uavs == ("uav-1",)
    assert again.pins.associations == {"user-1": "uav-2"}
    assert set(again.association["user-1"]) == {"uav-2"}
    assert again.dropped_pins == (
        DroppedPin(kind="path", id="uav-3", slots=15, reason="'uav-3' is lost"),
        DroppedPin(kind="association", id="user-2", slots=15, reason="'uav-3' is lost"),
        DroppedPin(kind="association", id="user-3", slots=7, reason="'uav-3' is lost"),
    )
    assert violations(again) == []


def test_nothing_is_carried_unless_asked_and_a_plan_without_pins_is_planned_as_before(held: Plan) -> None:
    assert not replan(held, failed=["uav-3"], at_slot=5, n_starts=1).pins
    free = plan(held.scenario, n_starts=1)
    asked: dict[str, Any] = {"failed": ["uav-3"], "at_slot": 5, "n_starts": 1}
    assert replan(free, **asked, keep_pins=True) == replan(free, **asked)


def test_pins_are_carried_from_replan_to_replan_by_the_slots_of_each(held: Plan) -> None:
    first = replan(held, failed=["uav-2"], at_slot=4, **KEPT)
    assert [pin.id for pin in first.dropped_pins] == ["user-1"]
    second = replan(first, at_slot=9, **KEPT)
    assert second.dropped_pins == ()
    assert second.trajectories_m["uav-3"] == held.trajectories_m["uav-3"][9:]
    wanted = held.pins.associations["user-3"][9:]
    assert second.pins.associations["user-3"] == wanted
    assert all(uav == "uav-3" for uav, pin in zip(second.association["user-3"], wanted, strict=True) if pin)
    assert violations(second) == []


def test_a_pinned_uav_off_its_path_catches_up_with_it(held: Plan) -> None:
    east, north = held.trajectories_m["uav-1"][5]
    again = replan(held, failed=["uav-3"], at_slot=5, positions_m={"uav-1": (east + 40.0, north)}, **KEPT)
    assert again.dropped_pins[0].id == "uav-3"
    path, old = np.array(again.trajectories_m["uav-1"]), np.array(held.trajectories_m["uav-1"][5:])
    away = np.linalg.norm(path - old, axis=1)
    assert away[0] == pytest.approx(40.0)
    assert away[-1] == 0.0


def test_users_that_leave_take_their_pins_along_and_a_uav_that_returns_starts_anew(held: Plan) -> None:
    back = Uav(id="uav-3", start_m=(300.0, 200.0))
    changes = Changes(failed=("uav-3",), returned=(back,), users_left=("user-1",))
    again = replan(held, at_slot=6, changes=changes, **KEPT)
    said = {pin.id: pin.reason for pin in again.dropped_pins}
    assert said == {
        "uav-3": "'uav-3' has returned, and starts from where it is",
        "user-1": "'user-1' is no longer a user",
    }
    assert again.pins.associations["user-2"] == "uav-3"
    assert violations(again) == []


def test_pins_of_the_request_come_first(held: Plan) -> None:
    hover = {"uav-1": tuple([held.trajectories_m["uav-1"][5]] * 15)}
    asked = Pins(paths_m=hover, associations={"user-1": "uav-1"})
    again = replan(held, failed=["uav-3"], at_slot=5, pins=asked, **KEPT)
    assert set(again.association["user-1"]) == {"uav-1"}
    assert set(again.trajectories_m["uav-1"]) == {held.trajectories_m["uav-1"][5]}
    with pytest.raises(PinError, match="'uav-3' is not a UAV of the plan"):
        replan(held, failed=["uav-3"], at_slot=5, pins=Pins(uavs=("uav-3",)), **KEPT)


def crossing() -> Plan:
    """A hovers 30 m off the way on which B flies past, both pinned, and a third UAV is free."""
    scenario = EXAMPLES["minimal"]().with_changes(
        area_m=((0.0, 0.0), (200.0, 100.0)),
        slots=10,
        slot_duration_s=5.0,
        min_separation_m=10.0,
        uavs=(
            Uav(id="a", start_m=(100.0, 80.0), max_speed_mps=4.0),
            Uav(id="b", start_m=(0.0, 50.0), max_speed_mps=4.0),
            Uav(id="c", start_m=(20.0, 10.0), max_speed_mps=4.0),
        ),
        users=tuple(User(id=f"user-{k}", position_m=(20.0 + 50.0 * k, 20.0 + 15.0 * k)) for k in range(4)),
        utility=Utility(kind="per_user", mu_per_kbps=-0.05),
    )
    past = tuple((20.0 * n, 50.0) for n in range(10))
    return plan(scenario, pins=Pins(paths_m={"b": past}, uavs=("a",)), n_starts=2)


def test_a_path_that_can_no_longer_be_caught_up_with_is_given_up_and_the_other_one_kept() -> None:
    """Blown onto B's way, A would fly back across it at the same time: the pin of B, named first, holds."""
    old = crossing()
    again = replan(old, at_slot=4, positions_m={"a": (100.0, 40.0)}, **KEPT)
    assert again.pins.pinned_uavs == ("b",)
    (dropped,) = again.dropped_pins
    assert (dropped.kind, dropped.id, dropped.slots) == ("path", "a", 6)
    assert "closer than min_separation_m" in dropped.reason
    assert violations(again) == []


def test_paths_that_leave_the_others_none_are_given_up_rather_than_the_plan() -> None:
    """C hardly moves and was blown onto B's way: no pin is worth having no plan."""
    old = crossing()
    still = old.scenario.uav("c").model_copy(update={"max_speed_mps": 0.1})
    uavs = (*old.scenario.uavs[:2], still)
    old = old.model_copy(update={"scenario": old.scenario.with_changes(uavs=uavs)})
    blown = {"c": (120.0, 50.0)}
    with pytest.raises(PinError, match="no paths were found"):
        replan(old, at_slot=4, positions_m=blown, pins=Pins(uavs=("a", "b")), n_starts=1)
    again = replan(old, at_slot=4, positions_m=blown, **KEPT)
    assert again.pins.pinned_uavs == ()
    assert {pin.id for pin in again.dropped_pins} == {"a", "b"}
    assert "no paths were found" in again.dropped_pins[0].reason
    assert violations(again) == []


def test_a_preview_of_a_changed_scenario_keeps_the_pins_and_tells_which_it_could_not(held: Plan) -> None:
    wider = tuple(uav.model_copy(update={"bandwidth_hz": 1.1 * uav.bandwidth_hz}) for uav in held.scenario.uavs)
    seen = preview(held, scenario=held.scenario.with_changes(uavs=wider), n_starts=2)
    moves = {move.uav_id: move.greatest_m for move in seen.uavs}
    assert moves["uav-1"] == moves["uav-3"] == 0.0
    assert seen.dropped_pins == ()
    fewer = preview(held, scenario=held.scenario.with_changes(uavs=held.scenario.uavs[:2]), n_starts=2)
    assert {pin.id: pin.reason for pin in fewer.dropped_pins} == {
        "uav-3": "'uav-3' no longer flies",
        "user-2": "'uav-3' no longer flies",
        "user-3": "'uav-3' no longer flies",
    }
