"""Editing a scenario."""

import json

import pytest

from skyfolio.api.dashboard.draft import Draft, DraftError
from skyfolio.planner import Plan, Scenario, User


def test_an_unchanged_draft_is_the_scenario_it_came_from(minimal: Scenario) -> None:
    assert Draft(minimal).scenario() == minimal


def test_what_is_placed_moved_and_removed_is_in_the_scenario(minimal: Scenario) -> None:
    draft = Draft(minimal)
    assert draft.place("user", 10.0, 20.0) == "user-5"
    assert draft.place("uav", 100.0, 90.0) == "uav-3"
    draft.move("user", "user-1", 33.0, 44.0)
    draft.remove("user", "user-2")
    draft.set_mu(-0.5)
    made = draft.scenario()
    assert made.user_ids == ("user-1", "user-3", "user-4", "user-5")
    assert made.users[0].position_m == (33.0, 44.0)
    assert made.uav("uav-3").start_m == (100.0, 90.0)
    assert made.utility.mu_per_kbps == draft.mu_per_kbps == -0.5
    assert draft.position("uav", "uav-3") == (100.0, 90.0)


def test_the_last_uav_cannot_be_removed(minimal: Scenario) -> None:
    draft = Draft(minimal)
    draft.remove("uav", "uav-1")
    with pytest.raises(DraftError, match="at least one must remain"):
        draft.remove("uav", "uav-2")


def test_broken_rules_are_told_by_field(minimal: Scenario) -> None:
    draft = Draft(minimal)
    draft.place("uav", 900.0, 20.0)
    with pytest.raises(DraftError, match=r"uavs\.2\.start_m: .* lies outside area_m"):
        draft.scenario()
    draft = Draft(minimal)
    draft.data["slots"] = None
    with pytest.raises(DraftError, match="slots: "):
        draft.scenario()


def test_files_may_hold_a_scenario_or_a_plan(minimal: Scenario, small_plan: Plan) -> None:
    assert Draft.from_file(minimal.model_dump_json().encode()).scenario() == minimal
    assert Draft.from_file(small_plan.model_dump_json().encode()).scenario() == minimal


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"\xff\xfe", "not JSON"),
        (b"[1, 2]", "one JSON object"),
        (b"{}", "origin: Field required"),
        (b'{"slots": NaN}', "."),
        (json.dumps({"scenario": {"slots": 1}}).encode(), "origin: Field required"),
    ],
)
def test_files_that_hold_neither_are_refused(content: bytes, complaint: str) -> None:
    with pytest.raises(DraftError, match=complaint):
        Draft.from_file(content)


def test_what_is_moved_is_no_longer_where_its_degrees_say(minimal: Scenario) -> None:
    raw = minimal.model_dump(mode="json")
    raw["users"] = [{"id": "user-1", "position_deg": {"lat": 47.398, "lon": 8.546}}]
    raw["uavs"] = [
        {"id": "uav-1", "start_deg": {"lat": 47.398, "lon": 8.546}, "end_deg": {"lat": 47.398, "lon": 8.546}}
    ]
    draft = Draft(Scenario.model_validate(raw))
    draft.move("user", "user-1", 33.0, 44.0)
    draft.place("user", 10.0, 20.0)
    draft.place("uav", 100.0, 90.0)
    made = draft.scenario()
    assert [user.position_m for user in made.users] == [(33.0, 44.0), (10.0, 20.0)]
    assert [uav.end_m is None for uav in made.uavs] == [False, True]
    assert made.users[0].position_deg is None
    assert made.uavs[0].start_deg is not None


def test_a_user_that_is_moved_takes_its_track_along(minimal: Scenario) -> None:
    track = ((20.0, 50.0), (25.0, 50.0), (30.0, 55.0), (30.0, 60.0))
    walks = User(id="walks", position_m=track[0], positions_m=track)
    draft = Draft(minimal.with_changes(users=(walks, *minimal.users[1:])))
    draft.move("user", "walks", 30.0, 40.0)
    assert draft.scenario().users[0].positions_m == ((30.0, 40.0), (35.0, 40.0), (40.0, 45.0), (40.0, 50.0))
