"""sim.mission_protocol: a ground station at one end, an autopilot on the bench at the other."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.mission_protocol import MissionProtocol
from sim.missions import Mission
from sim.wire import Decoder

if TYPE_CHECKING:
    from tests.sim.conftest import Bench, GroundStation, Items

ACCEPTED = dialect.MAV_MISSION_ACCEPTED


def test_an_uploaded_mission_reads_back_equal(bench: "Bench", items: "Items") -> None:
    sent = [items.speed(4.0, current=1.0), items.waypoint(10.0, 0.0, p1=3.0), items.waypoint(10.0, 20.0)]
    ack = bench.upload(*sent)
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", ACCEPTED)
    (count,) = bench.ask("mission_request_list", 1, 1, 0)
    assert count.count == 3
    for seq, item in enumerate(sent):
        (answer,) = bench.ask("mission_request_int", 1, 1, seq, 0)
        names = ("seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4")
        assert tuple(getattr(answer, name) for name in (*names, "x", "y", "z", "mission_type")) == item
    assert bench.ask("mission_ack", 1, 1, ACCEPTED, 0) == []
    assert not bench.autopilot.missions.busy


def test_the_acknowledgement_carries_the_id_that_mission_current_shows(bench: "Bench", items: "Items") -> None:
    ack = bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    assert ack.opaque_id == bench.autopilot.runner.mission.mission_id != 0
    current = bench.autopilot.telemetry.build(dialect.MAVLINK_MSG_ID_MISSION_CURRENT)
    assert current is not None
    assert current.mission_id == ack.opaque_id


def test_a_missing_item_is_asked_for_again_every_250_ms(bench: "Bench") -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    asked = []
    for _ in range(10):
        bench.wall_s += 0.1
        asked += bench.autopilot.missions.tick()
    assert [request.get_type() for request in asked] == ["MISSION_REQUEST_INT"] * 3
    assert {request.seq for request in asked} == {0}


def test_a_silent_upload_ends_after_five_seconds_and_leaves_the_old_mission(bench: "Bench", items: "Items") -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    old = bench.autopilot.missions.mission
    bench.ask("mission_count", 1, 1, 2, 0)
    bench.wall_s = 5.0
    (words,) = bench.autopilot.missions.tick()
    assert words.get_type() == "STATUSTEXT"
    assert not bench.autopilot.missions.busy
    assert bench.autopilot.missions.mission is old


def test_protocol_timers_ignore_how_fast_the_fleet_flies(bench: "Bench") -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    bench.fly(60.0)
    assert bench.autopilot.missions.busy


def test_an_item_out_of_order_is_ignored(bench: "Bench", items: "Items") -> None:
    first, second = items.waypoint(10.0, 0.0, current=1.0), items.waypoint(20.0, 0.0)
    bench.ask("mission_count", 1, 1, 2, 0)
    assert bench.ask("mission_item_int", 1, 1, *second) == []
    (request,) = bench.ask("mission_item_int", 1, 1, *first)
    assert request.seq == 1
    assert bench.ask("mission_item_int", 1, 1, *first) == []
    (ack,) = bench.ask("mission_item_int", 1, 1, *second)
    assert ack.type == ACCEPTED


def test_an_item_that_cannot_be_flown_ends_the_upload(bench: "Bench", items: "Items") -> None:
    bench.ask("mission_count", 1, 1, 1, 0)
    (ack,) = bench.ask("mission_item_int", 1, 1, *items.add(82))
    assert ack.type == dialect.MAV_MISSION_UNSUPPORTED
    assert not bench.autopilot.missions.busy
    assert bench.autopilot.missions.mission == Mission()


def test_a_late_copy_of_the_last_item_is_acknowledged_again_but_no_other(bench: "Bench", items: "Items") -> None:
    first, last = items.waypoint(10.0, 0.0, current=1.0), items.add(17, p2=float("nan"))
    bench.upload(first, last)
    (again,) = bench.ask("mission_item_int", 1, 1, *last)
    assert again.type == ACCEPTED
    (stray,) = bench.ask("mission_item_int", 1, 1, *first)
    assert stray.type == dialect.MAV_MISSION_ERROR


def test_a_second_ground_station_is_denied_during_a_transfer(
    bench: "Bench", new_station: "Callable[..., GroundStation]"
) -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    foreign = new_station(99, 190).message("mission_count", 1, 1, 5, 0)
    (answer,) = bench.autopilot.handle(foreign)
    assert (answer.type, answer.target_system) == (dialect.MAV_MISSION_DENIED, 99)
    (request,) = bench.ask("mission_count", 1, 1, 2, 0)
    assert request.seq == 0


def test_an_upload_can_be_cancelled(bench: "Bench") -> None:
    bench.ask("mission_count", 1, 1, 2, 0)
    assert bench.ask("mission_ack", 1, 1, dialect.MAV_MISSION_OPERATION_CANCELLED, 0) == []
    assert not bench.autopilot.missions.busy


def test_too_many_items_find_no_space(bench: "Bench") -> None:
    (ack,) = bench.ask("mission_count", 1, 1, 501, 0)
    assert ack.type == dialect.MAV_MISSION_NO_SPACE


@pytest.mark.parametrize("message", [("mission_clear_all", 1, 1, 0), ("mission_count", 1, 1, 0, 0)])
def test_a_mission_can_be_cleared(bench: "Bench", items: "Items", message: tuple[Any, ...]) -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    (ack,) = bench.ask(*message)
    assert ack.type == ACCEPTED
    assert bench.autopilot.missions.mission == Mission()


def test_a_fence_is_not_supported_and_reads_as_empty(bench: "Bench") -> None:
    (ack,) = bench.ask("mission_count", 1, 1, 3, 1)
    assert ack.type == dialect.MAV_MISSION_UNSUPPORTED
    (count,) = bench.ask("mission_request_list", 1, 1, 1)
    assert (count.count, count.mission_type) == (0, 1)


def test_a_request_past_the_end_of_a_download_is_an_invalid_sequence(bench: "Bench", items: "Items") -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0))
    bench.ask("mission_request_list", 1, 1, 0)
    (ack,) = bench.ask("mission_request_int", 1, 1, 1, 0)
    assert ack.type == dialect.MAV_MISSION_INVALID_SEQUENCE


def test_setting_the_current_item_is_confirmed_at_once_and_past_the_end_it_is_not(
    bench: "Bench", items: "Items"
) -> None:
    bench.upload(items.waypoint(10.0, 0.0, current=1.0), items.waypoint(20.0, 0.0))
    bench.autopilot.due()
    assert bench.ask("mission_set_current", 1, 1, 1) == []
    assert [message.seq for message in bench.autopilot.due() if message.get_type() == "MISSION_CURRENT"] == [1]
    (words,) = bench.ask("mission_set_current", 1, 1, 2)
    assert words.get_type() == "STATUSTEXT"
    assert bench.autopilot.runner.index == 1


stations = st.sampled_from([(245, 190), (99, 190), (245, 191)])


class AnyOrderOfMessages(RuleBasedStateMachine):
    """PX4's invariant: what lies on board is always a whole mission that somebody sent, item for item."""

    def __init__(self) -> None:
        super().__init__()
        self.wall_s = 0.0
        self.accepted: list[Mission] = []
        self.protocol = MissionProtocol(
            clock=lambda: self.wall_s,
            on_accept=self.accepted.append,
            on_jump=lambda _: None,
            current=lambda: 0,
        )
        self.promised: tuple[tuple[int, int], int] = ((0, 0), 0)
        self.sent_since: list[tuple[tuple[int, int], int, int]] = []

    def _send(self, who: tuple[int, int], name: str, *values: Any) -> list[Any]:
        mav = dialect.MAVLink(None, srcSystem=who[0], srcComponent=who[1])
        (message,) = Decoder().decode(bytes(getattr(dialect, f"MAVLink_{name}_message")(*values).pack(mav)))
        known = len(self.accepted)
        answers = self.protocol.handle(message)
        if len(self.accepted) > known:
            assert [a.type for a in answers if a.get_type() == "MISSION_ACK"] == [ACCEPTED]
            self._check_that_it_is_whole(who, self.accepted[-1])
        return answers

    def _check_that_it_is_whole(self, who: tuple[int, int], mission: Mission) -> None:
        if mission.items:
            assert self.promised == (who, len(mission))
            assert {(who, item.seq, item.x) for item in mission.items} <= set(self.sent_since)

    @rule(who=stations, count=st.integers(0, 4))
    def count(self, who: tuple[int, int], count: int) -> None:
        idle = not self.protocol.busy
        answers = self._send(who, "mission_count", 1, 1, count, 0)
        asked = [answer.get_type() for answer in answers] == ["MISSION_REQUEST_INT"]
        if asked:
            self.promised, self.sent_since = (who, count), []
        assert asked or count == 0 or not idle

    @rule(who=stations, seq=st.integers(0, 4), variant=st.integers(0, 3), command=st.sampled_from([16, 16, 16, 82]))
    def item(self, who: tuple[int, int], seq: int, variant: int, command: int) -> None:
        place = (470_000_000 + variant, 85_000_000 + seq)
        self.sent_since.append((who, seq, place[0]))
        self._send(who, "mission_item_int", 1, 1, seq, 6, command, 0, 1, 0.0, 0.0, 0.0, 0.0, *place, 20.0, 0)

    @rule(who=stations, variant=st.integers(0, 3))
    def next_item(self, who: tuple[int, int], variant: int) -> None:
        transfer = self.protocol._transfer
        self.item(who, len(getattr(transfer, "staged", [])), variant, 16)

    @rule(who=stations)
    def read_list(self, who: tuple[int, int]) -> None:
        self._send(who, "mission_request_list", 1, 1, 0)

    @rule(who=stations, seq=st.integers(0, 5))
    def read_item(self, who: tuple[int, int], seq: int) -> None:
        for answer in self._send(who, "mission_request_int", 1, 1, seq, 0):
            if answer.get_type() == "MISSION_ITEM_INT":
                item = self.protocol.mission.items[seq]
                assert (answer.x, answer.y, answer.seq) == (item.x, item.y, item.seq)

    @rule(who=stations, kind=st.sampled_from([0, 1, 15]))
    def acknowledge(self, who: tuple[int, int], kind: int) -> None:
        self._send(who, "mission_ack", 1, 1, kind, 0)

    @rule(who=stations)
    def clear(self, who: tuple[int, int]) -> None:
        self._send(who, "mission_clear_all", 1, 1, 0)

    @rule(who=stations, seq=st.integers(0, 5))
    def set_current(self, who: tuple[int, int], seq: int) -> None:
        self._send(who, "mission_set_current", 1, 1, seq)

    @rule(seconds=st.sampled_from([0.1, 0.3, 6.0]))
    def wait(self, seconds: float) -> None:
        self.wall_s += seconds
        self.protocol.tick()
        if seconds > 5.0:
            assert not self.protocol.busy

    @invariant()
    def the_mission_on_board_is_one_that_was_accepted_whole(self) -> None:
        assert self.protocol.mission == (self.accepted[-1] if self.accepted else Mission())
        assert [item.seq for item in self.protocol.mission.items] == list(range(len(self.protocol.mission)))


TestAnyOrderOfMessages = AnyOrderOfMessages.TestCase
