"""One operation: a plan, flown by registered vehicles, from upload to landing."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from dataclasses import asdict
from typing import Any

import structlog

from skyfolio.api.common.errors import ConflictError, PreconditionError
from skyfolio.api.fleet.commander import Action
from skyfolio.api.flights.assigned_missions import MissionBook
from skyfolio.api.flights.ends import ends_of, shortfall
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.incidents import Incidents
from skyfolio.api.flights.journal import Journal
from skyfolio.api.flights.operation_store import OperationIdentity, OperationRows, Stores
from skyfolio.api.flights.operation_views import (
    ENDED,
    IN_THE_AIR,
    Abort,
    OperationView,
    Proposal,
    State,
    is_off_plan,
    slip_m,
    uav_views,
)
from skyfolio.api.flights.recovery import Parts
from skyfolio.api.flights.stragglers import Stragglers
from skyfolio.mavlink_bridge import BridgeError

log = structlog.get_logger()
TICK_S = 0.1
LANDING_LIMIT_S = 240.0
LAUNCH_LIMIT_S = 120.0


class Operation:
    """One flight of one plan. What goes wrong is its `error`. Its state is stored before commands go."""

    def __init__(self, head: OperationIdentity, flight: Flight, parts: Parts, books: Stores) -> None:
        self.head, self.flight, self.parts = head, flight, parts
        self._books = books
        self._rows = OperationRows(books.database, head)
        self.state = State.UPLOADING
        self.version = 0
        self.error: str | None = None
        self.aborted_by: Abort | None = None
        self._stopped = False
        self.incidents = Incidents(head.id, head.policy, flight, parts, books.journal, books.events)
        self.incidents.save = self.save
        flight.guidance.book = MissionBook(books.database, head.id)
        self._stragglers = Stragglers()
        self.go = asyncio.Event()
        self._busy = asyncio.Lock()
        if head.launch_itself:
            self.go.set()

    @property
    def id(self) -> str:
        """The id."""
        return self.head.id

    @property
    def saved(self) -> asyncio.Future[None] | None:
        """When its newest state is durable; None before the first save."""
        return self._rows.saved

    @property
    def journal(self) -> Journal:
        """Where its incidents are written."""
        return self._books.journal

    def view(self) -> OperationView:
        """What the client sees."""
        flight, incidents = self.flight, self.incidents
        proposal = incidents.proposal
        return OperationView(
            id=self.id,
            version=self.version,
            state=self.state,
            replanning=self.head.policy,
            plan_id=flight.plan.id,
            plan_ids=[entry.plan.id for entry in flight.timeline],
            vehicles=flight.systems,
            uavs=uav_views(flight, over=self.state in ENDED),
            lost=sorted(flight.lost),
            returned=sorted(flight.returned),
            low_on_battery=[] if self.state in ENDED else sorted(flight.roster.low_on_battery),
            elapsed_s=flight.elapsed_s(),
            slot=flight.slot(),
            recoveries=incidents.reports,
            proposal=Proposal(incident=proposal[0], plan_id=proposal[1].id, lost=proposal[2]) if proposal else None,
            user_rates_bps={user: list(row) for user, row in flight.reported_rates_bps().items()},
            error=self.error,
            abort=self.aborted_by,
        )

    # -- from the ground to the ground ----------------------------------------------------------------------------

    async def run(self) -> None:
        """Upload, launch, fly, recover from losses, land."""
        await self._guarded(self._from_the_ground)

    async def follow(self, settle: Callable[[Operation], Awaitable[None]]) -> None:
        """Go on with an operation that a stopped service left in the air; `settle` finds out what is in doubt."""

        async def on() -> None:
            await self.flight.reattach()
            await settle(self)
            if self.state in IN_THE_AIR:
                self.flight.guidance.resume(self.flight.still_up())
                with self.flight.roster.following() as news:
                    await self._fly(news)

        await self._guarded(on)

    async def _guarded(self, work: Callable[[], Awaitable[None]]) -> None:
        with structlog.contextvars.bound_contextvars(operation_id=self.id):
            try:
                with self.flight.recorded(self.id):
                    await work()
            except BridgeError as error:
                await self._fail(str(error))
            except Exception as error:
                log.exception("operation broke")
                await self._fail(f"{type(error).__name__}: {error}")

    async def _from_the_ground(self) -> None:
        take_off = self.flight.take_off
        seconds = await take_off.watched(take_off.upload())
        self._books.events.add(
            "missions_uploaded", operation_id=self.id, upload_s=round(seconds, 3), uavs=len(self.flight.systems)
        )
        if not self.go.is_set():
            await self.enter(State.READY)
            await take_off.watched(self.go.wait())
        await self.enter(State.LAUNCHING)
        await take_off.watched(take_off.launch(LAUNCH_LIMIT_S))
        await self.enter(State.STARTING)
        with self.flight.roster.following() as news:
            self.flight.begin(await take_off.watched(take_off.start()))
            await self.enter(State.FLYING)
            await self._fly(news)

    async def _fly(self, news: asyncio.Queue[Any]) -> None:
        flight = self.flight
        try:
            while not flight.over(LANDING_LIMIT_S):
                await self._tick(news)
                await asyncio.sleep(TICK_S)
        finally:
            await flight.guidance.end()
            await self.incidents.end()
            self._rows.write_track(flight.record)
        up = ", ".join(flight.still_up())
        if up and flight.roster.own_link.is_lost:
            raise BridgeError(f"link_lost: nobody was heard until {up} must have landed")
        if up:
            raise BridgeError(f"landing: {up} not down {LANDING_LIMIT_S:g} s after the plan")
        if not any(end.is_down for end in ends_of(flight).values()):
            raise BridgeError(f"lost: every vehicle is lost ({', '.join(sorted(flight.lost))})")
        self.error = shortfall(flight)
        await self.enter(State.COMPLETED if self.error is None else State.COMPLETED_PARTLY)

    async def _tick(self, news: asyncio.Queue[Any]) -> None:
        flight = self.flight
        if not flight.paused and self.state != State.LINK_LOST:
            flight.sample()
        if self._rows.track_is_due:
            self._rows.write_track(flight.record)
            self._measure()
        if self.state == State.FLYING and flight.past_last_slot():
            await self.enter(State.LANDING)
        async with self._busy:  # a command of the operator comes before or after, never between
            lost = flight.roster.newly_lost(news)
            await self._see_to_link()
            await self.incidents.note(lost)
            await self.incidents.go_on(may_start=self.state == State.FLYING)
            if self.state == State.LANDING and not self.incidents.has_work:
                await self._stragglers.look(flight)

    async def _see_to_link(self) -> None:
        """Hold judgement while nobody is heard; when somebody is, go on where the flight then is."""
        is_lost = self.flight.roster.own_link.is_lost
        if is_lost == (self.state == State.LINK_LOST) or self.state not in IN_THE_AIR:
            return
        if is_lost:
            await self.incidents.link_lost()
            await self.enter(State.LINK_LOST)
            return
        landing = State.LANDING if self.flight.past_last_slot() else State.FLYING
        await self.enter(State.PAUSED if self.flight.paused else landing)
        self.take_up()

    def take_up(self) -> None:
        """We were away: ask for a new plan if vehicles hover or are too far off to catch up within a slot."""
        flight, positions = self.flight, self.flight.positions_m()
        off = [uav for uav in flight.still_up() if flight.hovers(uav) or is_off_plan(flight, uav, positions.get(uav))]
        if off and self.state == State.FLYING and not self.incidents.has_work:
            log.info("vehicles do not fly the plan", uavs=off)
            self.incidents.want("retuned")

    # -- what an operator says ------------------------------------------------------------------------------------

    def require(self, *states: State, version: int | None) -> None:
        """Compare before setting: of two commands with one ETag the second finds another version.

        Raises PreconditionError when the version is another one, ConflictError when the state is none of these.
        """
        if version is not None and version != self.version:
            raise PreconditionError(f"If-Match: operation {self.id!r} is in version {self.version}")
        if states and self.state not in states:
            raise ConflictError(f"operation {self.id!r} is {self.state.value}")

    async def launch(self, version: int | None = None) -> None:
        """Take off. Raises what `require` does, ConflictError also when it was told to before."""
        async with self._busy:
            self.require(State.READY, version=version)
            if self.go.is_set():
                raise ConflictError(f"operation {self.id!r} was told to start before")
            self.go.set()
            await self.save()

    async def pause(self, version: int | None = None) -> None:
        """Every vehicle hovers and the slot clock stands still. Raises FlightError, and what `require` does."""
        async with self._busy:
            self.require(State.FLYING, version=version)
            await self.incidents.supersede("a pause")
            self.flight.go_on_from(self.flight.now_s(), paused=True)
            await self.enter(State.PAUSED)
            await self.flight.pause()

    async def resume(self, version: int | None = None) -> None:
        """Fly on with the missions on board. Raises FlightError, and what `require` does."""
        async with self._busy:
            self.require(State.PAUSED, version=version)
            self.flight.go_on_from(self.flight.now_s())
            await self.enter(State.FLYING)
            await self.flight.resume()

    async def readmit(self, uav_id: str, version: int | None = None) -> None:
        """Plan for a UAV again that was lost and is back. Raises ConflictError, and what `require` does."""
        async with self._busy:
            self.require(State.FLYING, version=version)
            await self.incidents.readmit(uav_id)

    async def retire(self, uav_id: str, version: int | None = None) -> None:
        """Send a UAV home and plan without it. Raises ConflictError, and what `require` does."""
        async with self._busy:
            self.require(State.FLYING, version=version)
            await self.incidents.retire(uav_id)

    def stop(self) -> list[str]:
        """End it now, before anything is waited for: whoever waits for a turn finds it aborting, and gets none.

        Returns the UAVs that may be given a last order.
        """
        self._stopped, self.state = True, State.ABORTING
        return self.flight.stop()

    async def has_aborted(self, by: Abort, why: str | None = None) -> None:
        """The last order was given: close the books. `why`: what led to it, when that was not an abort."""
        if self.state not in ENDED:
            await self.enter(State.ABORTING)
        self.aborted_by = by
        self.error = "; ".join(said for said in (why, by.error) if said) or None
        await self.enter(State.ABORTED)

    def give_way(self, addressed: Collection[str], told: Collection[str], action: Action) -> bool:
        """The operator gives orders to vehicles, apart from operations: leave them alone from this moment.

        told: those that are sent the order; addressed: those, and who is left alone. Returns whether that ends the
        operation: it has none left, or slot 0 has not begun.
        """
        flight = self.flight
        if self.state in IN_THE_AIR and flight.elapsed_s() is not None:
            mine = [uav for uav in flight.still_up() if uav in told]
            if not mine:
                return False
            if set(mine) == set(flight.still_up()):
                return True
            for uav in mine:
                flight.roster.leave_to_operator(uav, action)
            return False
        return not self._stopped and not flight.systems.keys().isdisjoint(addressed)

    # -- the books ------------------------------------------------------------------------------------------------

    async def enter(self, state: State) -> None:
        """Change the state; stored when it returns."""
        if self._stopped and state not in {State.ABORTING, State.ABORTED}:
            raise ConflictError(f"operation {self.id!r} is {self.state.value}")
        if state in ENDED:
            await self.incidents.close(self.error or f"the operation is {state.value}")
            await self.flight.settle_rates()
        self.state = state
        await self.save()
        ends = {uav: end.value for uav, end in ends_of(self.flight).items()} if state in ENDED else {}
        self._books.events.add("operation", operation_id=self.id, state=state.value, error=self.error, ends=ends)

    async def create(self) -> None:
        """Store a new operation. Raises StoreError."""
        await self._rows.create(self.flight.first_plan.id, self.state, self._document())
        self._books.events.add("operation", operation_id=self.id, state=self.state.value, error=None)

    async def save(self) -> None:
        """Store everything that a restart needs."""
        self.version += 1
        await self._rows.save(self.state, self.version, self._document())

    def _document(self) -> dict[str, Any]:
        flight, elapsed = self.flight, self.flight.elapsed_s()
        return {
            "vehicles": flight.systems,
            "timeline": [{"from_s": entry.from_s, "plan_id": entry.plan.id} for entry in flight.timeline],
            "slot0_at": self._slot0_at(elapsed),
            "paused_s": elapsed if flight.paused else None,
            "lost": flight.lost,
            "losses": {uav: asdict(loss) for uav, loss in flight.roster.losses.items()},
            "returned": sorted(flight.returned),
            "retired": sorted(flight.roster.retired),
            "at_end": flight.guidance.way.at_end.value,
            "ghosts": flight.guidance.airspace.document(),
            "launch_itself": self.head.launch_itself,
            "error": self.error,
            **self.incidents.document(),
            "view": self.view().model_dump(mode="json") if self.state in ENDED else None,
        }

    def _slot0_at(self, elapsed_s: float | None) -> float | None:
        """UTC second when slot 0 began; as it begins, now."""
        if elapsed_s is None:
            return time.time() if self.state == State.STARTING else None
        return time.time() - elapsed_s / self.parts.clock.scale

    def recalled(self) -> None:
        """The record of the flight is stored up to here."""
        self._rows.has_track_of(self.flight.record)

    def _measure(self) -> None:
        positions = self.flight.positions_m()
        for uav in self.flight.surviving():
            far = slip_m(self.flight, uav, positions.get(uav))
            if far is not None:
                self.parts.metrics.slip.labels(uav).set(far)

    async def _fail(self, reason: str) -> None:
        """Tell why at once, see to the vehicles, and only then be over: others may have them from then on."""
        log.error("operation failed", reason=reason)
        self.error = reason
        await self.enter(self.state)
        with suppress(BridgeError):
            await self.flight.guidance.end()
            if self.flight.elapsed_s() is None:
                await self.flight.take_off.stand_down()
            else:
                await self.flight.hover()
        await self.enter(State.FAILED)
