"""Operations: a plan, flown by registered vehicles, from upload to landing."""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress
from enum import StrEnum
from typing import Literal

import structlog
from pydantic import BaseModel

from api.clock import FleetClock
from api.events import EventLog
from api.fleet import Fleet
from api.flight import Flight
from api.plan_book import PlanBook
from api.problems import ConflictError, InvalidError, NotFoundError
from api.resilience import Recovery, Responder
from api.settings import Settings
from mavlink_bridge import BridgeError, compile_mission
from planner import Plan

log = structlog.get_logger()
TICK_S = 0.1
LANDING_LIMIT_S = 240.0
LAUNCH_LIMIT_S = 120.0


class State(StrEnum):
    """Life of an operation."""

    UPLOADING = "uploading"
    LAUNCHING = "launching"
    FLYING = "flying"
    LANDING = "landing"
    COMPLETED = "completed"
    ABORTED = "aborted"
    FAILED = "failed"


ENDED = {State.COMPLETED, State.ABORTED, State.FAILED}


class OperationView(BaseModel):
    """An operation. `elapsed_s` counts fleet seconds since slot 0 began; `slot` counts from 0."""

    id: str
    state: State
    replanning: Literal["auto", "off"]
    plan_id: str
    plan_ids: list[str]
    vehicles: dict[str, int]
    lost: list[str]
    elapsed_s: float | None
    slot: int | None
    recoveries: list[Recovery]
    user_rates_bps: dict[str, list[float | None]]
    error: str | None


class Operation:
    """One flight of one plan. Raises nothing: what goes wrong is its `error`."""

    def __init__(self, flight: Flight, responder: Responder | None, events: EventLog) -> None:
        self.id = f"op-{secrets.token_hex(6)}"
        self.state = State.UPLOADING
        self.error: str | None = None
        self.recoveries: list[Recovery] = []
        self._flight, self._responder, self._events = flight, responder, events

    def view(self) -> OperationView:
        """What the client sees."""
        flight = self._flight
        return OperationView(
            id=self.id,
            state=self.state,
            replanning="auto" if self._responder else "off",
            plan_id=flight.plan.id,
            plan_ids=[entry.plan.id for entry in flight.timeline],
            vehicles=flight.systems,
            lost=sorted(flight.lost),
            elapsed_s=flight.elapsed_s(),
            slot=flight.slot(),
            recoveries=self.recoveries,
            user_rates_bps=flight.reported_rates_bps(),
            error=self.error,
        )

    async def run(self) -> None:
        """Upload, launch, fly, recover from losses, land."""
        try:
            await self._upload()
            self._enter(State.LAUNCHING)
            await self._flight.launch(LAUNCH_LIMIT_S)
            await self._flight.start()
            self._enter(State.FLYING)
            await self._fly()
            self._enter(State.COMPLETED)
        except BridgeError as error:
            await self._fail(str(error))
        except asyncio.CancelledError:
            raise
        except Exception as error:
            await self._fail(f"{type(error).__name__}: {error}")
            raise

    async def abort(self, action: Literal["hold", "land"]) -> None:
        """Tell every vehicle that still answers to hold or to land where it is."""
        self._enter(State.ABORTED)
        await self._flight.stop_where_it_is(action)

    async def _upload(self) -> None:
        missions = {uav: compile_mission(self._flight.plan, uav) for uav in self._flight.systems}
        seconds = await self._flight.upload(missions)
        self._events.add("missions_uploaded", operation_id=self.id, upload_s=round(seconds, 3), uavs=len(missions))

    async def _fly(self) -> None:
        flight = self._flight
        news = flight.follow_losses()
        try:
            while not flight.over(LANDING_LIMIT_S):
                flight.sample()
                if self.state == State.FLYING and flight.past_last_slot():
                    self._enter(State.LANDING)
                lost = flight.newly_lost(news)
                if lost:
                    await self._respond(lost)
                await asyncio.sleep(TICK_S)
        finally:
            flight.unfollow_losses(news)
        if not flight.surviving():
            raise BridgeError(f"lost: every vehicle is lost ({', '.join(sorted(flight.lost))})")
        if not flight.all_down():
            raise BridgeError(f"landing: {', '.join(flight.still_up())} not down {LANDING_LIMIT_S:g} s after the plan")

    async def _respond(self, lost: dict[str, float]) -> None:
        for uav, silent_for_s in lost.items():
            self._events.add("uav_lost", operation_id=self.id, uav_id=uav, silent_for_s=round(silent_for_s, 3))
        if self._responder is None or self._flight.past_last_slot() or not self._flight.surviving():
            return
        task = asyncio.create_task(self._responder.recover(self._flight, lost))
        while not task.done():  # the survivors fly on meanwhile, and are recorded
            self._flight.sample()
            await asyncio.wait({task}, timeout=TICK_S)
        recovery = task.result()
        self.recoveries.append(recovery)
        self._events.add("recovery", operation_id=self.id, **recovery.model_dump(mode="json"))

    async def _fail(self, reason: str) -> None:
        log.error("operation failed", operation_id=self.id, reason=reason)
        self.error = reason
        self._enter(State.FAILED)
        with suppress(BridgeError):
            await self._flight.stop_where_it_is("hold")

    def _enter(self, state: State) -> None:
        self.state = state
        self._events.add("operation", operation_id=self.id, state=state.value, error=self.error)


class Operations:
    """All operations of this service."""

    def __init__(self, settings: Settings, clock: FleetClock, events: EventLog, plans: PlanBook, fleet: Fleet) -> None:
        self._settings, self._clock, self._events = settings, clock, events
        self._plans, self._fleet = plans, fleet
        self._operations: dict[str, Operation] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def start(self, plan_id: str, replanning: Literal["auto", "off"]) -> Operation:
        """Fly a finished plan. Raises NotFoundError, ConflictError, or InvalidError for unregistered UAVs."""
        plan = self._plans.finished(plan_id)
        systems = {uav: self._fleet.system_of(uav) for uav in plan.scenario.uav_ids}
        self._require_free(plan)
        flight = Flight(plan, systems, self._fleet, self._clock)
        responder = Responder(self._settings, self._plans, self._clock) if replanning == "auto" else None
        operation = Operation(flight, responder, self._events)
        self._operations[operation.id] = operation
        self._tasks[operation.id] = asyncio.create_task(operation.run())
        return operation

    def get(self, operation_id: str) -> Operation:
        """The operation. Raises NotFoundError."""
        try:
            return self._operations[operation_id]
        except KeyError:
            raise NotFoundError(f"operation {operation_id!r} does not exist") from None

    async def abort(self, operation_id: str, action: Literal["hold", "land"]) -> Operation:
        """End an operation now: hold or land. Raises NotFoundError, or ConflictError when it has ended."""
        operation = self.get(operation_id)
        if operation.state in ENDED:
            raise ConflictError(f"operation {operation_id!r} is already {operation.state.value}")
        task = self._tasks[operation_id]
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await operation.abort(action)
        return operation

    async def close(self) -> None:
        """Stop following; the vehicles fly on with what they have on board."""
        for task in self._tasks.values():
            task.cancel()
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    def _require_free(self, plan: Plan) -> None:
        if plan.parent is not None:
            raise InvalidError("plan_id: a replan belongs to an operation in flight; start the plan of the whole fleet")
        for operation in self._operations.values():
            if operation.state not in ENDED:
                busy = set(operation.view().vehicles) & set(plan.scenario.uav_ids)
                if busy:
                    raise ConflictError(f"vehicles: {', '.join(sorted(busy))} fly operation {operation.id}")
