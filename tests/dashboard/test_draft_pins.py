"""Pins of a draft: added, replaced, released, and dropped with what they name."""

import json

import pytest

from skyfolio.api.dashboard.draft import Draft, DraftError
from skyfolio.api.dashboard.draft_pins import DraftPins, rows
from skyfolio.api.dashboard.map_scene import scene, sketch
from skyfolio.planner import Pins, Plan, Scenario, plan


def test_a_uav_has_one_pin_and_a_user_one_server(small_plan: Plan) -> None:
    pins = DraftPins()
    pins.hover("uav-1")
    pins.keep_path("uav-1", small_plan.trajectories_m["uav-1"])
    pins.keep_path("uav-2", small_plan.trajectories_m["uav-2"])
    pins.hover("uav-2")
    pins.serve("user-1", "uav-1")
    pins.serve("user-1", "uav-2")
    assert list(pins.pins.paths_m) == ["uav-1"]
    assert pins.pins.uavs == ("uav-2",)
    assert rows(pins.pins) == [
        ("uav", "uav-1", "flies a given path"),
        ("uav", "uav-2", "hovers at its start"),
        ("user", "user-1", "is served by uav-2"),
    ]
    assert DraftPins.of_data(json.loads(json.dumps(pins.data()))).pins == pins.pins
    for kind, entry_id, _ in rows(pins.pins):
        pins.release(kind, entry_id)
    assert not pins.pins


def test_pins_by_slot_are_told_by_how_many() -> None:
    pins = Pins(associations={"user-1": ("uav-1", None, "uav-2", "uav-1")})
    assert rows(pins)[0][2] == "is served by uav-1, uav-2 in 3 of 4 slots"


def test_a_moved_uav_loses_its_path_and_one_that_hovers_does_not(minimal: Scenario, small_plan: Plan) -> None:
    draft = Draft(minimal)
    draft.pins.keep_path("uav-1", small_plan.trajectories_m["uav-1"])
    draft.pins.hover("uav-2")
    draft.move("uav", "uav-1", 60.0, 60.0)
    draft.move("uav", "uav-2", 120.0, 60.0)
    assert draft.pinned() == Pins(uavs=("uav-2",))


def test_what_is_removed_takes_its_pins_along(minimal: Scenario) -> None:
    draft = Draft(minimal)
    draft.pins.hover("uav-2")
    draft.pins.serve("user-1", "uav-1")
    draft.pins.serve("user-2", "uav-2")
    draft.remove("user", "user-1")
    draft.remove("uav", "uav-2")
    assert not draft.pinned()


def test_pins_that_cannot_be_kept_are_told_by_field(minimal: Scenario, small_plan: Plan) -> None:
    draft = Draft(minimal)
    draft.pins.keep_path("uav-1", small_plan.trajectories_m["uav-1"][:-1])
    with pytest.raises(DraftError, match=r"pins\.paths_m\.uav-1: has 3 points"):
        draft.pinned()


def test_the_file_of_a_pinned_plan_brings_its_pins_and_the_map_marks_them(minimal: Scenario) -> None:
    made = plan(minimal, pins=Pins(uavs=("uav-1",), associations={"user-4": "uav-2"}))
    draft = Draft.from_file(made.model_dump_json().encode())
    assert draft.pinned() == made.pins
    drawn, _ = sketch(draft.data, draft.pins.pins)
    assert drawn["pinned"] == scene(minimal, [("current", made)])["pinned"] == ["uav-1", "user-4"]
    assert list(drawn["plans"][0]["paths"]) == ["uav-1"]
    with pytest.raises(DraftError, match="uavs"):
        Draft.from_file(json.dumps({**json.loads(minimal.model_dump_json()), "pins": {"uavs": 3}}).encode())
