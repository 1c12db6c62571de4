"""What the pages know of the service. Fields a service does not tell (yet) are None, and shown as a dash.

Angles in degrees, altitude in metres above the vehicle's own home, times named `_s` in fleet seconds.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict


class View(BaseModel):
    """Immutable; fields it does not know are left aside, so that the service can grow."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class Vehicle(View):
    """A registered vehicle as it was last heard."""

    uav_id: str
    system_id: int
    simulated: bool = False
    link: str = "live"
    silent_for_s: float | None = None
    condition_cause: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    relative_alt_m: float | None = None
    heading_deg: float | None = None
    battery_percent: float | None = None
    link_quality: float | None = None
    armed: bool | None = None
    mode: str | None = None
    mission_item: int | None = None
    mission_items: int | None = None
    slip_s: float | None = None


class Ordered(View):
    """What became of an order to one vehicle."""

    uav_id: str
    outcome: str
    reason: str | None = None


class Step(View):
    """One step of an answer to a loss: what, and when or how long, in words ready to be shown."""

    name: str
    took: str = ""
    detail: str = ""
    state: str = "done"
    """done, active, failed or waiting."""


class Recovery(View):
    """One answer to a loss, from detection to flying on. `proposed` while it waits for the operator's word."""

    number: int
    title: str
    lost: dict[str, float]
    phase: str
    at_slot: int | None = None
    declared_at_s: float | None = None
    in_force_at_s: float | None = None
    plan_id: str | None = None
    proposed: bool = False
    steps: tuple[Step, ...] = ()
    vehicles: dict[str, str | None] = {}
    error: str | None = None


OVER = frozenset({"completed", "completed_partly", "aborted", "failed"})
"""States in which nothing more can happen to an operation."""


class Operation(View):
    """One flight of one plan. `slot` counts from 0; `user_rates_bps` holds None for slots not (yet) recorded.

    `ends`: of each UAV, once the operation has ended: flown, returned, landed_elsewhere, lost, in_the_air.
    """

    id: str
    state: str
    policy: str
    plan_id: str
    plan_ids: tuple[str, ...]
    vehicles: dict[str, int]
    lost: tuple[str, ...] = ()
    returned: tuple[str, ...] = ()
    low_on_battery: tuple[str, ...] = ()
    ends: dict[str, str] = {}
    elapsed_s: float | None = None
    slot: int | None = None
    user_rates_bps: dict[str, list[float | None]] = {}
    recoveries: tuple[Recovery, ...] = ()
    error: str | None = None

    @property
    def ended(self) -> bool:
        """Whether nothing more can happen to it."""
        return self.state in OVER

    @property
    def proposal(self) -> Recovery | None:
        """The replan that waits for approval, if one does."""
        return next((one for one in self.recoveries if one.proposed), None)


class OperationLine(View):
    """A line of the list of operations. `created_at` is UTC seconds since 1970."""

    id: str
    state: str
    replanning: str
    created_at: float
    ended_at: float | None = None


class PlanState(View):
    """How far a plan is; `trajectories_m` only when it has a result."""

    id: str
    status: str
    error: str | None = None
    trajectories_m: Any = None


class TrackPoint(View):
    """Where each UAV was heard, metres east/north, fleet seconds after slot 0 began."""

    elapsed_s: float
    positions_m: dict[str, tuple[float, float]]


class WhatIf(View):
    """What users would get on average if this UAV were lost, bit/s; `without_replan`: if the survivors flew on."""

    uav_id: str
    planned_bps: float
    mean_sum_rate_bps: float | None = None
    mean_sum_rate_without_replan_bps: float
    error: str | None = None


class Drill(View):
    """A fault that strikes a simulated UAV: scheduled, struck, or missed because the operation ended before."""

    id: str
    state: str
    operation_id: str
    uav_id: str
    fault: str
    at_slot: int | None = None


class Happening(View):
    """One line of the event log; `id` is None while the service cannot store it."""

    id: int | None
    at: str
    kind: str
    data: dict[str, Any]
