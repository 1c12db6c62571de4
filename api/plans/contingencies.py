"""Contingencies: plans made ahead of a loss, for each UAV that could be lost at a slot.

They are made in a lane of their own, stored, and used twice: for the N-1 table, and in flight, where the recovery from
a loss whose plan is ready needs no solve.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress

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
from skyfolio.planner import Plan, ReplanError, delivered_rates_bps, remaining

log = structlog.get_logger()
DEADLINE_S = 5.0
KEEP_IN_MEMORY = 512


class Contingency(BaseModel):
    """What users would get if this UAV were lost. Rates in bit/s over the slots from `at_slot` on.

    `mean_sum_rate_without_replan_bps`: the survivors fly on as if nothing had happened. `error`: why there is no plan.
    """

    uav_id: str
    mean_sum_rate_bps: float | None = None
    mean_sum_rate_without_replan_bps: float
    user_mean_rates_bps: dict[str, float] = {}
    utility_bps: float | None = None
    solve_ms: float | None = None
    error: str | None = None


class ContingencyTable(BaseModel):
    """For each UAV of the plan, what users get when it is lost as slot `at_slot` begins. Rates in bit/s.

    `mean_sum_rate_bps`: as planned, over the same slots. `complete`: whether every row is there.
    """

    plan_id: str
    at_slot: int
    mean_sum_rate_bps: float
    complete: bool
    rows: list[Contingency]


class Contingencies:
    """All contingency plans of this service, by (plan, slot, UAV)."""

    def __init__(self, solver: Solver, database: Database) -> None:
        self._lane, self._database = solver[LaneName.AHEAD], database
        self._ready: dict[tuple[str, int, str], Plan | str] = {}
        self._under_way: dict[tuple[str, int, str], asyncio.Task[Plan | str]] = {}
        self._tokens: set[int] = set()

    def ready(self, plan: Plan, at_slot: int, uav_id: str) -> Plan | None:
        """Return the plan for this loss if it is there now."""
        outcome = self._ready.get((plan.id, at_slot, uav_id))
        return outcome if isinstance(outcome, Plan) else None

    async def make(self, plan: Plan, at_slot: int, uav_ids: tuple[str, ...]) -> None:
        """Make the plans that are missing for these losses at that slot, one after the other. Raises BusyError."""
        keys = [(plan.id, at_slot, uav_id) for uav_id in uav_ids]
        if any(key not in self._ready and key not in self._under_way for key in keys):
            await self._load(plan.id, at_slot)
        for uav_id in uav_ids:
            await self._one(plan, at_slot, uav_id)

    async def table_of(self, plan: Plan, at_slot: int, wait_s: float) -> list[Contingency]:
        """Return the rows of every UAV whose plan was ready within `wait_s` wall seconds."""
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await self.make(plan, at_slot, plan.scenario.uav_ids)
        outcomes = {uav: self._ready.get((plan.id, at_slot, uav)) for uav in plan.scenario.uav_ids}
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

    async def _one(self, plan: Plan, at_slot: int, uav_id: str) -> None:
        key = (plan.id, at_slot, uav_id)
        if key in self._ready:
            return
        task = self._under_way.get(key)
        if task is None:
            task = asyncio.create_task(self._solve(plan, at_slot, uav_id))
            self._under_way[key] = task
            task.add_done_callback(lambda _: self._under_way.pop(key, None))
        await asyncio.shield(task)  # a caller may give up waiting; the plan is made anyway

    async def _solve(self, plan: Plan, at_slot: int, uav_id: str) -> Plan | str:
        key = (plan.id, at_slot, uav_id)
        try:
            remaining(plan, [uav_id], at_slot)
            job = Job(
                previous=plan.model_dump_json(),
                request={"failed": [uav_id], "at_slot": at_slot},
                identity={"cause": {"kind": "heartbeat_lost", "uav_ids": [uav_id], "detail": "planned ahead"}},
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

    def _remember(self, key: tuple[str, int, str], outcome: Plan | str) -> None:
        while len(self._ready) >= KEEP_IN_MEMORY:
            self._ready.pop(next(iter(self._ready)))
        self._ready[key] = outcome

    async def _load(self, plan_id: str, at_slot: int) -> None:
        query = select(table).where(table.c.plan_id == plan_id, table.c.at_slot == at_slot)
        for row in await self._database.rows(query):
            key = (plan_id, at_slot, row.uav_id)
            if key not in self._ready:
                self._remember(key, Plan.model_validate_json(row.result) if row.result else str(row.error))
                await asyncio.sleep(0)  # a large fleet's plans take a while: let others take turns

    async def _store(self, key: tuple[str, int, str], outcome: Plan | str) -> None:
        plan = outcome if isinstance(outcome, Plan) else None
        row = {
            "plan_id": key[0],
            "at_slot": key[1],
            "uav_id": key[2],
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
    )


def _without_replan_bps(plan: Plan, at_slot: int, uav_id: str) -> float:
    """Return the mean sum rate from `at_slot` on when this UAV is gone and the others fly on by the plan."""
    slots = np.arange(at_slot - plan.first_slot, plan.scenario.slots, dtype=np.intp)
    paths_m = np.array([plan.trajectories_m[uav] for uav in plan.scenario.uav_ids])
    flying = np.array([[uav != uav_id for uav in plan.scenario.uav_ids]] * len(slots))
    return float(delivered_rates_bps(plan, slots, np.moveaxis(paths_m[:, slots], 0, 1), flying).sum(axis=1).mean())
