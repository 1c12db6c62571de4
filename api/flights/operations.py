"""All operations of this service: those that have not ended, and those that have, from the database."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection
from typing import Any

import structlog
from sqlalchemy import Row, func, select

from skyfolio.api.common.errors import ConflictError, InvalidError, NotFoundError, PreconditionError
from skyfolio.api.common.idempotency import NewResource
from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.aborts import Aborts
from skyfolio.api.flights.airspace import SharedAirspace
from skyfolio.api.flights.endless.long_record import SlotRates, stored_rates
from skyfolio.api.flights.endless.pool import Pool
from skyfolio.api.flights.endless.relief_terms import ReliefTerms
from skyfolio.api.flights.endless.terms import Terms
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.operation import Operation
from skyfolio.api.flights.operation_store import OperationIdentity, Stores
from skyfolio.api.flights.operation_views import ENDED, OperationView, Policy, State
from skyfolio.api.flights.operations_elsewhere import OperationsElsewhere
from skyfolio.api.flights.ownership import Ownership
from skyfolio.api.flights.restart import Record, restored, settle, stored_track
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.store.numbers import Numbers
from skyfolio.api.store.tables import operations as table
from skyfolio.mavlink_bridge import OnEnd, ReturnPathsTooClose, check_return_paths
from skyfolio.planner import Plan

log = structlog.get_logger()


class Operations:
    """Starts, finds and commands operations, and goes on with them after a restart."""

    def __init__(self, shared: SharedServices, stores: Stores, fleet: Fleet) -> None:
        self._shared, self._stores, self._fleet = shared, stores, fleet
        self._active: dict[str, Operation] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._unsaved: dict[str, Operation] = {}
        """Operations that have ended and whose end is not stored yet."""
        self._aborts = Aborts(fleet, stores, self._take_task, self._end)
        self._airspace = SharedAirspace(fleet)
        self._elsewhere = OperationsElsewhere(shared, stores, fleet, self._airspace)
        self._numbers = Numbers()
        self.ownership = Ownership(stores, self._active, self._go_on, self._drop)
        self._starting = asyncio.Lock()

    async def start_up(self) -> None:
        """Go on with the operations that the last process did not end.

        Where several services share the database, those are taken over as their leases run out.
        """
        database, shared = self._stores.database, self.ownership.shared
        last = (await database.rows(select(func.max(table.c.number))))[0][0] or 0
        self._numbers = Numbers(last, several=shared)
        if shared:
            self.ownership.begin(self._fleet.is_any_heard)
            return
        ended = [state.value for state in ENDED]
        for row in await database.rows(select(table).where(table.c.state.not_in(ended)).order_by(table.c.number)):
            await self._go_on(row)

    async def follow_others(self) -> None:
        """Know the air of the operations of other services, until cancelled."""
        await self._elsewhere.follow()

    async def start(
        self,
        plan_id: str,
        policy: Policy,
        creation: NewResource,
        *,
        launch_itself: bool = True,
        disruption_weight: float | None = None,
        options: GuidanceOptions | None = None,
        extended: Callable[[Plan], Terms] | None = None,
        relief: ReliefTerms | None = None,
    ) -> Operation | OperationView:
        """Fly a finished plan. disruption_weight: None for that of the settings.

        extended: returns how a plan is extended again and again; None flies it once. relief: the vehicles that relieve
        each other meanwhile.

        Raises NotFoundError, ConflictError, or InvalidError for unregistered UAVs.
        """
        weight = self._shared.settings.disruption_weight if disruption_weight is None else disruption_weight
        async with self._starting:
            if creation.fingerprint is not None and (earlier := await self._created_before(creation)):
                return earlier
            plan = await self._shared.plans.finished(plan_id)
            terms = None if extended is None else extended(plan)
            pool = None if relief is None else self._pool_of(relief, plan)
            uavs = plan.scenario.uav_ids if pool is None else [*pool.uavs]
            systems = {uav: self._fleet.system_of(uav) for uav in uavs}
            self._require_free(plan, uavs)
            _require_ways_home(plan, options or GuidanceOptions())
            await self._elsewhere.look()
            await self._airspace.require_clear(plan, systems, options or GuidanceOptions())
            identity = OperationIdentity(
                id=creation.id,
                number=self._numbers.next(),
                policy=policy,
                fingerprint=creation.fingerprint,
                launch_itself=launch_itself,
                disruption_weight=weight,
            )
            flight = Flight(plan, systems, self._fleet, self._shared.clock, options, terms, pool)
            operation = Operation(identity, flight, self._shared, self._stores)
            alone = await self.ownership.create(operation)
            self._run(operation, operation.run(alone))
            return operation

    def active(self, operation_id: str) -> Operation | None:
        """Return the operation if it has not ended."""
        return self._active.get(operation_id)

    async def view(self, operation_id: str) -> OperationView:
        """Return what clients see of an operation, ended or not. Raises NotFoundError."""
        operation = self._active.get(operation_id) or self._unsaved.get(operation_id)
        if operation is not None:
            await operation.flight.settle_rates()
            return operation.view()
        rows = await self._stores.database.rows(select(table).where(table.c.id == operation_id))
        if not rows:
            raise NotFoundError(f"operation {operation_id!r} does not exist")
        stored = json.loads(rows[0].document)["view"]
        if stored is None:  # it began before several services shared the database, and none has gone on with it yet
            stored = (await restored(rows[0], self._shared, self._stores, self._fleet, with_track=False)).view()
        view = OperationView.model_validate(stored)
        return view.model_copy(update={"owner": self.ownership.owner(operation_id)})

    async def commanded(self, operation_id: str, *states: State, version: int | None = None) -> Operation:
        """Return an operation that is in one of these states and in that version.

        Raises NotFoundError, and what `Operation.require` does.
        """
        operation = self._active.get(operation_id)
        if operation is None:
            self.ownership.require_ours(operation_id)
            ended = await self.view(operation_id)
            raise ConflictError(f"operation {operation_id!r} is already {ended.state.value}")
        operation.require(*states, version=version)
        return operation

    async def abort(self, operation_id: str, action: Action, version: int | None = None) -> OperationView:
        """End an operation now, in any state and as often as asked.

        The vehicles of an operation that is aborted already are given the new order. Raises NotFoundError,
        ConflictError if it has ended otherwise, PreconditionError.
        """
        operation = self._active.get(operation_id)
        if operation is not None:
            operation.require(version=version)
            await self._aborts.abort(operation, action)
            return operation.view()
        self.ownership.require_ours(operation_id)
        view = await self.view(operation_id)
        if version is not None and version != view.version:
            raise PreconditionError(f"If-Match: operation {operation_id!r} is in version {view.version}")
        await self._aborts.order_again(view, action, self.owners(), self._unsaved.get(operation_id))
        return await self.view(operation_id)

    def owners(self) -> dict[str, str]:
        """Return the operation that each UAV flies for, of those that have not ended."""
        return {uav: operation.id for operation in self._active.values() for uav in operation.flight.systems}

    def yield_to_operator(
        self,
        addressed: Collection[str],
        ordered: Collection[str],
        action: Action,
        results: asyncio.Future[dict[str, str | None]],
    ) -> list[Awaitable[None]]:
        """Leave vehicles to the operator from this moment on.

        ordered: the vehicles that are sent the order. addressed: those and the ones that the order leaves alone.
        results: how the order went. Returns what waits until the operations that this ends are closed.
        """
        return [
            self._aborts.abort_by_fleet_order(operation, action, ordered, results)
            for operation in list(self._active.values())
            if operation.yield_to_operator(addressed, ordered, action)
        ]

    async def rows(self, limit: int, before: int | None) -> list[Row[Any]]:
        """Return the rows of the newest operations (older than number `before`)."""
        columns = [column for column in table.c if column.name != "document"]
        query = select(*columns).order_by(table.c.number.desc()).limit(limit)
        return list(await self._stores.database.rows(query if before is None else query.where(table.c.number < before)))

    async def exists(self, operation_id: str) -> bool:
        """Return whether there is or was such an operation."""
        return bool(await self._stores.database.rows(select(table.c.id).where(table.c.id == operation_id)))

    async def track(self, operation_id: str, after_s: float | None, limit: int | None) -> Record:
        """Return where every UAV was heard, as `stored_track` does."""
        return await stored_track(operation_id, self._stores, after_s, limit)

    async def rates(self, operation_id: str, from_slot: int, limit: int) -> list[tuple[int, SlotRates]]:
        """Return what each user got, bit/s, in up to `limit` slots from one on; None where it is not known."""
        stored = await stored_rates(self._stores.database, operation_id, from_slot, limit)
        view = await self.view(operation_id)
        begin = max(stored[-1][0] + 1 if stored else from_slot, from_slot, view.rates_from_slot)
        end = view.rates_from_slot + max((len(row) for row in view.user_rates_bps.values()), default=0)
        held = [
            (slot, {user: row[slot - view.rates_from_slot] for user, row in view.user_rates_bps.items()})
            for slot in range(begin, min(end, begin + limit - len(stored)))
        ]
        return stored + held

    @property
    def in_the_air(self) -> list[Operation]:
        """Return the operations that have not ended."""
        return list(self._active.values())

    async def close(self) -> None:
        """Stop following the operations; the vehicles fly the missions on board, and the next start takes over."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _go_on(self, row: Row[Any]) -> Operation:
        operation = await restored(row, self._shared, self._stores, self._fleet)
        log.info("operation taken over", operation_id=operation.id, state=operation.state.value)
        self._run(operation, operation.follow(settle))
        return operation

    def _run(self, operation: Operation, work: Any) -> None:
        self._active[operation.id] = operation
        self._airspace.enter(operation.id, operation.flight)
        task = asyncio.create_task(work, name=operation.id)
        self._tasks[operation.id] = task
        task.add_done_callback(lambda done: self._task_done(operation, done))

    def _task_done(self, operation: Operation, done: asyncio.Task[None]) -> None:
        if not done.cancelled() and (error := done.exception()) is not None:
            context = {"message": "operation is no longer followed", "exception": error, "task": done}
            done.get_loop().call_exception_handler(context)
        if not done.cancelled() and operation.state in ENDED:
            self._end(operation)

    def _drop(self, operation: Operation) -> asyncio.Task[None] | None:
        """Take an operation off the active ones that another service may go on with, and return its task."""
        self._active.pop(operation.id, None)
        self._airspace.leave(operation.id)
        return self._take_task(operation)

    def _take_task(self, operation: Operation) -> asyncio.Task[None] | None:
        return self._tasks.pop(operation.id, None)

    def _end(self, operation: Operation) -> None:
        """Take an ended operation off the active ones, and remember it until its end is stored."""
        self._drop(operation)
        self.ownership.end(operation.id)
        saved = operation.saved
        if saved is not None and not saved.done():
            self._unsaved[operation.id] = operation
            saved.add_done_callback(lambda _: self._unsaved.pop(operation.id, None))

    async def _created_before(self, creation: NewResource) -> Operation | OperationView | None:
        rows = await self._stores.database.rows(select(table.c.fingerprint).where(table.c.id == creation.id))
        if not rows:
            return None
        creation.require_same(rows[0].fingerprint)
        return self._active.get(creation.id) or await self.view(creation.id)

    def _pool_of(self, relief: ReliefTerms, plan: Plan) -> Pool:
        relief.require_sound(plan)
        return Pool.of(relief, plan)

    def _require_free(self, plan: Plan, uavs: Collection[str]) -> None:
        if plan.parent is not None:
            raise InvalidError(
                "plan_id: a replan belongs to an operation in flight; start with the plan of the whole fleet"
            )
        for operation in self._active.values():
            busy = set(operation.flight.systems) & set(uavs)
            if busy:
                raise ConflictError(f"vehicles: {', '.join(sorted(busy))} already fly operation {operation.id}")


def _require_ways_home(plan: Plan, options: GuidanceOptions) -> None:
    """Raise InvalidError if UAVs that are to return, at once and at one height, would come too close."""
    if options.at_end is OnEnd.RETURN:
        try:
            check_return_paths(plan, {uav: path[0] for uav, path in plan.trajectories_m.items()})
        except ReturnPathsTooClose as error:
            raise InvalidError(f"at_end: {error}") from error
