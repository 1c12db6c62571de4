"""The ground station's side of the MAVLink command protocol, without I/O: one command until its COMMAND_ACK.

COMMAND_ACK names the command and nothing else. So a vehicle is sent one command of a kind at a time, and answers to
copies of an earlier one, which a slow link still delivers, are not taken for the answer to this one.
"""

from __future__ import annotations

from math import inf
from typing import Any

from skyfolio.mavlink_bridge.answers import CommandAnswer
from skyfolio.mavlink_bridge.mission_messages import GROUND, Message
from skyfolio.mavlink_bridge.round_trip import RoundTrip

ANSWER_S = 2.0
"""A vehicle from which nothing is received has this long to answer, plus two round trips."""
PATIENT_S = 6.0
"""A vehicle that is heard meanwhile has this long: its link works, but it may be slow or lose a lot."""
PROGRESS_S = 10.0
"""A vehicle that answered IN_PROGRESS has this long to report more."""


class CommandCall:
    """One COMMAND_LONG or COMMAND_INT, repeated until it is answered. `error` says why it was not done.

    `strays`: the number of answers to copies of an earlier command of this kind that may still be received.
    """

    def __init__(self, message: Message, round_trip: RoundTrip, *, strays: int = 0) -> None:
        self.answer: CommandAnswer | None = None
        self.error: str | None = None
        self.strays = strays
        """The number of answers that may still be received and do not belong to this command."""
        self._message = message
        self._command = int(message.fields["command"])
        self._round_trip = round_trip
        self._began_s = self._sent_s = self._heard_s = 0.0
        self._times = 0
        self._answers = 0
        self._in_progress_s: float | None = None

    @property
    def ended(self) -> bool:
        """Return whether it is over: `error` is None if it was accepted."""
        return self.answer is not None or self.error is not None

    @property
    def due_s(self) -> float:
        """Return when `tick` has something to do."""
        if self.ended:
            return inf
        if self._in_progress_s is not None:
            return self._gives_up_s
        return min(self._sent_s + self._round_trip.timeout_s, self._gives_up_s)

    def start(self, now_s: float) -> list[Message]:
        """Send it; times are seconds of one steady clock."""
        self._began_s = now_s
        return self._send(now_s)

    def alive(self, now_s: float) -> None:
        """Take in that something was received from the vehicle."""
        self._heard_s = now_s

    def handle(self, name: str, fields: dict[str, Any], now_s: float) -> list[Message]:
        """Take in one message of the vehicle; a message that does not answer this command is ignored."""
        if self.ended or name != "COMMAND_ACK" or not self._is_ours(fields):
            return []
        answer = CommandAnswer(int(fields["result"]))
        if answer is CommandAnswer.IN_PROGRESS:
            self._in_progress_s = now_s
            return []
        self._answers += 1
        if self.strays > 0:
            self.strays -= 1
        else:
            self._round_trip.answered(self._began_s, now_s, self._times)
            self.answer = answer
            self.strays = max(self._times - self._answers, 0)
            if answer is not CommandAnswer.ACCEPTED:
                self.error = answer.name
        return []

    def tick(self, now_s: float) -> list[Message]:
        """Repeat it when its time has come; end after a long silence."""
        if self.ended:
            return []
        if now_s >= self._gives_up_s:
            self.give_up("TIMEOUT")
            return []
        if self._in_progress_s is not None or now_s < self._sent_s + self._round_trip.timeout_s:
            return []
        self._round_trip.missed()
        self.strays = 0  # they were sent before: what has not come by now was lost, as on a link that was dead
        return self._send(now_s)

    def give_up(self, why: str = "given up") -> None:
        """Stop waiting: the command may have been done or not."""
        self.error = self.error or why
        self.strays += self._times

    @property
    def _gives_up_s(self) -> float:
        if self._in_progress_s is not None:
            return self._in_progress_s + PROGRESS_S
        round_trips_s = 2 * self._round_trip.seconds
        silent_s = max(self._heard_s, self._began_s) + ANSWER_S + round_trips_s
        return min(silent_s, self._began_s + PATIENT_S + 2 * round_trips_s)

    def _send(self, now_s: float) -> list[Message]:
        fields = self._message.fields
        if "confirmation" in fields:
            fields = {**fields, "confirmation": min(self._times, 255)}
        self._sent_s = now_s
        self._times += 1
        return [Message(self._message.name, fields)]

    def _is_ours(self, fields: dict[str, Any]) -> bool:
        to = (int(fields.get("target_system", 0)), int(fields.get("target_component", 0)))
        mine = to[0] in (0, GROUND[0]) and to[1] in (0, GROUND[1])
        return mine and int(fields["command"]) == self._command
