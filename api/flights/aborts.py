"""Operations that end by order: an abort, or an order to their vehicles. At once, as often as it is said, in any state.

The same order again joins the one that is being carried out, or finds it done; another one goes before it. Vehicles are
commanded first; books and tasks are closed while they obey.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass

from sqlalchemy import select, update

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.order_rules import reason_to_leave_alone
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_store import Stores
from skyfolio.api.flights.operation_views import Abort, OperationView, State
from skyfolio.api.store.tables import operations as table

ENDING_S = 5.0
"""Wall seconds that the task of an operation may take to end, before its books are closed all the same."""


@dataclass(frozen=True)
class Ending:
    """An order that is being carried out."""

    action: Action
    task: asyncio.Task[None]


class Aborts:
    """`take(operation)`: its task, which is ours from then on; `over(operation)`: it has ended."""

    def __init__(
        self,
        fleet: Fleet,
        stores: Stores,
        take: Callable[[Operation], asyncio.Task[None] | None],
        over: Callable[[Operation], None],
    ) -> None:
        self._fleet, self._stores = fleet, stores
        self._take, self._over = take, over
        self._endings: dict[str, Ending] = {}

    async def abort(self, operation: Operation, action: Action) -> None:
        """End an operation that has not ended: every vehicle of it that still answers gets this order."""
        running = self._endings.get(operation.id)
        if running is None or running.action != action:
            left, task = operation.stop(), self._cancelled(operation)
            flight = operation.flight

            async def end() -> None:
                await self._close(operation, task, Abort(action=action, vehicles=await flight.order(action, left)))

            self._begin(operation.id, action, end())
        await self._newest(operation.id)

    def by_order(
        self, operation: Operation, action: Action, uavs: Collection[str], results: Awaitable[Mapping[str, str | None]]
    ) -> Awaitable[None]:
        """End an operation at once whose vehicles `uavs` are given an order apart from it; `results`: how that went.

        Returns what waits until its books are closed.
        """
        operation.stop()
        task = self._cancelled(operation)
        mine = [uav for uav in uavs if uav in operation.flight.systems]

        async def end() -> None:
            said = await results
            by = Abort(action=action, vehicles={uav: said[uav] for uav in mine})
            await self._close(operation, task, by, f"{action} was ordered for {', '.join(mine) or 'its vehicles'}")

        self._begin(operation.id, action, end())
        return self._newest(operation.id)

    async def again(
        self, view: OperationView, action: Action, elsewhere: Collection[str], held: Operation | None
    ) -> None:
        """Give the vehicles of an aborted operation another order, or the one that failed once more.

        elsewhere: vehicles of other operations. held: the operation while its end is not stored yet. Raises
        ConflictError when the operation has ended otherwise.
        """
        if view.state is not State.ABORTED:
            raise ConflictError(
                f"operation {view.id!r} is already {view.state.value}; `POST /v1/fleet:{action}` commands its vehicles"
            )
        running = self._endings.get(view.id)
        if running is None or running.action != action:
            if running is None and view.abort and view.abort.action == action and not view.abort.error:
                return
            self._begin(view.id, action, self._once_more(view, action, elsewhere, held))
        await self._newest(view.id)

    # -- inside ---------------------------------------------------------------------------------------------------

    def _begin(self, operation_id: str, action: Action, work: Awaitable[None]) -> None:
        async def carry_out() -> None:
            try:
                await work
            finally:
                if self._endings.get(operation_id) is ending:
                    del self._endings[operation_id]

        ending = Ending(action, asyncio.create_task(carry_out(), name=f"{action}-{operation_id}"))
        self._endings[operation_id] = ending

    async def _newest(self, operation_id: str) -> None:
        """Wait until the order that was given last is carried out; it goes on when whoever asked for it does not."""
        while (ending := self._endings.get(operation_id)) is not None:
            await asyncio.shield(ending.task)

    def _cancelled(self, operation: Operation) -> asyncio.Task[None] | None:
        task = self._take(operation)
        if task is not None:
            task.cancel()
        return task

    async def _close(
        self, operation: Operation, task: asyncio.Task[None] | None, by: Abort, why: str | None = None
    ) -> None:
        if task is not None and not task.done():
            await asyncio.wait([task], timeout=ENDING_S)
        if not self._is_newest(operation.id):
            return  # whoever came after closes the books
        if operation.flight.elapsed_s() is None:
            await operation.flight.take_off.stand_down(but=by.vehicles)
        if self._is_newest(operation.id):
            await operation.close_aborted(by, why)
            self._over(operation)

    def _is_newest(self, operation_id: str) -> bool:
        ending = self._endings.get(operation_id)
        return ending is None or ending.task is asyncio.current_task()

    async def _once_more(
        self, view: OperationView, action: Action, elsewhere: Collection[str], held: Operation | None
    ) -> None:
        """Vehicles that are registered otherwise by now, or fly for another operation, are none of this one's."""
        why: dict[str, str | None] = {}
        registered = set(self._fleet.uav_ids)
        for uav, system in view.vehicles.items():
            if uav not in registered or self._fleet.system_of(uav) != system:
                why[uav] = "it is not registered any more"
            elif uav in elsewhere:
                why[uav] = "it flies another operation"
            elif not self._fleet.is_down(system):
                why[uav] = reason_to_leave_alone(self._fleet, uav, action)
        told = [view.vehicles[uav] for uav, reason in why.items() if reason is None]
        errors = await self._fleet.commander.order(action, told)
        by = Abort(action=action, vehicles={uav: reason or errors[view.vehicles[uav]] for uav, reason in why.items()})
        if not self._is_newest(view.id):
            return
        if held is not None:
            await held.close_aborted(by)
        else:
            await self._write(view, by)

    async def _write(self, view: OperationView, by: Abort) -> None:
        changed = view.model_copy(update={"abort": by, "error": by.error, "version": view.version + 1})
        (row,) = await self._stores.database.rows(select(table.c.document).where(table.c.id == view.id))
        document = json.loads(row.document) | {"error": by.error, "view": changed.model_dump(mode="json")}
        values = {"document": json.dumps(document), "version": changed.version}
        await self._stores.database.write(update(table).where(table.c.id == view.id).values(**values))
        self._stores.events.add(
            "operation", operation_id=view.id, state=view.state.value, error=by.error, abort=by.action
        )
