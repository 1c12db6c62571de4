"""Commands to a vehicle whose link was dead for a while, in virtual time."""

from __future__ import annotations

import asyncio

from skyfolio.api.lab.virtual.loop import run
from skyfolio.mavlink_bridge.mission_messages import Message
from skyfolio.mavlink_bridge.open_commands import OpenCommands
from skyfolio.mavlink_bridge.round_trip import RoundTrip

REQUEST = 512
THERE_AND_BACK_S = 0.01
TO_US = {"target_system": 245, "target_component": 190}


class Radio:
    """Answers every command at once while it is on; what is sent meanwhile is lost."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.on = True
        self.commands = OpenCommands(self.carry, RoundTrip(), self.loop)

    def carry(self, messages: list[Message]) -> None:
        for message in messages:
            if self.on:
                answer = {"command": message.fields["command"], "result": 0, **TO_US}
                self.loop.call_later(THERE_AND_BACK_S, self.commands.take_answer, answer, self.loop.time())

    async def request(self) -> float:
        """Seconds until a request was answered, or given up."""
        began_s = self.loop.time()
        await self.commands.ask(Message("COMMAND_LONG", {"command": REQUEST, "confirmation": 0}))
        return self.loop.time() - began_s

    async def fail(self, for_s: float) -> None:
        """Be off for so long, while somebody goes on asking; then be heard again."""
        self.on = False
        asking = asyncio.create_task(self._go_on_asking())
        await asyncio.sleep(for_s)
        self.on = True
        self.commands.heard_again(self.loop.time())
        self.commands.alive(self.loop.time())
        await asking

    async def _go_on_asking(self) -> None:
        while not self.on:
            await self.request()


def test_after_a_dead_link_every_command_is_answered_as_quickly_as_before() -> None:
    async def fly() -> list[float]:
        radio = Radio()
        for _ in range(20):
            await radio.request()
        await radio.fail(for_s=11.5)
        return [await radio.request() for _ in range(6)]

    seconds, _ = run(fly())
    assert sum(seconds) < 1.0
    assert max(seconds[1:]) < 2 * THERE_AND_BACK_S


def test_a_command_that_waits_when_the_link_comes_back_is_sent_again_at_once() -> None:
    async def fly() -> float:
        radio = Radio()
        await radio.request()
        radio.on = False
        waiting = asyncio.create_task(radio.request())
        await asyncio.sleep(1.9)
        radio.on = True
        back_s = radio.loop.time()
        radio.commands.heard_again(back_s)
        radio.commands.alive(back_s)
        await waiting
        return radio.loop.time() - back_s

    seconds, _ = run(fly())
    assert seconds < 0.1
