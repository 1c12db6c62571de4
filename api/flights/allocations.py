"""What the base station of each UAV must serve: users and bandwidth, now and next.

Each version has a revision. A new one is made as each slot begins and whenever something changes: a loss, a new plan, a
pause. A base station serves what it has acknowledged, for as long as that is valid; what is stale is refused.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from pydantic import BaseModel

from skyfolio.api.common.errors import ConflictError, InvalidError
from skyfolio.api.flights.flight import Flight
from skyfolio.planner import Plan

AFTER_RESTART = 1000
"""A restarted service goes on with the next multiple of this: one revision is never given twice, even if not stored."""


class SlotAllocation(BaseModel):
    """Whom one base station serves in one slot, Hz by user, from and until these fleet seconds since slot 0.

    `sends`: whether it sends at all. One that is about to relieve another is silent until it takes over, and one that
    was relieved is silent from then on: idle, they would disturb the users of others.
    """

    slot: int
    valid_from_s: float
    valid_until_s: float
    bandwidth_hz: dict[str, float]
    sends: bool = True


class UavAllocation(BaseModel):
    """What the base station of one UAV must serve.

    `now`: None before slot 0 and after the last slot; `next`: in the slot after, unless something changes until then.
    `acknowledged`: the newest revision that the base station has acknowledged.
    """

    now: SlotAllocation | None
    next: SlotAllocation | None
    acknowledged: int | None = None


class AllocationsView(BaseModel):
    """What the base station of each UAV must serve, in its newest `revision`.

    `plan_id`: whose bandwidth and association it is; while users of a lost UAV are served by others and no new plan is
    flown yet, that is a plan of its own. `elapsed_s`: the operation's clock as this is sent, fleet seconds since slot
    0, None before; base stations set theirs by it. While the operation is `paused` it stands still, and `now` stays
    valid.
    """

    operation_id: str
    revision: int
    plan_id: str
    elapsed_s: float | None
    paused: bool
    uavs: dict[str, UavAllocation]


class Acknowledgement(BaseModel):
    """What a base station has acknowledged, and what it serves by that."""

    uav_id: str
    revision: int
    allocation: UavAllocation


class _Grounds(NamedTuple):
    """What an allocation follows from: if it changes, so does the revision."""

    slot: int | None
    begun: bool
    paused: bool
    plan_id: str
    lost: frozenset[str]


class Allocations:
    """The allocations of one operation, and what base stations have acknowledged of them."""

    def __init__(self, operation_id: str, flight: Flight) -> None:
        self._operation_id, self._flight = operation_id, flight
        self._acknowledged: dict[str, int] = {}
        self.revision = 0
        self._grounds = self._present()
        self._made = self._make()

    def restore(self, revision: int) -> None:
        """Go on after a restart."""
        self.revision = (revision // AFTER_RESTART + 1) * AFTER_RESTART
        self._grounds = self._present()
        self._made = self._make()

    @property
    def are_due(self) -> bool:
        """Return whether a slot has begun, or something has changed, since they were made."""
        return self._grounds != self._present()

    def renew(self) -> AllocationsView:
        """Make them anew, in the next revision."""
        self.revision += 1
        self._grounds = self._present()
        self._made = self._make()
        return self.view()

    def view(self) -> AllocationsView:
        """Return what clients see."""
        uavs = {
            uav: allocation.model_copy(update={"acknowledged": self._acknowledged.get(uav)})
            for uav, allocation in self._made.uavs.items()
        }
        return self._made.model_copy(update={"uavs": uavs, "elapsed_s": self._flight.elapsed_s()})

    def silent(self) -> list[str]:
        """Return the UAVs that count and whose base stations have acknowledged before, but not the newest revision."""
        return [
            uav
            for uav, revision in self._acknowledged.items()
            if revision < self.revision and uav not in self._flight.lost
        ]

    def acknowledge(self, uav_id: str, revision: int) -> Acknowledgement:
        """Note that a base station has taken over this revision; again is the same.

        Raises InvalidError for an unknown UAV or a revision that was never given, ConflictError for one that is stale.
        """
        if uav_id not in self._flight.systems:
            raise InvalidError(f"uav_id: {uav_id!r} does not fly in this operation")
        if revision > self.revision:
            raise InvalidError(f"revision: {revision} was not given yet; the newest is {self.revision}")
        if revision < self.revision:
            raise ConflictError(f"revision: {revision} is stale; the newest is {self.revision}")
        self._acknowledged[uav_id] = revision
        return Acknowledgement(uav_id=uav_id, revision=revision, allocation=self.view().uavs[uav_id])

    def _present(self) -> _Grounds:
        flight = self._flight
        begun = flight.elapsed_s() is not None
        return _Grounds(flight.slot(), begun, flight.paused, flight.serving[-1].plan.id, frozenset(flight.lost))

    def _make(self) -> AllocationsView:
        flight, grounds = self._flight, self._grounds
        plan = flight.serving[-1].plan
        upcoming = 0 if not grounds.begun else None if grounds.slot is None else grounds.slot + 1
        changed_s = flight.now_s()

        def of(uav: str, slot: int | None, from_s: float = 0.0) -> SlotAllocation | None:
            if slot is None or slot >= flight.n_slots:
                return None
            begins_s = slot * flight.slot_s
            return SlotAllocation(
                slot=slot,
                valid_from_s=round(max(begins_s, from_s), 3),
                valid_until_s=begins_s + flight.slot_s,
                bandwidth_hz=_served(plan, uav, slot, grounds.lost),
                sends=flight.pool is None or _sends(plan, uav, slot),
            )

        return AllocationsView(
            operation_id=self._operation_id,
            revision=self.revision,
            plan_id=plan.id,
            elapsed_s=None,
            paused=grounds.paused,
            uavs={
                uav: UavAllocation(now=of(uav, grounds.slot, changed_s), next=of(uav, upcoming))
                for uav in flight.systems
            },
        )


def _served(plan: Plan, uav: str, slot: int, lost: Collection[str]) -> dict[str, float]:
    """Return the users that a UAV serves in a slot of the operation, and their bands in Hz; none if it is lost."""
    if uav in lost:
        return {}
    n = min(max(slot - plan.first_slot, 0), plan.scenario.slots - 1)
    return {
        user: hertz[n]
        for user, hertz in plan.bandwidth_hz.items()
        if hertz[n] > 0.0 and plan.association[user][n] == uav
    }


def _sends(plan: Plan, uav: str, slot: int) -> bool:
    """Return whether the base station of a UAV sends in a slot of the operation by the plan."""
    if uav not in plan.trajectories_m:
        return False
    n, one = slot - plan.first_slot, plan.scenario.uav(uav)
    ends = plan.scenario.last_slot(one) + 1
    silent = ends if one.off_air_from_slot is None else one.off_air_from_slot
    return (one.on_air_from_slot or 0) <= n < min(ends, silent)
