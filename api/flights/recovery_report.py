"""What clients see of a recovery."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel

from skyfolio.planner import Disruption, DroppedPin, Plan

Outcome = Literal[
    "flying", "partly_flying", "too_late", "declined", "superseded", "interrupted", "unanswered", "failed"
]


class HeldPins(BaseModel):
    """The pins that a recovery's plan keeps, by UAV and by user, and those of the plan before that it cannot."""

    uavs: list[str]
    users: list[str]
    dropped: tuple[DroppedPin, ...] = ()


class RecoveryReport(BaseModel):
    """How the recovery from one incident went.

    Fields that end in `_at_s` are fleet seconds since slot 0; replan, upload and timings are wall time.

    `unanswered`: the operation ended before the recovery was complete. `source`: whether the plan was ready before the
    loss or was solved for after it. `disruption`: what its plan changes of the one before, and what that is priced;
    `pins`: None where the plan before had none. `vehicles`: None for each UAV that flies the new plan, else what went
    wrong. `timings_s`: wall seconds spent in each step of the journal.
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
    disruption: Disruption | None = None
    pins: HeldPins | None = None
    upload_s: float | None = None
    in_force_at_s: float | None = None
    vehicles: dict[str, str | None] = {}
    timings_s: dict[str, float] = {}
    error: str | None = None


def changes_of(plan: Plan) -> dict[str, Any]:
    """Return what a report says of how this replan changes the plan before: its `disruption` and its `pins`."""
    kept, dropped = plan.pins, plan.dropped_pins
    held = HeldPins(uavs=list(kept.pinned_uavs), users=list(kept.associations), dropped=dropped)
    return {"disruption": plan.disruption, "pins": held if kept or dropped else None}
