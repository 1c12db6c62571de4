"""What the pages know of the service. Fields that the service has not reported (yet) are None, and shown as a dash.

Angles in degrees, altitude in metres above the vehicle's own home, times named `_s` in fleet seconds.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict


class View(BaseModel):
    """An immutable view that ignores unknown fields, so that the service can grow."""

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


class OrderResult(View):
    """The result of an order to one vehicle."""

    uav_id: str
    outcome: str
    reason: str | None = None


class Step(View):
    """One step of a recovery: its name, its duration and details, as text that can be shown."""

    name: str
    took: str = ""
    detail: str = ""
    state: str = "done"
    """done, active, failed or waiting."""


class Recovery(View):
    """One recovery, from the detection of the incident to its end; `proposed` while it waits for approval."""

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
    changes: tuple[str, ...] = ()
    """What its plan changes of the one before, and which pins it keeps, in words."""
    vehicles: dict[str, str | None] = {}
    error: str | None = None


OVER = frozenset({"completed", "completed_partly", "aborted", "failed"})
"""States in which nothing more can happen to an operation."""


class Operation(View):
    """An operation as it is now.

    `slot` counts from 0; `user_rates_bps` holds None for slots that are not recorded (yet); those in `measured_slots`
    were measured, and others are computed from positions. `ends` has the end of each
    UAV once the operation has ended: flown, returned, landed_elsewhere, lost or in_the_air.
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
    measured_slots: dict[str, list[int]] = {}
    recoveries: tuple[Recovery, ...] = ()
    error: str | None = None

    @property
    def ended(self) -> bool:
        """Whether nothing more can happen to the operation."""
        return self.state in OVER

    @property
    def proposal(self) -> Recovery | None:
        """The recovery whose replan waits for approval, if there is one."""
        return next((recovery for recovery in self.recoveries if recovery.proposed), None)


class OperationLine(View):
    """A line of the list of operations; `created_at` is in UTC seconds since 1970."""

    id: str
    state: str
    replanning: str
    created_at: float
    ended_at: float | None = None


class PlanState(View):
    """The state of a plan; `trajectories_m` is set only once it has a result."""

    id: str
    status: str
    error: str | None = None
    trajectories_m: Any = None


class ExplanationState(View):
    """The state of an explanation that is still being made; `status` is None once it is made."""

    status: str | None = None


class TrackPoint(View):
    """The positions that UAVs reported, metres east/north, at a time in fleet seconds after slot 0 began."""

    elapsed_s: float
    positions_m: dict[str, tuple[float, float]]


class WhatIf(View):
    """The mean sum rate in bit/s if this UAV were lost; `without_replan` if the survivors flew on as planned."""

    uav_id: str
    planned_bps: float
    mean_sum_rate_bps: float | None = None
    mean_sum_rate_without_replan_bps: float
    error: str | None = None


class Drill(View):
    """A fault injected into a simulated UAV: scheduled, struck, or missed because the operation ended before."""

    id: str
    state: str
    operation_id: str
    uav_id: str
    fault: str
    at_slot: int | None = None


class ServiceEvent(View):
    """An event of the service; `id` is None while the service cannot store it."""

    id: int | None
    at: str
    kind: str
    data: dict[str, Any]
