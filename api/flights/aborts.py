"""Operations that end by order: an abort, or an order to their vehicles.

An order is carried out at once, in any state, as often as it is given. The same order again joins the one that is being
carried out, or finds it done; a different one overtakes it. Vehicles are commanded first, and the operation is closed
while they obey.
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
"""Wall seconds that the task of an operation may take to end; then the operation is closed without waiting for it."""


@dataclass(frozen=True)
class Ending:
    """An order that is being carried out."""

    action: Action
    task: asyncio.Task[None]


class Aborts:
    """Carries out the orders that end operations.

    take_task: hands over the task that runs an operation, if there is one. has_ended: called when an operation has
    ended.
    """

    def __init__(
        self,
        fleet: Fleet,
        stores: Stores,
        take_task: Callable[[Operation], asyncio.Task[None] | None],
        has_ended: Callable[[Operation], None],
    ) -> None:
        self._fleet, self._stores = fleet, stores
        self._take_task, self._has_ended = take_task, has_ended
        self._endings: dict[str, Ending] = {}

    async def abort(self, operation: Operation, action: Action) -> None:
        """End an operation that has not ended: give this order to every vehicle of it that may be commanded."""
        running = self._endings.get(operation.id)
        if running is None or running.action != action:
            commandable, task = operation.stop(), self._cancelled(operation)
            flight = operation.flight

            async def end() -> None:
                await self._close(
                    operation, task, Abort(action=action, vehicles=await flight.order(action, commandable))
                )

            self._begin(operation.id, action, end())
        await self._wait_for_newest(operation.id)

    def abort_by_fleet_order(
        self, operation: Operation, action: Action, uavs: Collection[str], results: Awaitable[Mapping[str, str | None]]
    ) -> Awaitable[None]:
        """End at once an operation whose vehicles are given an order apart from it.

        uavs: the vehicles that are ordered. results: how that went. Returns what waits until the operation is closed.
        """
        operation.stop()
        task = self._cancelled(operation)
        own_uavs = [uav for uav in uavs if uav in operation.flight.systems]

        async def end() -> None:
            errors = await results
            order = Abort(action=action, vehicles={uav: errors[uav] for uav in own_uavs})
            why = f"{action} was ordered for {', '.join(own_uavs) or 'its vehicles'}"
            await self._close(operation, task, order, why)

        self._begin(operation.id, action, end())
        return self._wait_for_newest(operation.id)

    async def order_again(
        self, view: OperationView, action: Action, busy: Collection[str], unsaved: Operation | None
    ) -> None:
        """Give the vehicles of an aborted operation another order, or repeat the one that failed.

        busy: vehicles of other operations. unsaved: the operation while its end is not stored yet. Raises ConflictError
        if the operation ended otherwise.
        """
        if view.state is not State.ABORTED:
            raise ConflictError(
                f"operation {view.id!r} is already {view.state.value}; `POST /v1/fleet:{action}` commands its vehicles"
            )
        running = self._endings.get(view.id)
        if running is None or running.action != action:
            if running is None and view.abort and view.abort.action == action and not view.abort.error:
                return
            self._begin(view.id, action, self._repeat(view, action, busy, unsaved))
        await self._wait_for_newest(view.id)

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

    async def _wait_for_newest(self, operation_id: str) -> None:
        """Wait until the newest order is carried out, which it is even if the caller stops waiting."""
        while (ending := self._endings.get(operation_id)) is not None:
            await asyncio.shield(ending.task)

    def _cancelled(self, operation: Operation) -> asyncio.Task[None] | None:
        task = self._take_task(operation)
        if task is not None:
            task.cancel()
        return task

    async def _close(
        self, operation: Operation, task: asyncio.Task[None] | None, order: Abort, why: str | None = None
    ) -> None:
        if task is not None and not task.done():
            await asyncio.wait([task], timeout=ENDING_S)
        if not self._is_newest(operation.id):
            return  # a newer order closes the operation
        if operation.flight.elapsed_s() is None:
            await operation.flight.take_off.stand_down(except_for=order.vehicles)
        if self._is_newest(operation.id):
            await operation.close_aborted(order, why)
            self._has_ended(operation)

    def _is_newest(self, operation_id: str) -> bool:
        ending = self._endings.get(operation_id)
        return ending is None or ending.task is asyncio.current_task()

    async def _repeat(
        self, view: OperationView, action: Action, busy: Collection[str], unsaved: Operation | None
    ) -> None:
        """Order the vehicles that are still registered as they were, and fly for no other operation."""
        reasons: dict[str, str | None] = {}
        registered = set(self._fleet.uav_ids)
        for uav, system in view.vehicles.items():
            if uav not in registered or self._fleet.system_of(uav) != system:
                reasons[uav] = "it is no longer registered"
            elif uav in busy:
                reasons[uav] = "it flies another operation"
            elif not self._fleet.is_down(system):
                reasons[uav] = reason_to_leave_alone(self._fleet, uav, action)
        ordered = [view.vehicles[uav] for uav, reason in reasons.items() if reason is None]
        errors = await self._fleet.commander.order(action, ordered)
        outcomes = {uav: reason or errors[view.vehicles[uav]] for uav, reason in reasons.items()}
        order = Abort(action=action, vehicles=outcomes)
        if not self._is_newest(view.id):
            return
        if unsaved is not None:
            await unsaved.close_aborted(order)
        else:
            await self._write(view, order)

    async def _write(self, view: OperationView, order: Abort) -> None:
        changed = view.model_copy(update={"abort": order, "error": order.error, "version": view.version + 1})
        (row,) = await self._stores.database.rows(select(table.c.document).where(table.c.id == view.id))
        document = json.loads(row.document) | {"error": order.error, "view": changed.model_dump(mode="json")}
        values = {"document": json.dumps(document), "version": changed.version}
        await self._stores.database.write(update(table).where(table.c.id == view.id).values(**values))
        self._stores.events.add(
            "operation", operation_id=view.id, state=view.state.value, error=order.error, abort=order.action
        )
