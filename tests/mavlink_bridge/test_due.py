"""A conversation that says when it is due does something then: who waits for that moment would wait for ever."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from skyfolio.mavlink_bridge import Autopilot, MissionItem
from skyfolio.mavlink_bridge.command_protocol import CommandCall
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.mission_protocol import Download, Upload
from skyfolio.mavlink_bridge.parameters import ParameterRead
from skyfolio.mavlink_bridge.round_trip import RoundTrip
from skyfolio.mavlink_bridge.vehicle import Conversation
from skyfolio.mavlink_bridge.verified import VerifiedUpload

ITEMS = [MissionItem(seq=seq, frame=6, command=16, x=1, y=2, z=60.0) for seq in range(4)]
COMMAND = Message("COMMAND_LONG", {"command": 400, "confirmation": 0, "target_system": 1, "target_component": 1})
TALKS: dict[str, Callable[[], Conversation]] = {
    "upload": lambda: Upload(ITEMS, 1, round_trip=RoundTrip()),
    "download": lambda: Download(1, round_trip=RoundTrip()),
    "verified upload": lambda: VerifiedUpload(ITEMS, 1, autopilot=Autopilot.PX4, round_trip=RoundTrip()),
    "parameters": lambda: ParameterRead(["MPC_XY_CRUISE"], 1, Autopilot.PX4, RoundTrip()),
    "command": lambda: CommandCall(COMMAND, RoundTrip()),
}


@pytest.mark.parametrize("talk", TALKS)
def test_at_the_moment_it_is_due_it_does_something_whenever_it_began(talk: str) -> None:
    for begin in range(500):
        conversation = TALKS[talk]()
        conversation.start(begin * 12.345678)
        while not conversation.ended:
            due_s = conversation.due_s
            said = conversation.tick(due_s)
            assert said or conversation.ended or conversation.due_s > due_s, f"it began at {begin * 12.345678} s"
