"""The commands to one vehicle that are waiting for their COMMAND_ACK: one of each kind at a time."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from skyfolio.mavlink_bridge.command_protocol import CommandCall
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.round_trip import RoundTrip

ACK = "COMMAND_ACK"


class OpenCommands:
    """Sends commands through `send` and hands each COMMAND_ACK to the command it answers. Lives on the event loop."""

    def __init__(
        self, send: Callable[[list[Message]], None], round_trip: RoundTrip, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._send, self._round_trip, self._loop = send, round_trip, loop
        self._calls: dict[int, CommandCall] = {}
        self._answered = asyncio.Event()
        self._one_of_a_kind: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._strays: dict[int, tuple[int, float]] = {}
        """For each command, how many answers to earlier copies of it may still come, and until when."""

    async def ask(self, message: Message) -> CommandCall:
        """Send a COMMAND_LONG or COMMAND_INT, and return it once it is answered, or will not be."""
        number = int(message.fields["command"])
        async with self._one_of_a_kind[number]:
            strays, until_s = self._strays.pop(number, (0, 0.0))
            call = CommandCall(message, self._round_trip, strays=strays if self._loop.time() < until_s else 0)
            self._calls[number] = call
            try:
                self._send(call.start(self._loop.time()))
                while not call.ended:
                    await self._until(call.due_s)
                    self._send(call.tick(self._loop.time()))
            finally:
                del self._calls[number]
                if not call.ended:
                    call.give_up()
                if call.strays:
                    self._strays[number] = (call.strays, self._loop.time() + 2 * self._round_trip.timeout_s)
        return call

    def alive(self, now_s: float) -> None:
        """Note that the vehicle has sent something, whatever it is."""
        for call in self._calls.values():
            call.alive(now_s)

    def heard_again(self, now_s: float) -> None:
        """Send again at once what a dead link has swallowed: the link carries messages again."""
        self._round_trip.heard_again(now_s)
        self._wake()

    def take_answer(self, fields: dict[str, Any], now_s: float) -> None:
        """Take in a COMMAND_ACK."""
        number = int(fields["command"])
        call = self._calls.get(number)
        if call is not None:
            call.handle(ACK, fields, now_s)
            self._wake()
        elif number in self._strays:
            left, until_s = self._strays.pop(number)
            if left > 1:
                self._strays[number] = (left - 1, until_s)

    def _wake(self) -> None:
        answered, self._answered = self._answered, asyncio.Event()
        answered.set()

    async def _until(self, due_s: float) -> None:
        """Wait for an answer to any command, at most until `due_s`."""
        with suppress(TimeoutError):
            async with asyncio.timeout_at(due_s):
                await self._answered.wait()
