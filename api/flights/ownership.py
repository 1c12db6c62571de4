"""Which operations are this service's to fly, where several share one database; where none does, all of them are."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from functools import partial
from typing import Any

from sqlalchemy import Row, select

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_store import Stores
from skyfolio.api.flights.operation_views import ENDED, State
from skyfolio.api.store import StoreError
from skyfolio.api.store.leases import Followers
from skyfolio.api.store.tables import operations as table


class Ownership:
    """Claims new operations, takes over those of services that are gone, and lets go of those whose lease ran out.

    active: the operations that this service flies, by id. go_on: flies an operation on from its row. drop: stops
    flying an operation at once, without closing it, and returns the task that still has to end.
    """

    def __init__(
        self,
        stores: Stores,
        active: dict[str, Operation],
        go_on: Callable[[Row[Any]], Awaitable[Operation]],
        drop: Callable[[Operation], asyncio.Task[None] | None],
    ) -> None:
        self._database, self._events, self._leases = stores.database, stores.events, stores.database.leases
        self._active, self._go_on, self._drop = active, go_on, drop
        self._left: dict[str, asyncio.Task[None]] = {}
        """What is still being let go of, of operations whose lease ran out."""
        self._handing: dict[str, asyncio.Task[None]] = {}
        """Ends of streams, by operation."""

    @property
    def shared(self) -> bool:
        """Return whether other services share the database."""
        return self._leases is not None

    def begin(self, is_heard: Callable[[Collection[int]], bool]) -> None:
        """Follow the leases from now on. is_heard: returns whether any of these vehicles is heard here."""
        if self._leases is not None:
            self._leases.followers = Followers(
                running_out=self._end_stream,
                lost=self._lose,
                taken=self._take_over,
                renewed=self._renew_guards,
                is_heard=is_heard,
            )

    def owner(self, operation_id: str) -> str | None:
        """Return the name of the service that an operation belongs to; None where only one uses the database."""
        if self._leases is None:
            return None
        if operation_id in self._active:
            return self._leases.name
        lease = self._leases.book.owner_of(operation_id)
        return None if lease is None else lease.name or None

    def require_ours(self, operation_id: str) -> None:
        """Raise ConflictError, which names the owner, if an operation belongs to another service, or to none now."""
        lease = None if self._leases is None else self._leases.book.owner_of(operation_id)
        if self._leases is None or lease is None:
            return
        if lease.owner == self._leases.book.me or not lease.name:
            raise ConflictError(f"operation {operation_id!r} belongs to no service now: it is about to be taken over")
        raise ConflictError(f"operation {operation_id!r} belongs to service {lease.name!r}: command it there")

    async def create(self, operation: Operation) -> Callable[[], Awaitable[None]] | None:
        """Store a new operation; return what waits until its vehicles are this service's alone, if others share them.

        Raises ConflictError, StoreError.
        """
        leases, systems = self._leases, frozenset(operation.flight.systems.values())
        if leases is None:
            await operation.create()
            return None
        began_s = leases.now_s()
        try:
            await operation.create(leases.claim(operation.id, systems))
        except StoreError:
            await leases.look()  # another service may have claimed a vehicle at the same moment
            leases.claim(operation.id, systems)
            raise
        leases.claimed(operation.id, systems, began_s)
        return partial(leases.wait_until_alone, leases.now_s())

    def end(self, operation_id: str) -> None:
        """Free the vehicles of an operation that is over."""
        leases = self._leases
        if leases is not None:
            ended = [*leases.require(operation_id), leases.ended(operation_id)]

            def stored(done: asyncio.Future[None]) -> None:
                if done.cancelled() or done.exception() is not None:  # it is another service's, which frees them
                    leases.book.let_go(operation_id)
                else:
                    leases.book.forget(operation_id)

            self._database.write_soon(*ended, keep=True).add_done_callback(stored)

    # -- when leases change hands ---------------------------------------------------------------------------------

    async def _take_over(self, operation_id: str) -> None:
        """Go on with an operation whose lease this service has just been given. Raises StoreError."""
        left = self._left.get(operation_id)
        if left is not None:  # it was ours before, and is still being let go of
            await asyncio.wait({left})
        rows = await self._database.rows(select(table).where(table.c.id == operation_id))
        if not rows or State(rows[0].state) in ENDED:
            self.end(operation_id)
            return
        operation = await self._go_on(rows[0])
        self._events.add("operation_taken_over", operation_id=operation.id, service=self.owner(operation.id))

    def _end_stream(self, operation_id: str) -> None:
        """Let streamed UAVs fly the missions on board while we may still tell them to: the lease soon runs out."""
        operation = self._active.get(operation_id)
        if operation is None or operation_id in self._handing or not operation.flight.guidance.is_streaming:
            return
        because = "the lease is not renewed: UAVs fly the missions on board"
        self._events.add("stream_ended", operation_id=operation_id, level="warning", because=because)
        task = asyncio.create_task(operation.flight.guidance.end_stream(), name=f"end stream {operation_id}")
        self._handing[operation_id] = task
        task.add_done_callback(lambda _done: self._handing.pop(operation_id, None))

    def _lose(self, operation_id: str) -> None:
        """Leave an operation alone, at once: its lease has run out, and another service may have it.

        Its vehicles fly the missions on board. Nothing of it is stored here any more.
        """
        operation = self._active.get(operation_id)
        if operation is None:
            return
        operation.stop()
        task = self._drop(operation)
        if task is not None:
            task.cancel()
            self._left[operation_id] = task
            task.add_done_callback(lambda _done: self._left.pop(operation_id, None))
        name = None if self._leases is None else self._leases.name
        because = "its lease ran out"
        self._events.add("operation_left", operation_id=operation_id, level="warning", service=name, because=because)

    def _renew_guards(self) -> None:
        for operation in self._active.values():
            operation.flight.guidance.renew_guard()
