"""The state of one operation: what is stored of it, what clients see of it, and when a command may change it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from skyfolio.api.common.errors import ConflictError, PreconditionError
from skyfolio.api.flights.assigned_missions import AssignedMissionStore
from skyfolio.api.flights.endless.dispatcher import Dispatcher
from skyfolio.api.flights.endless.long_record import LongRecord
from skyfolio.api.flights.endless.pool import Pool
from skyfolio.api.flights.ends import ends_of
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.incidents import Incidents
from skyfolio.api.flights.journal import Journal
from skyfolio.api.flights.operation_store import OperationIdentity, OperationRows, Stores
from skyfolio.api.flights.operation_views import ENDED, Abort, OperationView, Proposal, State, uav_views
from skyfolio.api.flights.radio import Radio
from skyfolio.api.flights.shared_services import SharedServices
from skyfolio.api.store.writer import Statement


class OperationRecord:
    """An operation without what it does: its state, its error, and its incidents, each stored when it changes."""

    def __init__(self, identity: OperationIdentity, flight: Flight, shared: SharedServices, stores: Stores) -> None:
        self.identity, self.flight, self.shared = identity, flight, shared
        self._stores = stores
        self._rows = OperationRows(stores.database, identity)
        self.long_record = LongRecord(stores.database, identity.id, flight)
        self.state = State.UPLOADING
        self.version = 0
        self.error: str | None = None
        """What went wrong."""
        self.aborted_by: Abort | None = None
        """The last order by which it was ended."""
        self._stopped = False
        self.incidents = Incidents(identity, flight, shared, stores.journal, stores.events)
        self.incidents.save = self.save
        self.radio = Radio(
            identity,
            flight,
            shared,
            stores,
            save=self.save_soon,
            may_replan=self._may_replan,
            request_replan=lambda why: self.incidents.request_recovery("rates_off", detail=why),
        )
        self.dispatcher = None if flight.pool is None else self._dispatcher(flight.pool)
        flight.guidance.mission_store = AssignedMissionStore(stores.database, identity.id)

    def _dispatcher(self, pool: Pool) -> Dispatcher:
        flight, shared = self.flight, self.shared
        return Dispatcher(
            flight,
            pool,
            self.incidents,
            fleet=flight.fleet,
            clock=shared.clock,
            tell=lambda kind, **data: self._stores.events.add(kind, operation_id=self.id, **data),
            save=self.save_soon,
        )

    @property
    def id(self) -> str:
        """Return the id."""
        return self.identity.id

    @property
    def saved(self) -> asyncio.Future[None] | None:
        """Return a future that is done when the newest state is durable; None before the first save."""
        return self._rows.saved

    @property
    def journal(self) -> Journal:
        """Return the journal in which its incidents are written."""
        return self._stores.journal

    def view(self) -> OperationView:
        """Return what clients see."""
        flight, incidents, has_ended = self.flight, self.incidents, self.state in ENDED
        leases = self._stores.database.leases
        proposal = incidents.proposal
        return OperationView(
            id=self.id,
            version=self.version,
            state=self.state,
            owner=None if has_ended or leases is None else leases.name,
            replanning=self.identity.policy,
            disruption_weight=self.identity.disruption_weight,
            plan_id=flight.plan.id,
            plan_ids=[entry.plan.id for entry in flight.timeline],
            vehicles=flight.systems,
            uavs=uav_views(flight, over=has_ended),
            lost=sorted(flight.lost),
            returned=sorted(flight.returned),
            low_on_battery=[] if has_ended else sorted(flight.roster.low_on_battery),
            elapsed_s=flight.elapsed_s(),
            slot=flight.slot(),
            recoveries=incidents.reports,
            proposal=Proposal(incident=proposal[0], plan_id=proposal[1].id, lost=proposal[2]) if proposal else None,
            user_rates_bps={user: list(row) for user, row in flight.reported_rates_bps().items()},
            rates_from_slot=flight.rates_from_slot,
            measured_slots=flight.measured.slots,
            endless=None if flight.horizon is None else flight.horizon.view(),
            relief=None if self.dispatcher is None else self.dispatcher.view(),
            error=self.error,
            abort=self.aborted_by,
        )

    def require(self, *states: State, version: int | None) -> None:
        """Raise PreconditionError unless the version is this one, ConflictError unless the state is one of these.

        So the second of two commands with one ETag is refused. version: None accepts any; no states: any.
        """
        if version is not None and version != self.version:
            raise PreconditionError(f"If-Match: operation {self.id!r} is in version {self.version}")
        if states and self.state not in states:
            raise ConflictError(f"operation {self.id!r} is {self.state.value}")

    async def enter(self, state: State) -> None:
        """Change the state, and return when it is stored. Raises ConflictError if the operation was stopped."""
        if self._stopped and state not in {State.ABORTING, State.ABORTED}:
            raise ConflictError(f"operation {self.id!r} is {self.state.value}")
        if state in ENDED:
            await self.incidents.close(self.error or f"the operation is {state.value}")
            await self.flight.settle_rates()
        self.state = state
        await self.save()
        ends = {uav: end.value for uav, end in ends_of(self.flight).items()} if state in ENDED else {}
        self._stores.events.add("operation", operation_id=self.id, state=state.value, error=self.error, ends=ends)

    async def create(self, claim: Sequence[Statement] = ()) -> None:
        """Store a new operation, and with it its claim to its vehicles. Raises StoreError."""
        await self._rows.create(self.flight.first_plan.id, self.state, self._document(), claim)
        self._stores.events.add("operation", operation_id=self.id, state=self.state.value, error=None)

    async def save(self) -> None:
        """Store everything that a restart needs."""
        self.version += 1
        await self._rows.save(self.state, self.version, self._document())

    def save_soon(self) -> None:
        """Begin to store everything that a restart needs, where nothing that can be commanded has changed."""
        self._rows.save_soon(self.state, self.version, self._document())

    def _may_replan(self) -> bool:
        """Return whether a new plan may be requested without an incident: nothing else is done, and there is time."""
        slot = self.flight.slot()
        in_time = slot is not None and slot < self.flight.n_slots - 2
        return self.state == State.FLYING and in_time and not self.incidents.has_work

    def mark_track_stored(self) -> None:
        """Note that the track recorded so far is stored already."""
        self._rows.has_track_of(self.flight.record)

    def _document(self) -> dict[str, Any]:
        """Return what `restart.restored` reads; names and values are those of documents that are stored already."""
        flight, elapsed_s = self.flight, self.flight.elapsed_s()
        return {
            "vehicles": flight.systems,
            "timeline": [{"from_s": entry.from_s, "plan_id": entry.plan.id} for entry in flight.timeline],
            "slot0_at": self._slot0_at(elapsed_s),
            "paused_s": elapsed_s if flight.paused else None,
            "lost": flight.lost,
            "losses": {uav: asdict(loss) for uav, loss in flight.roster.losses.items()},
            "returned": sorted(flight.returned),
            "retired": sorted(flight.roster.retired),
            "at_end": flight.guidance.options.at_end.value,
            "streams": flight.guidance.is_streaming,
            "ghosts": flight.guidance.airspace.document(),
            "endless": None if flight.horizon is None else flight.horizon.document(),
            "pool": None if flight.pool is None else flight.pool.document(),
            "launch_itself": self.identity.launch_itself,
            "disruption_weight": self.identity.disruption_weight,
            "error": self.error,
            **self.incidents.document(),
            **self.radio.document(),
            "view": self._stored_view(),
        }

    def _stored_view(self) -> dict[str, Any] | None:
        """Return what clients see once it has ended, and what clients of other services see of it before."""
        if self.state in ENDED:
            return self.view().model_dump(mode="json")
        if self._stores.database.leases is None:
            return None
        return self.view().model_copy(update={"user_rates_bps": {}}).model_dump(mode="json")

    def _slot0_at(self, elapsed_s: float | None) -> float | None:
        """Return the UTC second in which slot 0 began; now, while it begins; None before."""
        if elapsed_s is None and self.state != State.STARTING:
            return None
        return self.shared.clock.utc_of(elapsed_s or 0.0)
