"""Contingencies: plans made ahead of a loss, for each UAV that could be lost at a slot.

They are made in a lane of their own, stored, and used twice: for the N-1 table, and in flight, where the recovery from
a loss whose plan is ready needs no solve. They are made as a recovery makes its plan: the pins of the plan are kept as
far as they hold, and changes must be worth the `disruption_weight` of the operation.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import structlog
from pydantic import BaseModel
from sqlalchemy import select
from sqlalchemy.dialects import postgresql, sqlite

from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.plans.jobs import Job
from skyfolio.api.plans.solver import LaneName, SolveError, Solver
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.tables import contingencies as table
from skyfolio.planner import Disruption, DroppedPin, Plan, ReplanError, delivered_rates_bps, remaining

log = structlog.get_logger()
DEADLINE_S = 5.0
KEEP_IN_MEMORY = 512


class Key(NamedTuple):
    """What tells contingencies apart: the loss, and what a change must be worth, in kbit/s."""

    plan_id: str
    at_slot: int
    uav_id: str
    disruption_weight: float


class Contingency(BaseModel):
    """What users would get if this UAV were lost. Rates in bit/s over the slots from `at_slot` on.

    `mean_sum_rate_without_replan_bps`: the survivors fly on as if nothing had happened. `disruption`: what the plan
    changes; `dropped_pins`: what it could not keep. `error`: why there is no plan.
    """

    uav_id: str
    mean_sum_rate_bps: float | None = None
    mean_sum_rate_without_replan_bps: float
    user_mean_rates_bps: dict[str, float] = {}
    utility_bps: float | None = None
    solve_ms: float | None = None
    disruption: Disruption | None = None
    dropped_pins: tuple[DroppedPin, ...] = ()
    error: str | None = None


class ContingencyTable(BaseModel):
    """For each UAV of the plan, what users get when it is lost as slot `at_slot` begins. Rates in bit/s.

    `mean_sum_rate_bps`: as planned, over the same slots. `disruption_weight`: what a change had to be worth, kbit/s.
    `complete`: whether every row is there.
    """

    plan_id: str
    at_slot: int
    mean_sum_rate_bps: float
    disruption_weight: float = 0.0
    complete: bool
    rows: list[Contingency]


class Contingencies:
    """All contingency plans of this service, by plan, slot, UAV and weight."""

    def __init__(self, solver: Solver, database: Database) -> None:
        self._lane, self._database = solver[LaneName.AHEAD], database
        self._ready: dict[Key, Plan | str] = {}
        self._under_way: dict[Key, asyncio.Task[Plan | str]] = {}
        self._tokens: set[int] = set()

    def ready(self, plan: Plan, at_slot: int, uav_id: str, disruption_weight: float = 0.0) -> Plan | None:
        """Return the plan for this loss if it is there now."""
        outcome = self._ready.get(Key(plan.id, at_slot, uav_id, disruption_weight))
        return outcome if isinstance(outcome, Plan) else None

    async def make(self, plan: Plan, at_slot: int, uav_ids: tuple[str, ...], disruption_weight: float = 0.0) -> None:
        """Make the plans that are missing for these losses at that slot, one after the other. Raises BusyError."""
        keys = [Key(plan.id, at_slot, uav_id, disruption_weight) for uav_id in uav_ids]
        if any(key not in self._ready and key not in self._under_way for key in keys):
            await self._load(plan.id, at_slot)
        for key in keys:
            await self._one(plan, key)

    async def table_of(
        self, plan: Plan, at_slot: int, wait_s: float, disruption_weight: float = 0.0
    ) -> list[Contingency]:
        """Return the rows of every UAV whose plan was ready within `wait_s` wall seconds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await self.make(plan, at_slot, plan.scenario.uav_ids, disruption_weight)
        keys = {uav: Key(plan.id, at_slot, uav, disruption_weight) for uav in plan.scenario.uav_ids}
        outcomes = {uav: self._ready.get(key) for uav, key in keys.items()}
        return await asyncio.to_thread(
            rows_of, plan, at_slot, {uav: outcome for uav, outcome in outcomes.items() if outcome is not None}
        )

    def yield_to_flight(self) -> None:
        """End the solves that are running, so that the replan of a real loss has the cores."""
        for token in self._tokens:
            self._lane.stop(token)

    async def close(self) -> None:
        """Cancel the solves that are running."""
        for task in self._under_way.values():
            task.cancel()
        await asyncio.gather(*self._under_way.values(), return_exceptions=True)

    async def _one(self, plan: Plan, key: Key) -> None:
        if key in self._ready:
            return
        task = self._under_way.get(key)
        if task is None:
            task = asyncio.create_task(self._solve(plan, key))
            self._under_way[key] = task
            task.add_done_callback(lambda _: self._under_way.pop(key, None))
        await asyncio.shield(task)  # a caller may give up waiting; the plan is made anyway

    async def _solve(self, plan: Plan, key: Key) -> Plan | str:
        try:
            remaining(plan, [key.uav_id], key.at_slot)
            job = Job(
                previous=plan.model_dump_json(),
                request={
                    "failed": [key.uav_id],
                    "at_slot": key.at_slot,
                    "keep_pins": True,
                    "disruption_weight": key.disruption_weight,
                },
                identity={"cause": {"kind": "heartbeat_lost", "uav_ids": [key.uav_id], "detail": "planned ahead"}},
                deadline_s=DEADLINE_S,
            )
            token = self._lane.reserve()
            self._tokens.add(token)
            try:
                outcome: Plan | str = Plan.model_validate_json((await self._lane.solve(job, token)).plan)
            finally:
                self._tokens.discard(token)
        except (ReplanError, SolveError) as error:
            outcome = str(error)
        self._remember(key, outcome)
        await self._store(key, outcome)
        return outcome

    def _remember(self, key: Key, outcome: Plan | str) -> None:
        while len(self._ready) >= KEEP_IN_MEMORY:
            self._ready.pop(next(iter(self._ready)))
        self._ready[key] = outcome

    async def _load(self, plan_id: str, at_slot: int) -> None:
        query = select(table).where(table.c.plan_id == plan_id, table.c.at_slot == at_slot)
        for row in await self._database.rows(query):
            key = Key(plan_id, at_slot, row.uav_id, row.disruption_weight)
            if key not in self._ready:
                self._remember(key, Plan.model_validate_json(row.result) if row.result else str(row.error))
                await asyncio.sleep(0)  # a large fleet's plans take a while: let others take turns

    async def _store(self, key: Key, outcome: Plan | str) -> None:
        plan = outcome if isinstance(outcome, Plan) else None
        row = {
            **key._asdict(),
            "created_at": utc_s(),
            "result": plan.model_dump_json() if plan else None,
            "error": None if plan else outcome,
        }
        insert = postgresql.insert if self._database.is_postgresql else sqlite.insert
        try:
            await self._database.write((insert(table).on_conflict_do_nothing(), row))
        except StoreError as error:  # it is in memory; a restart makes it again
            log.warning("contingency not stored", error=str(error))


def rows_of(plan: Plan, at_slot: int, outcomes: Mapping[str, Plan | str]) -> list[Contingency]:
    """Return the rows of these losses; for a large fleet that takes seconds, so call it in a thread."""
    return [_row(plan, at_slot, uav, outcome) for uav, outcome in outcomes.items()]


def _row(plan: Plan, at_slot: int, uav_id: str, outcome: Plan | str) -> Contingency:
    without = _without_replan_bps(plan, at_slot, uav_id)
    if isinstance(outcome, str):
        return Contingency(uav_id=uav_id, mean_sum_rate_without_replan_bps=without, error=outcome)
    return Contingency(
        uav_id=uav_id,
        mean_sum_rate_bps=outcome.summary.mean_sum_rate_bps,
        mean_sum_rate_without_replan_bps=without,
        user_mean_rates_bps={user: sum(rates) / len(rates) for user, rates in outcome.user_rates_bps.items()},
        utility_bps=outcome.summary.utility_bps,
        solve_ms=outcome.solve_ms,
        disruption=outcome.disruption,
        dropped_pins=outcome.dropped_pins,
    )


def _without_replan_bps(plan: Plan, at_slot: int, uav_id: str) -> float:
    """Return the mean sum rate from `at_slot` on when this UAV is gone and the others fly on by the plan."""
    slots = np.arange(at_slot - plan.first_slot, plan.scenario.slots, dtype=np.intp)
    paths_m = np.array([plan.trajectories_m[uav] for uav in plan.scenario.uav_ids])
    flying = np.array([[uav != uav_id for uav in plan.scenario.uav_ids]] * len(slots))
    return float(delivered_rates_bps(plan, slots, np.moveaxis(paths_m[:, slots], 0, 1), flying).sum(axis=1).mean())
