"""How vehicles are commanded: an emergency order takes precedence over everything else that is being sent to a vehicle.

Whatever a flight sends goes through `carry_out`, each vehicle on its own. An order ends at once what is being sent to
its vehicle, and nothing else. The newest order wins, and one that is repeated while it is being carried out is sent
once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping
from typing import Any, Literal, Protocol, TypeAlias, TypeVar

from skyfolio.mavlink_bridge import BridgeError
from skyfolio.mavlink_bridge.results import CommandResult

Action: TypeAlias = Literal["hold", "land", "return"]
Results: TypeAlias = Mapping[int, CommandResult]
Result = TypeVar("Result")
OVERTAKEN = "a later order overtook it"


class OvertakenError(BridgeError):
    """An order was given to the vehicle before a command to it was carried out."""


class Link(Protocol):
    """The orders that vehicles are sent; `FleetLink` has them."""

    async def hold(self, system_ids: Iterable[int]) -> Results:
        """Stop these vehicles, and let them hover."""

    async def land(self, system_ids: Iterable[int]) -> Results:
        """Land these vehicles where they are."""

    async def return_home(self, system_ids: Iterable[int]) -> Results:
        """Return these vehicles to where they took off."""


class Commander:
    """Sends commands and orders to the vehicles of one link, by system id. Lives on the event loop.

    link: returns the link, which need not be open before the first command.
    """

    def __init__(self, link: Callable[[], Link]) -> None:
        self._link = link
        self._work: dict[int, set[asyncio.Task[Any]]] = {}
        self._orders: dict[int, tuple[Action, asyncio.Task[CommandResult]]] = {}

    async def carry_out(self, system_id: int, work: Coroutine[Any, Any, Result]) -> Result:
        """Carry out a command to one vehicle. Raises OvertakenError if an order is given to it before that is done."""
        if system_id in self._orders:
            work.close()
            raise OvertakenError(OVERTAKEN)
        task = asyncio.create_task(work)
        under_way = self._work.setdefault(system_id, set())
        under_way.add(task)
        try:
            await asyncio.wait([task])
        finally:
            task.cancel()
            under_way.discard(task)
        if task.cancelled():
            raise OvertakenError(OVERTAKEN)
        return task.result()

    async def each(
        self, command: Callable[[list[int]], Awaitable[Results]], system_ids: Iterable[int]
    ) -> dict[int, str | None]:
        """Carry out a command for each of these vehicles, all at once; return for each what went wrong, or None."""

        async def carry_out_one(system_id: int) -> str | None:
            try:
                return (await self.carry_out(system_id, _for_one(command, system_id))).error
            except OvertakenError as error:
                return str(error)

        ids = list(system_ids)
        return dict(zip(ids, await asyncio.gather(*map(carry_out_one, ids)), strict=True))

    async def order(self, action: Action, system_ids: Iterable[int]) -> dict[int, str | None]:
        """Give each of these vehicles an order, all at once; return for each what went wrong, or None.

        The orders are begun before anything is awaited, and are carried out even if the caller stops waiting.
        """
        orders = {system_id: self._begin_order(action, system_id) for system_id in system_ids}
        if orders:
            await asyncio.wait(orders.values())
        return {
            system_id: OVERTAKEN if order.cancelled() else order.result().error for system_id, order in orders.items()
        }

    def _begin_order(self, action: Action, system_id: int) -> asyncio.Task[CommandResult]:
        current = self._orders.get(system_id)
        if current is not None and current[0] == action:
            return current[1]
        for task in self._work.get(system_id, ()):
            task.cancel()
        if current is not None:
            current[1].cancel()
        link = self._link()
        commands = {"hold": link.hold, "land": link.land, "return": link.return_home}
        task = asyncio.create_task(_for_one(commands[action], system_id), name=f"{action}-{system_id}")
        self._orders[system_id] = action, task
        task.add_done_callback(lambda done: self._end_order(system_id, done))
        return task

    def _end_order(self, system_id: int, done: asyncio.Task[CommandResult]) -> None:
        if system_id in self._orders and self._orders[system_id][1] is done:
            del self._orders[system_id]


async def _for_one(command: Callable[[list[int]], Awaitable[Results]], system_id: int) -> CommandResult:
    return (await command([system_id]))[system_id]
