"""What an operator gives so that vehicles relieve each other: a pool of them, and how long they are turned around."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import dist
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from skyfolio.api.common.errors import InvalidError
from skyfolio.planner import Plan, Uav

READY_CHARGE = 0.95
"""A vehicle whose battery is at least so full, as it reports, is turned around; one that reports none after a while."""


class ReliefTerms(BaseModel):
    """The pool of an operation, beside the vehicles that fly its first plan; these relieve, and are relieved, too.

    `pool`: complete UAVs whose `start_m` is where they stand. `turnaround_s`: how long it takes until a vehicle that
    has landed can fly again, fleet seconds; what counts in flight is what the vehicle then reports. `at_once`: how many
    are turned around at the same time. `ready_charge`: how full a battery must be for the next flight.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    pool: Annotated[tuple[Uav, ...], Field(max_length=200)] = ()
    turnaround_s: Annotated[float, Field(ge=0, le=1e5, allow_inf_nan=False)] = 90.0
    at_once: Annotated[int, Field(ge=1, le=1000, strict=True)] | None = None
    ready_charge: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] = READY_CHARGE

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        ids = [uav.id for uav in self.pool]
        twice = next((one for one in ids if ids.count(one) > 1), None)
        if twice is not None:
            raise ValueError(f"pool: {twice!r} is given twice")
        return self

    def require_sound(self, plan: Plan) -> None:
        """Raise InvalidError unless the vehicles of this pool can relieve those of a plan."""
        if plan.pins:
            raise InvalidError("relief: the plan is pinned; who relieves another UAV flies a path of its own")
        for uav in self.pool:
            if uav.id in plan.scenario.uav_ids:
                raise InvalidError(f"relief.pool: {uav.id!r} flies the first plan; it is part of the pool already")
        require_pads_apart([*plan.scenario.uavs, *self.pool], plan.scenario.min_separation_m)


def require_pads_apart(uavs: Sequence[Uav], least_m: float) -> None:
    """Raise InvalidError if two vehicles stand so close that one cannot climb while the other descends."""
    for one, other in combinations(uavs, 2):
        apart_m = dist(one.start_m, other.start_m)
        if apart_m < least_m:
            raise InvalidError(
                f"relief.pool: {one.id!r} and {other.id!r} stand {apart_m:.1f} m apart; min_separation_m is {least_m:g}"
            )
