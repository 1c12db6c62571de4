"""What clients see of a recovery."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel

Outcome = Literal[
    "flying", "partly_flying", "too_late", "declined", "superseded", "interrupted", "unanswered", "failed"
]


class RecoveryReport(BaseModel):
    """How the recovery from one incident went.

    Fields that end in `_at_s` are fleet seconds since slot 0; replan, upload and timings are wall time.

    `unanswered`: the operation ended before the recovery was complete. `source`: whether the plan was ready before the
    loss or was solved for after it. `vehicles`: None for each UAV that flies the new plan, else what went wrong.
    `timings_s`: wall seconds spent in each step of the journal.
    """

    outcome: Outcome
    incident: int = 0
    cause: str = "heartbeat_lost"
    lost: dict[str, float]
    declared_at_s: float
    at_slot: int
    plan_id: str | None = None
    source: Literal["solved", "planned_ahead"] | None = None
    replan_ms: float | None = None
    upload_s: float | None = None
    in_force_at_s: float | None = None
    vehicles: dict[str, str | None] = {}
    timings_s: dict[str, float] = {}
    error: str | None = None
