"""Two plans side by side: who gains, who loses, and which UAVs fly elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import dist
from typing import Literal, TypeVar

from skyfolio.planner.pins import DroppedPin
from skyfolio.planner.plans import Plan, PlanStatus
from skyfolio.planner.scenario import Frozen

_Item = TypeVar("_Item")


class UserChange(Frozen):
    """A user's mean rate in bit/s over the compared slots, before and after; null where it is not there."""

    user_id: str
    before_bps: float | None
    after_bps: float | None
    gain_bps: float | None


class UavMove(Frozen):
    """How far a UAV flies from where the plan had it, in metres over the compared slots; null where it is not there.

    `flown_before_m`, `flown_after_m`: the lengths of its paths.
    """

    uav_id: str
    mean_m: float | None
    greatest_m: float | None
    flown_before_m: float | None
    flown_after_m: float | None


class Comparison(Frozen):
    """A changed scenario compared with a plan; the new plan is not stored.

    Utilities count the past and all slots of each plan, as their summaries do; rates are means in bit/s over the slots
    that both plans have, from `first_slot` on the operation's grid. `hand_overs`: by user, in how many of these slots
    another UAV serves it, where both plans give it something. `method`: the changed scenario was planned
    (`resolve`). `status`: of the new plan; `infeasible` when it misses minimum rates, `cancelled` when time was up.
    `dropped_pins`: pins of the plan that the new one could not keep.
    """

    plan_id: str
    method: Literal["resolve"] = "resolve"
    status: PlanStatus
    first_slot: int
    slots: int
    utility_before_bps: float
    utility_after_bps: float
    upper_bound_after_bps: float
    mean_sum_rate_before_bps: float
    mean_sum_rate_after_bps: float
    gaining: tuple[UserChange, ...]
    losing: tuple[UserChange, ...]
    unchanged: tuple[str, ...]
    joined: tuple[UserChange, ...]
    left: tuple[UserChange, ...]
    uavs: tuple[UavMove, ...]
    hand_overs: dict[str, int]
    unmet_min_rate_slots: dict[str, list[int]]
    dropped_pins: tuple[DroppedPin, ...] = ()


SAME_BPS = 1.0
"""A mean rate that changes by less is unchanged."""


def compare(before: Plan, after: Plan) -> Comparison:
    """Compare two plans on the slots that both have. Raises ValueError when they have none in common."""
    first = max(before.first_slot, after.first_slot)
    end = min(before.first_slot + before.scenario.slots, after.first_slot + after.scenario.slots)
    if end <= first:
        raise ValueError(f"slots: the plans have none in common; {first} is not below {end}")
    window = _Window(before, after, first, end)
    changes = [window.user(user) for user in dict.fromkeys([*before.scenario.user_ids, *after.scenario.user_ids])]
    both = [one for one in changes if one.gain_bps is not None]
    uavs = dict.fromkeys([*before.scenario.uav_ids, *after.scenario.uav_ids])
    return Comparison(
        plan_id=before.id,
        status=after.status,
        first_slot=first,
        slots=end - first,
        utility_before_bps=before.summary.utility_bps,
        utility_after_bps=after.summary.utility_bps,
        upper_bound_after_bps=after.summary.upper_bound_bps,
        mean_sum_rate_before_bps=sum(one.before_bps or 0.0 for one in changes),
        mean_sum_rate_after_bps=sum(one.after_bps or 0.0 for one in changes),
        gaining=_by_size(one for one in both if (one.gain_bps or 0.0) >= SAME_BPS),
        losing=_by_size(one for one in both if (one.gain_bps or 0.0) <= -SAME_BPS),
        unchanged=tuple(one.user_id for one in both if abs(one.gain_bps or 0.0) < SAME_BPS),
        joined=tuple(one for one in changes if one.before_bps is None),
        left=tuple(one for one in changes if one.after_bps is None),
        uavs=tuple(window.uav(uav) for uav in uavs),
        hand_overs={one.user_id: slots for one in both if (slots := window.hand_overs(one.user_id))},
        unmet_min_rate_slots=after.unmet_min_rate_slots,
        dropped_pins=after.dropped_pins,
    )


def _by_size(changes: Iterable[UserChange]) -> tuple[UserChange, ...]:
    return tuple(sorted(changes, key=lambda one: -abs(one.gain_bps or 0.0)))


@dataclass(frozen=True)
class _Window:
    """The slots `first` to `end`, without it, of both plans, on the operation's grid."""

    before: Plan
    after: Plan
    first: int
    end: int

    def of(self, plan: Plan, row: list[_Item]) -> list[_Item]:
        return row[self.first - plan.first_slot : self.end - plan.first_slot]

    def user(self, user: str) -> UserChange:
        rates = [self.of(plan, plan.user_rates_bps.get(user, [])) for plan in (self.before, self.after)]
        was, now = (sum(row) / len(row) if row else None for row in rates)
        gain = None if was is None or now is None else now - was
        return UserChange(user_id=user, before_bps=was, after_bps=now, gain_bps=gain)

    def hand_overs(self, user: str) -> int:
        """Return in how many slots another UAV serves the user, of those in which both plans give it something."""
        was, now = (self.of(plan, plan.association[user]) for plan in (self.before, self.after))
        had, has = (self.of(plan, plan.user_rates_bps[user]) for plan in (self.before, self.after))
        return sum(a != b and min(x, y) > 0.0 for a, b, x, y in zip(was, now, had, has, strict=True))

    def uav(self, uav: str) -> UavMove:
        was, now = (self.of(plan, plan.trajectories_m.get(uav, [])) for plan in (self.before, self.after))
        apart = [dist(a, b) for a, b in zip(was, now, strict=False)]
        return UavMove(
            uav_id=uav,
            mean_m=sum(apart) / len(apart) if apart else None,
            greatest_m=max(apart, default=None),
            flown_before_m=_length_m(was),
            flown_after_m=_length_m(now),
        )


def _length_m(path: list[tuple[float, float]]) -> float | None:
    return sum(dist(a, b) for a, b in pairwise(path)) if path else None
