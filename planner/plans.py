"""The plan: where each UAV is in each slot, which users it serves with how much bandwidth, and how good that is."""

from __future__ import annotations

from enum import StrEnum
from operator import not_
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field

from skyfolio.planner.parts import left_out
from skyfolio.planner.pins import DroppedPin, Pins
from skyfolio.planner.plan_arrays import PlanArrays, Table, arrays_of, frame_of
from skyfolio.planner.scenario import Frozen, Scenario

if TYPE_CHECKING:
    import pandas as pd


class PlanStatus(StrEnum):
    """States of a plan as a resource; the planner itself only emits `succeeded` and `cancelled` (stopped early)."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    INFEASIBLE = "infeasible"
    CANCELLED = "cancelled"
    FAILED = "failed"
    INTERRUPTED = "interrupted"


class Cause(Frozen):
    """Why a plan was made: stored with the plan, shown to the operator."""

    kind: Literal[
        "requested",
        "heartbeat_lost",
        "crashed",
        "landed",
        "human_took_over",
        "disarmed_in_air",
        "in_failsafe",
        "rebooted",
        "battery",
        "ordered",
        "users_changed",
        "uav_returned",
        "retuned",
        "rates_off",
        "extended",
        "relief",
    ] = "requested"
    uav_ids: tuple[str, ...] = ()
    detail: str = ""
    silent_for_s: float | None = None


class Iteration(Frozen):
    """One pass of the outer loop. `utility_bps` is never below that of the pass before."""

    iteration: int
    utility_bps: float
    mean_sum_rate_bps: float


class Summary(Frozen):
    """The measures of a plan.

    Rates are bit/s; `sum_rate_variance_kbps2` is the variance over slots of the sum rate in (kbit/s)^2;
    `mean_variance_eq5_bps` is eq. (5) with beta = -mu/2; `jain` is Jain's index of the users' time-averaged rates;
    `upper_bound_bps` bounds the utility of every feasible plan and `gap` = (bound - utility) / |utility|.
    """

    utility_bps: float
    mean_sum_rate_bps: float
    sum_rate_variance_kbps2: float
    mean_variance_eq5_bps: float
    jain: float
    upper_bound_bps: float
    gap: float

    @classmethod
    def steady(cls, rate_bps: float = 0.0) -> Self:
        """Return the measures of a plan made by hand that gives its one user this rate in every slot, its bound too."""
        return cls(
            utility_bps=rate_bps,
            mean_sum_rate_bps=rate_bps,
            sum_rate_variance_kbps2=0.0,
            mean_variance_eq5_bps=rate_bps,
            jain=1.0,
            upper_bound_bps=rate_bps,
            gap=0.0,
        )


class Disruption(Frozen):
    """How much a replan changes of the plan that it replaces, over the slots that both plan, and what that is priced.

    user_slots_changed: in how many slots of how many users, added up, another UAV serves the user than before, counted
    where the old or the new plan gives the user bandwidth and the UAV that served it is still there; users_changed: how
    many users that is. path_changed_m: the distance between where the old and the new plan have a UAV when a slot
    begins, summed over the UAVs of both and averaged over the slots, metres. weight_kbps: the `disruption_weight` of
    the request; price_bps: what was deducted from the utility to choose among plans, bit/s.
    """

    user_slots_changed: int
    users_changed: int
    path_changed_m: float
    weight_kbps: float
    price_bps: float


class Plan(Frozen):
    """A feasible plan for `scenario` (constraints 6a-6g hold exactly), keyed by ids.

    Slot `n` lasts from `n` to `n + 1` slot durations after the start; `trajectories_m[uav][n]` is where the UAV is
    when slot `n` begins, and it flies straight to `[n + 1]` while the slot lasts. Slot 0 is the start position.
    So does its altitude, `altitudes_m[uav][n]`, where altitudes are planned (`altitudes.py`).
    A UAV that leaves (`leaves_at_slot`) keeps its last position in the table, but is no longer there.
    A plan with status `infeasible` could not give every user its `min_rate_bps`: `unmet_min_rate_slots` says whom and
    when, counted on the plan's own grid; all other constraints hold.
    A replan covers the slots that remain, or as many as were asked for: its slot 0 is slot `first_slot` of the
    operation, and `achieved_rates_bps` holds what each user got before that, as far as it counts, and `disruption` what
    it changes.
    `pins` is what the plan was held to, with the paths of pinned UAVs written out; `dropped_pins` are those of the
    plan before that it was asked to keep and could not.
    `energy_wh` is what each UAV with a battery is expected to have used by the end of each slot, Wh since it was full,
    climb included; `energy_margin_wh` what it is then proven to have left above its reserve if it goes home and lands.
    """

    id: str
    revision: Annotated[int, Field(ge=1)] = 1
    status: PlanStatus = PlanStatus.SUCCEEDED
    cause: Cause = Cause()
    parent: str | None = None
    method: str
    first_slot: Annotated[int, Field(ge=0)] = 0
    scenario: Scenario
    trajectories_m: dict[str, list[tuple[float, float]]]
    altitudes_m: dict[str, list[float]] | None = left_out(
        "Of each UAV when each slot begins, where they are planned: metres above mean sea level with terrain, "
        "otherwise above its own home."
    )
    association: dict[str, list[str]]
    bandwidth_hz: dict[str, list[float]]
    user_rates_bps: dict[str, list[float]]
    achieved_rates_bps: dict[str, list[float]] = Field(default_factory=dict)
    unmet_min_rate_slots: dict[str, list[int]] = Field(default_factory=dict)
    summary: Summary
    pins: Pins = Pins()
    dropped_pins: tuple[DroppedPin, ...] = ()
    disruption: Disruption | None = None
    history: list[Iteration] = Field(default_factory=list)
    solve_ms: float | None = None
    energy_wh: dict[str, list[float]] = Field(default_factory=dict, exclude_if=not_)
    energy_margin_wh: dict[str, list[float]] = Field(default_factory=dict, exclude_if=not_)

    def to_arrays(self) -> PlanArrays:
        """Return paths, association, bandwidth and rates as NumPy arrays, by index instead of id."""
        return arrays_of(self)

    def to_frame(self, table: Table = "users") -> pd.DataFrame:
        """Return a pandas table: a row for each slot and user, or with "uavs" for each slot and UAV.

        Columns of both: slot, begins_s (both since the operation began). Of users: user_id, uav_id (empty for none),
        bandwidth_hz, rate_bps. Of UAVs: uav_id, east_m, north_m, altitude_m. Raises ImportError without pandas.
        """
        return frame_of(self, table)
