"""The bridge's protocol machines and simulated autopilots on a wire in virtual time: no sockets, no waiting."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio import sim
from skyfolio.mavlink_bridge import Autopilot
from skyfolio.mavlink_bridge.mission_messages import GROUND, Message
from skyfolio.mavlink_bridge.vehicle import Conversation as Talk
from skyfolio.sim.autopilot import Autopilot as SimulatedAutopilot

STEP_S = 0.01
AnyTalk = TypeVar("AnyTalk", bound=Talk)
Filter = Callable[[str, dict[str, Any]], int]
"""How many copies of a message arrive."""


def incoming(message: Message, sender: tuple[int, int] = GROUND) -> Any:
    """Return a message of the bridge as an autopilot decodes it."""
    fields = {name: value.encode() if isinstance(value, str) else value for name, value in message.fields.items()}
    encoded = getattr(dialect, f"MAVLink_{message.name.lower()}_message")(**fields)
    encoded._header = dialect.MAVLink_header(encoded.id, 0, 0, 0, 0, *sender)
    return encoded


def fields_of(message: Any) -> dict[str, Any]:
    """Return a simulated autopilot's message as the bridge receives it."""
    base = getattr(message, "base", message)
    return {name: getattr(base, name) for name in base.fieldnames} | dict(getattr(message, "extension", {}))


def everything(_name: str, _fields: dict[str, Any]) -> int:
    """Lose nothing."""
    return 1


def lossy(chance: random.Random, share: float) -> Filter:
    """Lose this share of the messages."""
    return lambda _name, _fields: int(chance.random() >= share)


class Wire:
    """Carries one conversation with one autopilot: an upload, a download, a command.

    `up` and `down` say how many copies of each message arrive.

    `now_s` is the time both sides live in; make the autopilot with `protocol_clock=lambda: wire.now_s`.
    """

    def __init__(self, *, latency_s: float = 0.005, up: Filter = everything, down: Filter = everything) -> None:
        self.autopilot: Any = None
        self.now_s = 0.0
        self.up, self.down = up, down
        self._latency_s = latency_s
        self._order = count()
        self._flying: list[tuple[float, int, Callable[[], None]]] = []
        self._talk: Talk | None = None

    def run(self, transfer: AnyTalk, *, limit_s: float = 120.0) -> AnyTalk:
        """Let it happen until it has ended."""
        self._talk = transfer
        began_s = self.now_s
        self.send(transfer.start(self.now_s))
        while not transfer.ended and self.now_s - began_s < limit_s:
            self._step(transfer)
        return transfer

    def send(self, messages: list[Message], sender: tuple[int, int] = GROUND) -> None:
        """Send a message from the ground to the vehicle."""
        for message in messages:
            for _ in range(self.up(message.name, message.fields)):
                heard = incoming(message, sender)
                self._later(partial(self._deliver, heard))

    def _step(self, transfer: Talk) -> None:
        soonest = min(self.now_s + STEP_S, transfer.due_s, self._flying[0][0] if self._flying else float("inf"))
        self.now_s = max(soonest, self.now_s + 1e-6)
        while self._flying and self._flying[0][0] <= self.now_s:
            heapq.heappop(self._flying)[2]()
        self._answer(self.autopilot.missions.tick())
        if self.now_s >= transfer.due_s:
            self.send(transfer.tick(self.now_s))

    def _answer(self, messages: list[Any]) -> None:
        for message in messages:
            name, fields = message.get_type(), fields_of(message)
            for _ in range(self.down(name, fields)):
                self._later(partial(self._heard, name, fields))

    def _deliver(self, message: Any) -> None:
        self._answer(self.autopilot.handle(message))

    def _heard(self, name: str, fields: dict[str, Any]) -> None:
        if self._talk is not None:
            self.send(self._talk.handle(name, fields, self.now_s))

    def _later(self, happen: Callable[[], None]) -> None:
        heapq.heappush(self._flying, (self.now_s + self._latency_s, next(self._order), happen))


def autopilot_on(wire: Wire, flavour: Autopilot) -> Any:
    """Return a simulated autopilot, on the ground, at the other end of the wire."""
    autopilot = SimulatedAutopilot(
        sim.VehicleSpec(1, 47.397742, 8.545594, autopilot=flavour.value),
        protocol_clock=lambda: wire.now_s,
        on_event=lambda _kind, _detail: None,
    )
    wire.autopilot = autopilot
    return autopilot
