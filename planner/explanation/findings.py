"""What an explanation says. Rates and utilities are in bit/s; slots are counted on the plan's own grid."""

from __future__ import annotations

from typing import Literal

from skyfolio.planner.scenario import Frozen

Method = Literal["bound", "resolve", "derivative"]
ReasonKind = Literal["band", "interference", "distance", "reach", "no_fly", "battery", "separation", "pins"]
What = Literal["one_more_uav", "more_band", "moved_start"]
Lifted = Literal["separation", "no_fly", "battery", "end", "min_rate", "pins"]
"""Constraints that can be lifted as a whole."""


class Reason(Frozen):
    """One reason why a user does not get more.

    `bound`: a step of the ladder, which begins at what the user gets and ends at what a UAV overhead, alone in the air,
    would give it: at this step its mean rate rises by `gain_bps`, to at most `rate_bps`. `resolve`: in the plan without
    this constraint the user gets `rate_bps`.
    """

    kind: ReasonKind
    method: Method
    rate_bps: float
    gain_bps: float
    detail: str


class UserReasons(Frozen):
    """What a user gets, and why it is not more.

    `level`: `satisfied` if it has all it asked for in every slot in which it is there, `none` without any rate,
    `little` below half of the users' mean or below its own minimum in some slot, else `served`; only `none` and
    `little` have reasons, the greatest of each method first. `main`: the constraint without which
    it would not have little (`resolve`), else the first step of the ladder that lets it have half of what a UAV gives
    on average. `price_per_bps`: what 1 bit/s more for this user costs in utility (derivative), the plan's paths kept.
    """

    user_id: str
    mean_rate_bps: float
    level: Literal["none", "little", "served", "satisfied"]
    main: ReasonKind | None = None
    reasons: tuple[Reason, ...] = ()
    price_per_bps: float | None = None
    price_method: Literal["derivative"] = "derivative"


class Worth(Frozen):
    """What a change of the fleet would be worth: utility, and mean sum rate where it is known.

    `bound`: at most so much; `resolve`: a plan that has it was found; `derivative`: to first order.
    """

    what: What
    uav_id: str
    detail: str
    method: Method
    utility_gain_bps: float
    mean_sum_rate_gain_bps: float | None = None


class Price(Frozen):
    """A constraint that the plan meets, and its price.

    `uav_ids`: at whom it binds. `slots`: in how many slots of them together. `price_bps`: utility gained per
    `per`; null where it was not computed. `hertz`: one hertz more in every slot; `m/s`: of the greatest speed;
    `lifted`: the constraint is dropped for all.
    """

    constraint: Literal["band", "speed", "separation", "no_fly", "battery", "end", "min_rate", "pins"]
    uav_ids: tuple[str, ...]
    slots: int
    per: Literal["hertz", "m/s", "lifted"]
    price_bps: float | None
    method: Method


class Explanation(Frozen):
    """Why a plan is as it is.

    `searched_utility_bps`: what the search of the resolves finds with nothing changed, at least the plan's own utility;
    gains by `resolve` count from there. Resolves keep the plan's pins, except for the price of the pins themselves.
    `complete`: whether all within the budget was computed before time was up.
    """

    plan_id: str
    utility_bps: float
    searched_utility_bps: float
    users: tuple[UserReasons, ...]
    worth: tuple[Worth, ...]
    constraints: tuple[Price, ...]
    resolves: int
    complete: bool
    notes: tuple[str, ...] = ()
