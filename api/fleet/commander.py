"""Who may command a vehicle: an emergency order goes before everything else that is being sent to it.

Whatever a flight sends goes through `carry_out`, each vehicle for itself. An order ends what is under way for its
vehicle, at once, and nothing else; the newest order wins, and the same one given many times is sent once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping
from typing import Any, Literal, Protocol, TypeAlias, TypeVar

from skyfolio.mavlink_bridge import BridgeError
from skyfolio.mavlink_bridge.results import CommandResult

Action: TypeAlias = Literal["hold", "land", "return"]
Results: TypeAlias = Mapping[int, CommandResult]
Done = TypeVar("Done")
OVERTAKEN = "another order came after it"


class OvertakenError(BridgeError):
    """An order was given to the vehicle before a command to it was carried out."""


class Link(Protocol):
    """The orders that vehicles are given; `FleetLink` has them."""

    async def hold(self, system_ids: Iterable[int]) -> Results:
        """Stop and hover."""

    async def land(self, system_ids: Iterable[int]) -> Results:
        """Land where they are."""

    async def return_home(self, system_ids: Iterable[int]) -> Results:
        """Return to where they took off."""


class Commander:
    """Commands and orders to the vehicles of one link, by system id. Lives on the event loop."""

    def __init__(self, link: Callable[[], Link]) -> None:
        self._link = link
        self._work: dict[int, set[asyncio.Task[Any]]] = {}
        self._orders: dict[int, tuple[Action, asyncio.Task[CommandResult]]] = {}

    async def carry_out(self, system_id: int, work: Coroutine[Any, Any, Done]) -> Done:
        """Do what is sent to one vehicle. Raises OvertakenError when an order was given to it, before or meanwhile."""
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
        """Carry out a command for each of these, all at once; for each what went wrong, or None."""

        async def one(system_id: int) -> str | None:
            try:
                return (await self.carry_out(system_id, _only(command, system_id))).error
            except OvertakenError as error:
                return str(error)

        ids = list(system_ids)
        return dict(zip(ids, await asyncio.gather(*map(one, ids)), strict=True))

    async def order(self, action: Action, system_ids: Iterable[int]) -> dict[int, str | None]:
        """Give each of these an order, all at once; for each what went wrong, or None.

        It is begun before this waits for anything, and goes on when whoever waits for it does not any more.
        """
        orders = {system_id: self._ordered(action, system_id) for system_id in system_ids}
        if orders:
            await asyncio.wait(orders.values())
        return {
            system_id: OVERTAKEN if order.cancelled() else order.result().error for system_id, order in orders.items()
        }

    def _ordered(self, action: Action, system_id: int) -> asyncio.Task[CommandResult]:
        given = self._orders.get(system_id)
        if given is not None and given[0] == action:
            return given[1]
        for task in self._work.get(system_id, ()):
            task.cancel()
        if given is not None:
            given[1].cancel()
        link = self._link()
        commands = {"hold": link.hold, "land": link.land, "return": link.return_home}
        task = asyncio.create_task(_only(commands[action], system_id), name=f"{action}-{system_id}")
        self._orders[system_id] = action, task
        task.add_done_callback(lambda done: self._given(system_id, done))
        return task

    def _given(self, system_id: int, done: asyncio.Task[CommandResult]) -> None:
        if system_id in self._orders and self._orders[system_id][1] is done:
            del self._orders[system_id]


async def _only(command: Callable[[list[int]], Awaitable[Results]], system_id: int) -> CommandResult:
    return (await command([system_id]))[system_id]
