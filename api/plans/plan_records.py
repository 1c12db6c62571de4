"""A plan as a resource: its record, and what clients see while it has no result."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from pydantic import BaseModel, ConfigDict

from skyfolio.api.plans.job_board import Progress
from skyfolio.api.plans.jobs import Solved
from skyfolio.api.plans.solver import LaneName
from skyfolio.planner import Cause, Pins, Plan, PlanStatus, Scenario, Summary

ENDED = {PlanStatus.SUCCEEDED, PlanStatus.INFEASIBLE, PlanStatus.CANCELLED, PlanStatus.FAILED, PlanStatus.INTERRUPTED}


class Asked(BaseModel):
    """What is asked of a plan beside its scenario or its changes.

    `pins`: those of the request; `keep_pins`: also those of the plan before, as far as they hold. `disruption_weight`:
    what a change of the plan before must be worth, kbit/s.
    """

    model_config = ConfigDict(frozen=True)

    pins: Pins = Pins()
    keep_pins: bool = False
    disruption_weight: float = 0.0


class UnfinishedPlan(Asked):
    """A plan that has no result (yet): the fields of a plan that are known, how far it is, and why it failed.

    `pins` are shown as they were asked for; those of the result have the paths of pinned UAVs written out. `best`: the
    best feasible plan so far of a solve that takes long, some tenths of a second old at most when the scenario is
    small; null while there is none.
    """

    id: str
    revision: int
    status: PlanStatus
    cause: Cause
    parent: str | None
    scenario: Scenario | None
    progress: Progress | None = None
    error: str | None = None
    best: Plan | None = None


class PlanRow(BaseModel):
    """A row of the list of plans. Times are UTC seconds since 1970."""

    id: str
    status: PlanStatus
    revision: int
    parent: str | None
    cause: Cause
    created_at: float
    ended_at: float | None
    summary: Summary | None
    error: str | None


@dataclass
class PlanRecord:
    """One plan resource. `result` is the plan as JSON."""

    id: str
    number: int
    created_at: float
    owner: str
    revision: int
    cause: Cause
    parent: str | None
    scenario: str
    asked: Asked = field(default_factory=Asked)
    fingerprint: str | None = None
    status: PlanStatus = PlanStatus.QUEUED
    result: str | None = None
    error: str | None = None
    lane: LaneName = LaneName.REQUESTS
    token: int = -1
    solved: Solved | None = None
    stored: asyncio.Future[None] = field(default_factory=lambda: _already())  # noqa: PLW0108 - defined below
    done: asyncio.Event = field(default_factory=asyncio.Event)
    _plan: Plan | None = None

    @property
    def plan(self) -> Plan | None:
        """Return the result, None while there is none."""
        if self._plan is None and self.result is not None:
            self._plan = Plan.model_validate_json(self.result)
        return self._plan

    @property
    def ended(self) -> bool:
        """Return whether the plan is final."""
        return self.status in ENDED


def _already() -> asyncio.Future[None]:
    """Return the future of something that is stored already."""
    done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    done.set_result(None)
    return done
