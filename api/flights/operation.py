"""One operation: a plan, flown by registered vehicles, from upload to landing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from typing import Any

import structlog

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.fleet.commander import Action
from skyfolio.api.flights.endless.keeper import HorizonKeeper
from skyfolio.api.flights.endless.terms import End
from skyfolio.api.flights.ends import ends_of, shortfall
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.operation_record import OperationRecord
from skyfolio.api.flights.operation_store import OperationIdentity, Stores
from skyfolio.api.flights.operation_views import ENDED, IN_THE_AIR, Abort, State, is_off_plan, slip_m
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.flights.stragglers import Stragglers
from skyfolio.mavlink_bridge import BridgeError

log = structlog.get_logger()
TICK_S = 0.1
LANDING_LIMIT_S = 240.0
LAUNCH_LIMIT_S = 120.0


class Operation(OperationRecord):
    """One flight of one plan.

    What went wrong is in `error`. A new state is stored before the commands that it stands for are sent.
    """

    def __init__(self, identity: OperationIdentity, flight: Flight, shared: SharedServices, stores: Stores) -> None:
        super().__init__(identity, flight, shared, stores)
        self._stragglers = Stragglers()
        self._horizon_keeper = HorizonKeeper(flight, self.incidents)
        self._launch_ordered = asyncio.Event()
        self._commands = asyncio.Lock()
        if identity.launch_itself:
            self._launch_ordered.set()

    # -- from the ground to the ground ----------------------------------------------------------------------------

    async def run(self, alone: Callable[[], Awaitable[None]] | None = None) -> None:
        """Upload, launch, fly, recover from losses, and land.

        alone: waits until no other service sends anything to the vehicles, where several command one fleet.
        """

        async def begin() -> None:
            if alone is not None:
                await alone()
            await self._from_the_ground()

        await self._guarded(begin)

    async def follow(self, settle: Callable[[Operation], Awaitable[None]]) -> None:
        """Go on with an operation that a stopped service left in the air.

        settle: finds out which commands took effect, and how to go on.
        """

        async def resume() -> None:
            await self.flight.wait_until_heard()
            await settle(self)
            if self.state in IN_THE_AIR:
                self.flight.guidance.resume(self.flight.still_up())
                with self.flight.roster.following() as news:
                    await self._fly(news)

        await self._guarded(resume)

    async def _guarded(self, work: Callable[[], Awaitable[None]]) -> None:
        with structlog.contextvars.bound_contextvars(operation_id=self.id):
            try:
                with self.flight.recorded(self.id):
                    await work()
            except BridgeError as error:
                await self._fail(str(error))
            except Exception as error:
                log.exception("operation failed unexpectedly")
                await self._fail(f"{type(error).__name__}: {error}")

    async def _from_the_ground(self) -> None:
        take_off = self.flight.take_off
        seconds = await take_off.watched(take_off.upload())
        self._stores.events.add(
            "missions_uploaded", operation_id=self.id, upload_s=round(seconds, 3), uavs=len(self.flight.systems)
        )
        if not self._launch_ordered.is_set():
            await self.enter(State.READY)
            await take_off.watched(self._launch_ordered.wait())
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
            if self.dispatcher is not None:
                await self.dispatcher.end()
            await flight.guidance.end()
            await self.incidents.end()
            await self.radio.end()
            self._rows.write_track(flight.record)
            self.long_record.end()
        up = ", ".join(flight.still_up())
        if up and flight.roster.own_link.is_lost:
            raise BridgeError(f"link_lost: no vehicle was heard until {up} must have landed")
        if up:
            raise BridgeError(f"landing: {up} not on the ground {LANDING_LIMIT_S:g} s after the plan")
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
            self._measure_slips()
            self.long_record.move()
        if self.state == State.FLYING and flight.past_last_slot():
            await self.enter(State.LANDING)
        async with self._commands:  # commands of the operator come before or after a tick, never within one
            lost = flight.roster.newly_lost(news)
            await self._follow_link()
            if flight.roster.has_news:
                flight.roster.has_news = False
                await self.save()
            await self.incidents.take_in(lost)
            self.radio.tick(lost)
            if self.dispatcher is not None:
                await self.dispatcher.tick(may_order=self.state == State.FLYING)
            if self.state == State.FLYING:
                self._horizon_keeper.look()
            await self.incidents.advance(may_start=self.state == State.FLYING)
            if self.state == State.LANDING and not self.incidents.has_work:
                await self._stragglers.look(flight)

    async def _follow_link(self) -> None:
        """Hold all judgement while no vehicle is heard; when one is, go on from where the flight then is."""
        is_lost = self.flight.roster.own_link.is_lost
        if is_lost == (self.state == State.LINK_LOST) or self.state not in IN_THE_AIR:
            return
        if is_lost:
            await self.incidents.link_lost()
            await self.enter(State.LINK_LOST)
            return
        landing = State.LANDING if self.flight.past_last_slot() else State.FLYING
        await self.enter(State.PAUSED if self.flight.paused else landing)
        self.replan_if_off_plan()

    def replan_if_off_plan(self) -> None:
        """Request a new plan if vehicles hover, or are too far off the plan to catch up within a slot."""
        flight, at_m = self.flight, self.flight.positions_m()
        flying = [uav for uav in flight.still_up() if uav in flight.plan.trajectories_m]
        off = [uav for uav in flying if flight.hovers(uav) or is_off_plan(flight, uav, at_m.get(uav))]
        if off and self.state == State.FLYING and not self.incidents.has_work:
            log.info("vehicles do not fly the plan", uavs=off)
            self.incidents.request_recovery("retuned")

    # -- commands of the operator ---------------------------------------------------------------------------------

    async def launch(self, version: int | None = None) -> None:
        """Take off. Raises what `require` does, and ConflictError if it was started before."""
        async with self._commands:
            self.require(State.READY, version=version)
            if self._launch_ordered.is_set():
                raise ConflictError(f"operation {self.id!r} was started before")
            self._launch_ordered.set()
            await self.save()

    async def pause(self, version: int | None = None) -> None:
        """Let every vehicle hover, and stop the slot clock. Raises FlightError, and what `require` does."""
        async with self._commands:
            self.require(State.FLYING, version=version)
            await self.incidents.supersede("a pause")
            self.flight.set_slot_clock(self.flight.now_s(), paused=True)
            await self.enter(State.PAUSED)
            await self.flight.pause()

    async def resume(self, version: int | None = None) -> None:
        """Fly on with the missions on board. Raises FlightError, and what `require` does."""
        async with self._commands:
            self.require(State.PAUSED, version=version)
            self.flight.set_slot_clock(self.flight.now_s())
            await self.enter(State.FLYING)
            await self.flight.resume()

    async def readmit(self, uav_id: str, version: int | None = None) -> None:
        """Plan again with a UAV that was lost and is back. Raises ConflictError, and what `require` does."""
        async with self._commands:
            self.require(State.FLYING, version=version)
            await self.incidents.readmit(uav_id)

    async def retire(self, uav_id: str, version: int | None = None) -> None:
        """Send a UAV home and plan without it. Raises ConflictError, and what `require` does."""
        async with self._commands:
            self.require(State.FLYING, version=version)
            await self.incidents.retire(uav_id)

    async def extend(self, end: End, version: int | None = None) -> None:
        """Move the end of an operation without a fixed end. Raises ConflictError for any other, and as `require`."""
        async with self._commands:
            self.require(State.READY, State.FLYING, State.PAUSED, version=version)
            if self.flight.horizon is None:
                raise ConflictError(f"operation {self.id!r} flies one plan to its end; it was not started without one")
            self.flight.horizon.move_end(end)
            await self.save()

    def stop(self) -> list[str]:
        """End the operation at once: no command that still waits for its turn is carried out.

        Returns the UAVs that may be sent a last order.
        """
        self._stopped, self.state = True, State.ABORTING
        return self.flight.stop()

    async def close_aborted(self, by: Abort, why: str | None = None) -> None:
        """Close the operation after its last order.

        why: what led to the order, if that was not an abort.
        """
        if self.state not in ENDED:
            await self.enter(State.ABORTING)
        self.aborted_by = by
        self.error = "; ".join(reason for reason in (why, by.error) if reason) or None
        await self.enter(State.ABORTED)

    def yield_to_operator(self, addressed: Collection[str], ordered: Collection[str], action: Action) -> bool:
        """Leave vehicles alone that the operator orders; return whether that ends the operation.

        ordered: the vehicles that are sent the order. addressed: those and the ones that the order leaves alone. The
        operation ends if it has no other vehicle in the air, or if slot 0 has not begun.
        """
        flight = self.flight
        if self.state in IN_THE_AIR and flight.elapsed_s() is not None:
            leaving = [uav for uav in flight.still_up() if uav in ordered]
            if not leaving:
                return False
            if set(leaving) == set(flight.still_up()):
                return True
            for uav in leaving:
                flight.roster.leave_to_operator(uav, action)
            return False
        return not self._stopped and not flight.systems.keys().isdisjoint(addressed)

    def _measure_slips(self) -> None:
        at_m = self.flight.positions_m()
        for uav in self.flight.surviving():
            slip = slip_m(self.flight, uav, at_m.get(uav))
            if slip is not None:
                self.shared.metrics.slip.labels(uav).set(slip)

    async def _fail(self, reason: str) -> None:
        """Report the reason at once, see to the vehicles, and only then end: from then on others may have them."""
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
