"""The report of a demonstration drill."""

from __future__ import annotations

from pydantic import BaseModel

from skyfolio.planner import Plan, Utility

UNSERVED_BPS = 1.0
"""A user with less than this has no service."""


class Check(BaseModel):
    """A condition that had to be true, judged by the simulator's ground truth."""

    name: str
    passed: bool
    detail: str


class Rates(BaseModel):
    """One course of events over the whole operation. Rates in bit/s, per slot where a list.

    `worst_user_after_bps` is the least mean rate of any user after the new plan came into force (without one: after the
    loss), `unserved_after` are the users that got nothing then. `utility_bps` is the plans' own utility of all slots.
    """

    mean_sum_rate_before_bps: float
    mean_sum_rate_during_bps: float | None
    mean_sum_rate_after_bps: float
    worst_user_after_bps: float
    unserved_after: list[str]
    utility_bps: float
    sum_rate_variance_kbps2: float
    jain: float
    sum_rate_bps: list[float]
    user_rates_bps: dict[str, list[float]]


class Tracking(BaseModel):
    """How far a UAV truly was from its scheduled point at slot ends, metres."""

    mean_m: float
    worst_m: float


class DemoReport(BaseModel):
    """The whole drill. Times named `_s` are fleet seconds, `replan_ms` and `upload_s` wall time.

    `flown` is what users truly got: measured by the base stations in the `measured_slots` (from 0), and computed at the
    true positions in the others. `slots_without_service` counts until the users of the lost UAV were served again, on
    average, or where that was not measured until the new plan came into force. `no_replan` is what they would have got
    had the survivors flown the first plan to its end: computed from the planned positions, with the lost UAV silent.
    `foreseen` is computed likewise for a plan that knows of the loss from the start.
    """

    passed: bool
    checks: list[Check]
    replanned: bool
    speedup: float
    utility: Utility
    killed: str
    killed_at_slot: int
    killed_at_s: float
    detection_s: float | None
    replan_ms: float | None
    upload_s: float | None
    new_plan_in_force_at_s: float | None
    slots_without_service: float
    measured_slots: list[int]
    flown: Rates
    no_replan: Rates
    foreseen: Rates
    tracking: dict[str, Tracking]
    plans: list[Plan]
    tracks_m: dict[str, list[tuple[float, float, float]]]
    wall_s: float
