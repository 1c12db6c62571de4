"""Uploads over a wire that fails in every way, in virtual time: whole old mission or whole new one, never between."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyfolio.api.lab.virtual_wire import Wire, autopilot_on, lossy
from skyfolio.mavlink_bridge import Autopilot, Mission, compile_mission, mission_differences
from skyfolio.mavlink_bridge.answers import Ack
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.verified import OnBoard, VerifiedUpload
from skyfolio.planner.plans import Plan

PlanOf = Callable[..., Plan]
FLAVOURS = list(Autopilot)
Fields = dict[str, Any]


def zigzag(plan_of: PlanOf, flavour: Autopilot, slots: int, side_m: float) -> Mission:
    path = [(11.0 * slot + slot % 2, side_m * (slot % 3)) for slot in range(slots)]
    return compile_mission(plan_of({"uav-1": path}), "uav-1", autopilot=flavour)


class Faults:
    """Loses or doubles the nth message of a kind, or whatever falls into a time span."""

    def __init__(self) -> None:
        self.copies: dict[tuple[str, int], int] = {}
        self.cut: Callable[[], bool] = lambda: False
        self.seen: dict[str, int] = {}

    def __call__(self, name: str, _fields: Fields) -> int:
        number = self.seen[name] = self.seen.get(name, 0) + 1
        return 0 if self.cut() else self.copies.get((name, number), 1)


class Case:
    """One vehicle with the old mission on board, and a new one to be uploaded over a wire with faults."""

    def __init__(self, plan_of: PlanOf, flavour: Autopilot) -> None:
        self.old, self.new = zigzag(plan_of, flavour, 6, 0.0), zigzag(plan_of, flavour, 10, 7.0)
        self.flavour = flavour
        self.wire = Wire()
        self.vehicle = autopilot_on(self.wire, flavour)
        assert self.upload(self.old).on_board is OnBoard.NEW
        self.up, self.down = Faults(), Faults()
        self.wire.up, self.wire.down = self.up, self.down

    def upload(self, mission: Mission, **how: Any) -> VerifiedUpload:
        return self.wire.run(VerifiedUpload(mission.items, 1, autopilot=self.flavour, **how))

    def has(self, mission: Mission) -> bool:
        on_board = self.vehicle.missions.plan(0).items
        return not mission_differences(mission.items, on_board, autopilot=self.flavour)

    def ends_whole(self) -> VerifiedUpload:
        """Upload the new mission; what the upload says is on board is on board, whole."""
        ended = self.upload(self.new, old=self.old.items)
        assert ended.on_board is not OnBoard.UNKNOWN, ended.error
        assert self.has(self.new if ended.on_board is OnBoard.NEW else self.old)
        assert (ended.error is None) == (ended.on_board is OnBoard.NEW)
        return ended


@pytest.fixture(params=FLAVOURS)
def case(request: pytest.FixtureRequest, plan_of: PlanOf) -> Case:
    return Case(plan_of, request.param)


def test_a_clean_link_takes_one_attempt(case: Case) -> None:
    ended = case.ends_whole()
    assert (ended.on_board, ended.attempts) == (OnBoard.NEW, 1)


@pytest.mark.parametrize(
    ("direction", "name", "number"),
    [
        ("up", "MISSION_COUNT", 1),
        ("up", "MISSION_ITEM_INT", 1),
        ("up", "MISSION_ITEM_INT", 7),
        ("up", "MISSION_ITEM_INT", 21),
        ("down", "MISSION_REQUEST_INT", 1),
        ("down", "MISSION_REQUEST_INT", 9),
        ("down", "MISSION_ACK", 1),
        ("up", "MISSION_REQUEST_LIST", 1),
        ("down", "MISSION_COUNT", 1),
        ("up", "MISSION_REQUEST_INT", 5),
        ("down", "MISSION_ITEM_INT", 5),
        ("up", "MISSION_ACK", 1),
    ],
)
@pytest.mark.parametrize("copies", [0, 2], ids=["lost", "doubled"])
def test_one_message_lost_or_doubled_still_ends_with_the_new_mission(
    case: Case, direction: str, name: str, number: int, copies: int
) -> None:
    faults = case.up if direction == "up" else case.down
    faults.copies[name, number] = copies
    ended = case.ends_whole()
    assert ended.on_board is OnBoard.NEW


def test_a_vehicle_that_never_asks_leaves_the_old_mission(case: Case) -> None:
    case.down.cut = lambda: True
    ended = case.upload(case.new, old=case.old.items, attempts=1)
    assert ended.on_board is OnBoard.UNKNOWN  # nothing is heard, so nothing is claimed
    assert ended.error == "MISSION_COUNT: no answer for 3 s" or "MISSION_ITEM_INT" in str(ended.error)


@pytest.mark.parametrize("begins_s", [0.03, 0.1, 0.2])
@pytest.mark.parametrize("lasts_s", [1.0, 4.0, 12.0])
def test_a_link_cut_in_the_middle_ends_whole_once_it_is_back(case: Case, begins_s: float, lasts_s: float) -> None:
    began_s = case.wire.now_s
    case.up.cut = case.down.cut = lambda: begins_s <= case.wire.now_s - began_s < begins_s + lasts_s
    case.ends_whole()


@pytest.mark.parametrize("result", [Ack.ERROR, Ack.DENIED, Ack.INVALID_SEQUENCE, Ack.OPERATION_CANCELLED])
def test_a_passing_refusal_in_the_middle_is_overcome(case: Case, result: Ack) -> None:
    forge_answer(case, "MISSION_REQUEST_INT", 6, {"type": int(result)})
    assert case.ends_whole().on_board is OnBoard.NEW


@pytest.mark.parametrize("result", [Ack.NO_SPACE, Ack.INVALID_PARAM1, Ack.UNSUPPORTED, Ack(77)])
def test_a_refused_mission_leaves_the_whole_old_one(case: Case, result: Ack) -> None:
    forge_answer(case, "MISSION_REQUEST_INT", 6, {"type": int(result)})
    ended = case.ends_whole()
    assert ended.on_board is OnBoard.OLD
    assert ended.error == f"refused with {result.name} at item 4"


def test_a_vehicle_without_space_says_so_and_keeps_the_old_mission(case: Case, plan_of: PlanOf) -> None:
    flavour = case.new.autopilot
    path = [(11.0 * slot + slot % 2, 0.0) for slot in range(2500)]
    case.new = compile_mission(plan_of({"uav-1": path}), "uav-1", autopilot=flavour, max_items=10_000)
    ended = case.ends_whole()
    assert ended.on_board is OnBoard.OLD
    assert ended.error == "refused with NO_SPACE"


def test_an_early_acknowledgement_is_not_believed(case: Case) -> None:
    forge_answer(case, "MISSION_REQUEST_INT", 3, {"type": int(Ack.ACCEPTED)}, keep=True)
    assert case.ends_whole().on_board is OnBoard.NEW


def test_answers_to_another_station_are_not_ours(case: Case) -> None:
    forge_answer(case, "MISSION_REQUEST_INT", 3, {"type": int(Ack.NO_SPACE), "target_system": 255}, keep=True)
    assert case.ends_whole().on_board is OnBoard.NEW


def test_a_request_out_of_order_gets_the_item_it_asks_for(case: Case) -> None:
    original = case.down

    def ask_again(name: str, fields: Fields) -> int:
        if name == "MISSION_REQUEST_INT" and fields["seq"] == 6 and original.seen.get(name, 0) == 6:
            case.wire._heard(name, {**fields, "seq": 2})
            case.wire._heard(name, {**fields, "seq": 999})
        return original(name, fields)

    case.wire.down = ask_again
    assert case.ends_whole().on_board is OnBoard.NEW


def test_an_item_that_arrives_late_does_no_harm(case: Case) -> None:
    late: list[Message] = []

    def delay(name: str, fields: Fields) -> int:
        if name == "MISSION_ITEM_INT" and fields["seq"] == 4 and not late:
            late.append(Message(name, fields))
            return 0
        if name == "MISSION_REQUEST_LIST" and len(late) == 1:
            late.append(late[0])
            case.wire.send([late[0]])
        return 1

    case.wire.up = delay
    assert case.ends_whole().on_board is OnBoard.NEW


def test_a_foreign_station_that_uploads_meanwhile_does_not_mix_in(case: Case) -> None:
    foreign = Message("MISSION_COUNT", {"target_system": 1, "target_component": 1, "count": 3, "mission_type": 0})

    def intrude(name: str, fields: Fields) -> int:
        if name == "MISSION_ITEM_INT" and fields["seq"] in (2, 8):
            case.wire.up = case.up
            case.wire.send([foreign], sender=(255, 190))
        return case.up(name, fields)

    case.wire.up = intrude
    case.ends_whole()


def test_a_foreign_station_that_was_first_is_waited_for(case: Case) -> None:
    foreign = Message("MISSION_COUNT", {"target_system": 1, "target_component": 1, "count": 3, "mission_type": 0})
    case.wire.send([foreign], sender=(255, 190))
    ended = case.upload(case.new, old=case.old.items, attempts=6)
    assert ended.on_board is not OnBoard.UNKNOWN
    assert case.has(case.new if ended.on_board is OnBoard.NEW else case.old)


@pytest.mark.parametrize("flavour", FLAVOURS)
@given(seed=st.integers(0, 2**32), share=st.floats(0, 0.4))
@settings(max_examples=25, deadline=None)
def test_whatever_is_lost_the_result_is_what_is_on_board(
    plan_of: PlanOf, flavour: Autopilot, seed: int, share: float
) -> None:
    case = Case(plan_of, flavour)
    chance = random.Random(seed)
    case.wire.up, case.wire.down = lossy(chance, share), lossy(chance, share)
    ended = case.upload(case.new, old=case.old.items)
    if ended.on_board is OnBoard.NEW:
        assert case.has(case.new)
    elif ended.on_board is OnBoard.OLD:
        assert case.has(case.old)
    if share < 0.15:
        assert ended.on_board is OnBoard.NEW


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_hundred_items_are_verified_in_ten_seconds_at_ten_percent_loss(plan_of: PlanOf, flavour: Autopilot) -> None:
    times = []
    for seed in range(20):
        wire = Wire(latency_s=0.01)
        autopilot_on(wire, flavour)
        chance = random.Random(seed)
        wire.up, wire.down = lossy(chance, 0.1), lossy(chance, 0.1)
        mission = zigzag(plan_of, flavour, 50, 7.0)
        assert len(mission.items) >= 100
        began_s = wire.now_s
        ended = wire.run(VerifiedUpload(mission.items, 1, autopilot=flavour))
        assert ended.on_board is OnBoard.NEW, ended.error
        times.append(wire.now_s - began_s)
    assert sorted(times)[18] <= 10.0


def forge_answer(case: Case, name: str, number: int, fields: Fields, *, keep: bool = False) -> None:
    """Instead of (`keep`: before) the nth message of a kind, the ground hears a MISSION_ACK."""
    original = case.down
    done: list[bool] = []

    def down(heard: str, heard_fields: Fields) -> int:
        copies = original(heard, heard_fields)
        asked = original.seen.get(name, 0) + original.seen.get(name.removesuffix("_INT"), 0)
        if heard.removesuffix("_INT") == name.removesuffix("_INT") and asked == number and not done:
            done.append(True)
            ack = {"target_system": 245, "target_component": 190, "mission_type": 0, "opaque_id": 0, **fields}
            case.wire._heard("MISSION_ACK", ack)
            return copies if keep else 0
        return copies

    case.wire.down = down
