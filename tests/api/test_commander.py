"""Orders go before commands, the newest order wins, and one vehicle never hides another."""

import asyncio
from collections.abc import Iterable

import pytest

from skyfolio.api.fleet.commander import OVERTAKEN, Commander, OvertakenError
from skyfolio.mavlink_bridge.results import CommandResult


class Link:
    """Notes what is sent; `gate` holds answers back; `refuses` has the vehicles that do not obey."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, int]] = []
        self.gate = asyncio.Event()
        self.refuses: set[int] = set()

    async def _answer(self, action: str, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        found = {}
        for system_id in system_ids:
            self.sent.append((action, system_id))
            await self.gate.wait()
            error = "denied" if system_id in self.refuses else None
            found[system_id] = CommandResult(system_id=system_id, seconds=0.0, error=error)
        return found

    async def hold(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        return await self._answer("hold", system_ids)

    async def land(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        return await self._answer("land", system_ids)

    async def return_home(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        return await self._answer("return", system_ids)


async def soon() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def test_an_order_ends_what_is_being_sent_to_its_vehicle_and_to_nobody_else() -> None:
    async def check() -> None:
        link = Link()
        commander = Commander(lambda: link)
        swaps = {system: asyncio.create_task(commander.carry_out(system, asyncio.sleep(60))) for system in (1, 2)}
        await soon()
        order = asyncio.create_task(commander.order("hold", [1]))
        await soon()
        assert isinstance(swaps[1].exception(), OvertakenError)
        assert not swaps[2].done()
        with pytest.raises(OvertakenError):
            await commander.carry_out(1, asyncio.sleep(0))  # not before the order is carried out
        link.gate.set()
        assert await order == {1: None}
        await commander.carry_out(1, asyncio.sleep(0))
        swaps[2].cancel()

    asyncio.run(check())


def test_the_same_order_many_times_is_sent_once_and_all_get_its_result() -> None:
    async def check() -> None:
        link = Link()
        link.refuses = {2}
        commander = Commander(lambda: link)
        orders = [asyncio.create_task(commander.order("land", [1, 2])) for _ in range(50)]
        await soon()
        link.gate.set()
        assert await asyncio.gather(*orders) == [{1: None, 2: "denied"}] * 50
        assert sorted(link.sent) == [("land", 1), ("land", 2)]
        assert await commander.order("land", [1]) == {1: None}  # later it is sent again
        assert link.sent[-1] == ("land", 1)

    asyncio.run(check())


def test_another_order_goes_before_the_one_that_is_being_given() -> None:
    async def check() -> None:
        link = Link()
        commander = Commander(lambda: link)
        hold = asyncio.create_task(commander.order("hold", [1, 2]))
        await soon()
        land = asyncio.create_task(commander.order("land", [1]))
        await soon()
        link.gate.set()
        assert await hold == {1: OVERTAKEN, 2: None}
        assert await land == {1: None}
        assert link.sent == [("hold", 1), ("hold", 2), ("land", 1)]

    asyncio.run(check())


def test_an_order_goes_on_when_whoever_asked_for_it_does_not_wait() -> None:
    async def check() -> None:
        link = Link()
        commander = Commander(lambda: link)
        asked = asyncio.create_task(commander.order("return", [1]))
        await soon()
        asked.cancel()
        await soon()
        again = asyncio.create_task(commander.order("return", [1]))
        await soon()
        link.gate.set()
        assert await again == {1: None}
        assert link.sent == [("return", 1)]

    asyncio.run(check())
