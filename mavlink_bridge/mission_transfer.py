"""What uploads and downloads of the MAVLink mission protocol share, without I/O: messages and time in, messages out."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

from skyfolio.mavlink_bridge.mission_messages import AUTOPILOT_COMPONENT, GROUND, Ended, Message, MissionType
from skyfolio.mavlink_bridge.round_trip import RoundTrip


class Transfer:
    """What uploads and downloads share: the open request, its timer, and the end."""

    def __init__(
        self, system_id: int, mission_type: MissionType, round_trip: RoundTrip | None, silence_s: float
    ) -> None:
        self.ended: Ended | None = None
        self._silence_s = silence_s
        self._type = mission_type
        self._address = {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT}
        self._round_trip = round_trip or RoundTrip()
        self._question: Message | None = None
        self._first_s = self._asked_s = self._heard_s = 0.0
        self._times = 0
        self._handlers: dict[str, Callable[[dict[str, Any], float], list[Message]]] = {}

    @property
    def due_s(self) -> float:
        """Return when `tick` has something to do."""
        return inf if self.ended else min(self._asked_s + self._round_trip.timeout_s, self._heard_s + self._limit_s)

    @property
    def _limit_s(self) -> float:
        """Return the seconds of silence that end it; on a slow link they begin after two round trips."""
        return self._silence_s + 2 * self._round_trip.seconds

    def start(self, now_s: float) -> list[Message]:
        """Begin; times are seconds of one steady clock."""
        self._heard_s = now_s
        return self._ask(self._opening(), now_s)

    def handle(self, name: str, fields: dict[str, Any], now_s: float) -> list[Message]:
        """Take in one message of the vehicle; one for another station or of another mission type is ignored."""
        handler = self._handlers.get(name)
        if handler is None or self.ended or not self._is_ours(fields):
            return []
        self._heard_s = now_s
        return handler(fields, now_s)

    def tick(self, now_s: float) -> list[Message]:
        """Repeat the open request when its time has come; end after a long silence."""
        if self.ended or self._question is None:
            return []
        if now_s >= self._heard_s + self._limit_s:
            self.ended = Ended(
                error=f"{self._question.name}: no answer for {round(self._limit_s, 1):g} s",
                perhaps_done=self._all_sent(),
            )
            return []
        timeout_s = self._round_trip.timeout_s
        if now_s < self._asked_s + timeout_s:  # as `due_s` has it: a difference may round the other way
            return []
        self._round_trip.missed()
        return self._repeat(now_s, timeout_s)

    def give_up(self) -> None:
        """End it: the link is lost."""
        self.ended = self.ended or Ended(error="given up: the link was declared lost")

    def _opening(self) -> Message:
        raise NotImplementedError

    def _all_sent(self) -> bool:
        return False

    def _repeat(self, now_s: float, timeout_s: float) -> list[Message]:
        """Send again what has not been answered for `timeout_s`."""
        del timeout_s
        assert self._question is not None  # noqa: S101
        self._asked_s = now_s
        self._times += 1
        return [self._question]

    def _ask(self, question: Message, now_s: float) -> list[Message]:
        self._question, self._first_s, self._asked_s, self._times = question, now_s, now_s, 1
        return [question]

    def _answered(self, now_s: float) -> None:
        """Measure the round trip of the open request, which was answered."""
        self._round_trip.answered(self._first_s, now_s, self._times)

    def _is_ours(self, fields: dict[str, Any]) -> bool:
        to = (int(fields.get("target_system", 0)), int(fields.get("target_component", 0)))
        mine = to[0] in (0, GROUND[0]) and to[1] in (0, GROUND[1])
        return mine and int(fields.get("mission_type", 0)) == self._type

    def _message(self, name: str, **fields: Any) -> Message:
        return Message(name, {**self._address, "mission_type": int(self._type), **fields})
