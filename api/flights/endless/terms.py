"""What an operator asks of an operation without a fixed end."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.api.common.errors import InvalidError
from skyfolio.planner import Plan

LEAST_LEFT_SLOTS = 3
"""An extension is due while at least so many slots are left: planning, checking and sending take time, and tries."""


@dataclass(frozen=True, kw_only=True)
class End:
    """When no further extension is made: fleet seconds since slot 0, or a UTC second, or never (both None)."""

    duration_s: float | None = None
    until_utc_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Terms:
    """How an operation is extended.

    horizon_slots: how many slots each new plan has. replan_every_slots: after how many of them it is replaced.
    """

    horizon_slots: int
    replan_every_slots: int
    end: End = End()

    def require_sound(self, plan: Plan) -> None:
        """Raise InvalidError unless an operation that begins with this plan can be extended like this."""
        if self.replan_every_slots > self.horizon_slots - LEAST_LEFT_SLOTS:
            raise InvalidError(
                f"replan_every_slots: {self.replan_every_slots} must be at most horizon_slots - {LEAST_LEFT_SLOTS}, "
                f"{self.horizon_slots - LEAST_LEFT_SLOTS}"
            )
        if plan.scenario.slots <= LEAST_LEFT_SLOTS:
            raise InvalidError(
                f"plan_id: the plan has {plan.scenario.slots} slots; to be extended it needs {LEAST_LEFT_SLOTS + 1}"
            )
        if self.end.duration_s is not None:
            planned_s = plan.scenario.slots * plan.scenario.slot_duration_s
            if self.end.duration_s < planned_s:
                raise InvalidError(
                    f"duration_s: {self.end.duration_s:g} must be at least that of the plan, {planned_s:g}"
                )


def terms_of(
    plan: Plan, *, horizon_slots: int | None = None, replan_every_slots: int | None = None, end: End | None = None
) -> Terms:
    """Return the terms of a request: by default plans are as long as the first one, and replaced after a quarter.

    Raises InvalidError.
    """
    horizon = plan.scenario.slots if horizon_slots is None else horizon_slots
    every = max(1, horizon // 4) if replan_every_slots is None else replan_every_slots
    terms = Terms(horizon_slots=horizon, replan_every_slots=every, end=end or End())
    terms.require_sound(plan)
    return terms
