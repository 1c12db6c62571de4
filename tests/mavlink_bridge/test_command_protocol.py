"""One command and its answer, in virtual time: what is repeated, what is believed, and when it is given up."""

from __future__ import annotations

import pytest

from skyfolio.api.lab.virtual_wire import Wire, autopilot_on
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.mavlink_bridge.answers import Ack, CommandAnswer
from skyfolio.mavlink_bridge.command_protocol import CommandCall
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.round_trip import RoundTrip

ARM, NO_SUCH = 400, 31_000
TO_US = {"target_system": 245, "target_component": 190}


def order(command: int = ARM, *params: float) -> Message:
    values = [*params, *[0.0] * (7 - len(params))]
    fields = {f"param{n}": value for n, value in enumerate(values, start=1)}
    return Message(
        "COMMAND_LONG", {"command": command, "confirmation": 0, "target_system": 1, "target_component": 1, **fields}
    )


def answered(call: CommandCall, result: int, now_s: float, *, command: int = ARM) -> None:
    call.handle("COMMAND_ACK", {"command": command, "result": result, **TO_US}, now_s)


def until_over(call: CommandCall, *, heard: bool) -> float:
    """Let time pass without an answer and return when it was given up."""
    now_s = 0.0
    while not call.ended:
        now_s += 0.01
        if heard:
            call.alive(now_s)
        call.tick(now_s)
    return now_s


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_command_on_a_clean_link_is_sent_once(autopilot: Autopilot) -> None:
    wire, round_trip = Wire(latency_s=0.005), RoundTrip()
    autopilot_on(wire, autopilot)
    call = wire.run(CommandCall(order(ARM, 1.0), round_trip))
    assert (call.answer, call.error, call.strays) == (CommandAnswer.ACCEPTED, None, 0)
    assert round_trip.seconds == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize("result", range(1, 256))
def test_every_result_but_accepted_ends_it_with_a_name(result: int) -> None:
    call = CommandCall(order(), RoundTrip())
    call.start(0.0)
    answered(call, result, 0.1)
    if result == CommandAnswer.IN_PROGRESS:
        assert not call.ended
    else:
        assert call.error == CommandAnswer(result).name
        assert call.error


def test_what_nobody_has_named_yet_is_called_by_its_number() -> None:
    assert [CommandAnswer(number).name for number in (7, 8, 200)] == [
        "COMMAND_LONG_ONLY",
        "COMMAND_INT_ONLY",
        "UNKNOWN_200",
    ]
    assert (Ack(77).name, int(Ack(77))) == ("UNKNOWN_77", 77)


def test_lost_orders_and_lost_answers_are_made_good_by_copies_that_say_how_many_they_are() -> None:
    confirmations: list[int] = []

    def lose_two(name: str, fields: dict[str, object]) -> int:
        assert name == "COMMAND_LONG"
        confirmations.append(int(str(fields["confirmation"])))
        return int(len(confirmations) > 2)

    wire = Wire(up=lose_two)
    autopilot_on(wire, Autopilot.ARDUPILOT)
    call = wire.run(CommandCall(order(ARM, 1.0), RoundTrip()))
    assert call.error is None
    assert confirmations == [0, 1, 2]


def test_an_answer_to_another_command_or_station_is_none() -> None:
    call = CommandCall(order(), RoundTrip())
    call.start(0.0)
    answered(call, 4, 0.1, command=176)
    call.handle("COMMAND_ACK", {"command": ARM, "result": 4, "target_system": 255, "target_component": 190}, 0.1)
    assert not call.ended


def test_a_silent_vehicle_is_given_two_seconds_and_one_that_is_heard_six() -> None:
    silent, heard = CommandCall(order(), RoundTrip()), CommandCall(order(), RoundTrip())
    silent.start(0.0)
    heard.start(0.0)
    assert until_over(silent, heard=False) == pytest.approx(2.0, abs=0.02)
    assert until_over(heard, heard=True) == pytest.approx(6.0, abs=0.02)
    assert (silent.error, heard.error) == ("TIMEOUT", "TIMEOUT")


def test_a_vehicle_that_works_on_it_is_not_asked_again() -> None:
    call = CommandCall(order(), RoundTrip())
    call.start(0.0)
    answered(call, CommandAnswer.IN_PROGRESS, 0.1)
    assert call.tick(5.0) == []
    assert not call.ended
    answered(call, CommandAnswer.ACCEPTED, 9.0)
    assert (call.ended, call.error) == (True, None)


@pytest.mark.parametrize("autopilot", list(Autopilot))
@pytest.mark.parametrize("before_s", [0.005, None])
def test_on_a_link_of_a_second_each_way_every_command_is_answered_and_soon_none_is_repeated(
    autopilot: Autopilot, before_s: float | None
) -> None:
    wire, round_trip = Wire(latency_s=1.0), RoundTrip()
    vehicle = autopilot_on(wire, autopilot)
    if before_s is not None:  # the link was quick until now
        for _ in range(20):
            round_trip.answered(0.0, 2 * before_s, 1)
    copies = []
    for _ in range(8):
        sent = 0

        def count(_name: str, _fields: dict[str, object]) -> int:
            nonlocal sent
            sent += 1
            return 1

        wire.up = count
        call = CommandCall(order(ARM, 1.0), round_trip)

        def heard(_name: str, _fields: dict[str, object]) -> int:
            call.alive(wire.now_s)  # noqa: B023
            return 1

        wire.down = heard
        wire.run(call)
        assert call.error is None
        copies.append(sent)
        wire.now_s += 5.0  # what is still under way arrives
    assert vehicle.armed
    assert copies[-3:] == [1, 1, 1]
    assert round_trip.timeout_s > 2.0


def test_a_late_answer_to_a_copy_of_the_order_before_is_not_taken_for_this_ones() -> None:
    round_trip = RoundTrip()
    first = CommandCall(order(), round_trip)
    first.start(0.0)
    first.tick(0.4)
    answered(first, CommandAnswer.ACCEPTED, 0.5)
    assert first.strays == 1
    second = CommandCall(order(), round_trip, strays=first.strays)
    second.start(0.6)
    answered(second, CommandAnswer.ACCEPTED, 0.7)
    assert not second.ended
    answered(second, CommandAnswer.FAILED, 0.8)
    assert second.error == "FAILED"


def test_answers_to_copies_that_a_dead_link_lost_are_not_waited_for_once_it_works_again() -> None:
    round_trip = RoundTrip()
    unheard = CommandCall(order(), round_trip)
    unheard.start(0.0)
    while not unheard.ended:
        unheard.tick(unheard.due_s)
    assert (unheard.error, unheard.strays > 2) == ("TIMEOUT", True)
    again = CommandCall(order(), round_trip, strays=unheard.strays)
    again.start(3.0)
    answered(again, CommandAnswer.ACCEPTED, 3.1)
    again.alive(again.due_s)
    again.tick(again.due_s)
    answered(again, CommandAnswer.ACCEPTED, again.due_s)
    assert (again.answer, again.error) == (CommandAnswer.ACCEPTED, None)
