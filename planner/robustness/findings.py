"""What `assess` finds: rates and outages under many draws, and after every loss that was tried."""

from __future__ import annotations

from typing import Literal

from skyfolio.planner.robustness.disturbances import Disturbances
from skyfolio.planner.scenario import Frozen


class RobustnessError(ValueError):
    """What is asked for makes no sense for this plan, or is more than may be computed; the message names the field."""


class Percentiles(Frozen):
    """A rate over all draws, bit/s: what 5, 50 and 95 % of the draws do not exceed, the mean, and the least."""

    p5_bps: float
    p50_bps: float
    p95_bps: float
    mean_bps: float
    least_bps: float


class UserUnderDraws(Frozen):
    """One user. planned_bps: its mean rate over the slots of the plan; rate_bps: the same in each draw.

    outage_probability: the share, among all draws and the slots that count for it, in which it gets less than the
    threshold of that slot; None for a user with no slot that counts. worst_loss: the loss that leaves it the lowest
    mean rate, by number in `losses`; None when no loss was tried.
    """

    user_id: str
    planned_bps: float
    rate_bps: Percentiles
    outage_probability: float | None
    worst_loss: int | None = None


class LossOutcome(Frozen):
    """A loss of one UAV or of two at once. Rates are mean sum rates from the loss to the end, bit/s.

    at_slot: when, on the operation's grid; replanned_from_slot: the first slot of the new plan, None where there is
    none, and `detail` says why. planned_bps: without any loss; without_replan_bps, with_replan_bps: after it, without
    disturbances. rate_bps: with the replan, in each draw. outage_probability: as for users, over all users and the
    slots from the loss on, by the thresholds of the plan. cut_off: users that were to get something from then on and
    get nothing any more.
    """

    lost: tuple[str, ...]
    at_slot: int
    replanned_from_slot: int | None
    status: Literal["replanned", "short_of_min_rates", "not_replanned"]
    detail: str = ""
    planned_bps: float
    without_replan_bps: float
    with_replan_bps: float
    rate_bps: Percentiles
    outage_probability: float | None
    cut_off: tuple[str, ...] = ()


class Worst(Frozen):
    """The worst of each kind, None where there is none: losses by number in `losses`, a user, a draw by number.

    A loss is worse the likelier an outage is after it, and of equal ones the lower `with_replan_bps` is; a user the
    likelier its outage; a draw the lower its sum rate. (The sum rate of all alone is misleading: without interferers a
    lone UAV may give one user more than the fleet gave to all.)
    """

    single_loss: int | None = None
    double_loss: int | None = None
    user_id: str | None = None
    draw: int


class Robustness(Frozen):
    """How a plan stands up to disturbances and losses. draws: how many there was time for.

    outage: what the threshold of each slot is, in words. sum_rate_bps: the mean sum rate of each draw.
    complete: whether all draws and all losses were computed; `notes` says what was not.
    """

    plan_id: str
    disturbances: Disturbances
    draws: int
    outage: str
    planned_sum_rate_bps: float
    sum_rate_bps: Percentiles
    outage_probability: float | None
    users: tuple[UserUnderDraws, ...]
    losses: tuple[LossOutcome, ...]
    worst: Worst
    complete: bool = True
    notes: tuple[str, ...] = ()
