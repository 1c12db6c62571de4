"""What clients see of an operation."""

from __future__ import annotations

from enum import StrEnum
from math import hypot
from typing import Literal

from pydantic import BaseModel

from skyfolio.api.fleet.commander import Action
from skyfolio.api.flights.endless.horizon import EndlessView
from skyfolio.api.flights.endless.relief_view import ReliefView
from skyfolio.api.flights.ends import UavEnd, ends_of
from skyfolio.api.flights.energy import EnergyView, energy_view
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.flights.transition import scheduled_at

Policy = Literal["auto", "approve", "off"]
"""What follows a loss: a new plan is flown, a new plan is proposed, or nothing."""


class State(StrEnum):
    """The states of an operation.

    `interrupted`: commands are in doubt after a restart; only `abort` goes on from there. `link_lost`: no vehicle is
    heard, so our own link is lost; vehicles fly their missions, and the operation goes on when one is heard.
    `completed`: every UAV that counts in the last plan in force flew it to the end and is on the ground, except for
    those that were sent home by order, and none is in the air. `completed_partly`: some did, or at least landed
    undamaged; `error` names those that did not fly the plan, and why.
    """

    UPLOADING = "uploading"
    READY = "ready"
    LAUNCHING = "launching"
    STARTING = "starting"
    FLYING = "flying"
    PAUSED = "paused"
    LANDING = "landing"
    LINK_LOST = "link_lost"
    ABORTING = "aborting"
    INTERRUPTED = "interrupted"
    COMPLETED = "completed"
    COMPLETED_PARTLY = "completed_partly"
    ABORTED = "aborted"
    FAILED = "failed"


IN_THE_AIR = {State.FLYING, State.LANDING, State.PAUSED, State.LINK_LOST}
ENDED = {State.COMPLETED, State.COMPLETED_PARTLY, State.ABORTED, State.FAILED}


class UavView(BaseModel):
    """One UAV of an operation.

    `slip_m`: metres from where the plan has it now, None before slot 0 and after the last. `state`: lost, returned
    (heard again, and offered to the operator), grounded, flying its mission, holding, or another mode by its name.
    `energy`: of one with a battery in the plan, once slot 0 has begun. `end`: where it was when the operation ended;
    None before that, and for an operation that never began slot 0.
    """

    system_id: int
    state: str
    mode: str | None = None
    mission_item: int | None = None
    relative_alt_m: float | None = None
    slip_m: float | None = None
    energy: EnergyView | None = None
    end: UavEnd | None = None


class Proposal(BaseModel):
    """A new plan that waits for the operator's approval."""

    incident: int
    plan_id: str
    lost: dict[str, float]


class Abort(BaseModel):
    """The last order by which an operation was ended: what went wrong with each vehicle that was ordered, or None."""

    action: Action
    vehicles: dict[str, str | None]

    @property
    def error(self) -> str | None:
        """Return what went wrong, in words."""
        failed = [f"{uav}: {error}" for uav, error in sorted(self.vehicles.items()) if error]
        return f"{self.action} failed for {'; '.join(failed)}" if failed else None


class OperationView(BaseModel):
    """An operation. `elapsed_s` counts fleet seconds since slot 0 began; `slot` counts from 0. Rates in bit/s.

    `returned` and `low_on_battery` are offers, and nothing happens to these UAVs unless the operator asks for it:
    `:readmit` plans with the former again, `:retire` sends the latter home and plans without them. `version` is the
    ETag: it counts changes of what can be commanded, not of what is measured. `disruption_weight`: what a change of
    the plan must be worth to a recovery, kbit/s. `user_rates_bps` are measured in the `measured_slots` of each user;
    otherwise they are what the channel model says at the positions that vehicles report. Their rows begin with slot
    `rates_from_slot`; rates of slots before are read with `operations/{id}/rates`. `owner`: the name of the service
    that it belongs to, where several share one database; other services show it as it was last stored. `endless`: how
    it is extended, if it has no fixed end; then `plan_ids` are the first plan and those of the slots whose rates it
    has, and of the `recoveries` that only extended the plan it has the newest. `relief`: its pool and its rota.
    """

    id: str
    version: int
    state: State
    owner: str | None = None
    replanning: Policy
    disruption_weight: float = 0.0
    plan_id: str
    plan_ids: list[str]
    vehicles: dict[str, int]
    uavs: dict[str, UavView]
    lost: list[str]
    returned: list[str]
    low_on_battery: list[str] = []
    elapsed_s: float | None
    slot: int | None
    recoveries: list[RecoveryReport]
    proposal: Proposal | None = None
    user_rates_bps: dict[str, list[float | None]]
    rates_from_slot: int = 0
    measured_slots: dict[str, list[int]] = {}
    endless: EndlessView | None = None
    relief: ReliefView | None = None
    error: str | None
    abort: Abort | None = None


class OperationRow(BaseModel):
    """A line of the list of operations. Times are UTC seconds since 1970. `owner`: as in the operation."""

    id: str
    state: State
    owner: str | None = None
    version: int
    plan_id: str
    replanning: Policy
    created_at: float
    ended_at: float | None


def uav_views(flight: Flight, *, over: bool) -> dict[str, UavView]:
    """Return every UAV of a flight as it was last heard; `over`: with how it ended."""
    positions, ends = flight.positions_m(), ends_of(flight) if over else {}
    return {
        uav: _uav(flight, uav, positions.get(uav)).model_copy(update={"end": ends.get(uav)}) for uav in flight.systems
    }


def slip_m(flight: Flight, uav: str, at_m: tuple[float, float] | None) -> float | None:
    """Return the metres between a UAV and where the plan in force has it now; None where either is not known."""
    if at_m is None or flight.slot() is None or uav not in flight.plan.trajectories_m:
        return None
    planned_m = scheduled_at(flight.plan, uav, flight.now_s())
    return round(hypot(at_m[0] - planned_m[0], at_m[1] - planned_m[1]), 2)


def is_off_plan(flight: Flight, uav: str, at_m: tuple[float, float] | None) -> bool:
    """Return whether a UAV is farther from where it should be than it flies in a slot."""
    slip = slip_m(flight, uav, at_m)
    return slip is not None and slip > flight.plan.scenario.uav(uav).max_speed_mps * flight.slot_s


def _uav(flight: Flight, uav: str, at_m: tuple[float, float] | None) -> UavView:
    telemetry = flight.telemetry(uav)
    view = UavView(system_id=flight.systems[uav], state="unheard", slip_m=slip_m(flight, uav, at_m))
    if telemetry is not None:
        doing = {"mission": "flying", "hold": "holding"}.get(telemetry.mode.value, telemetry.mode.value)
        view = view.model_copy(
            update={
                "state": doing if telemetry.armed else "grounded",
                "mode": telemetry.mode.value,
                "mission_item": telemetry.mission_current,
                "relative_alt_m": telemetry.relative_alt_m,
                "energy": energy_view(flight.energy.outlook(uav)),
            }
        )
    if uav in flight.returned:
        return view.model_copy(update={"state": "returned"})
    return view.model_copy(update={"state": "lost"}) if uav in flight.lost else view
