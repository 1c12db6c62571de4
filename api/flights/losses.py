"""Why a UAV of an operation no longer counts: silent, down, or no longer ours to command. Pure.

Silence is judged by the heartbeat monitor, everything else by the classifier of what the autopilot says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from skyfolio.mavlink_bridge.conditions import Change, Condition

LossKind = Literal[
    "heartbeat_lost",
    "crashed",
    "landed",
    "disarmed_in_air",
    "human_took_over",
    "in_failsafe",
    "rebooted",
    "battery",
    "ordered",
]
LOSS_KINDS: tuple[LossKind, ...] = get_args(LossKind)

_SEEN: dict[Condition, LossKind] = {
    Condition.CRASHED: "crashed",
    Condition.LANDED: "landed",
    Condition.DISARMED: "disarmed_in_air",
    Condition.HUMAN: "human_took_over",
    Condition.FAILSAFE: "in_failsafe",
    Condition.REBOOTED: "rebooted",
}
_ENDS_A_PLAN_TOO = frozenset({Condition.LANDED, Condition.FAILSAFE, Condition.REBOOTED})
"""A mission ends with a return and a landing: after the plan these are as planned, or change nothing any more."""


@dataclass(frozen=True)
class Loss:
    """One UAV that is lost to the operation, and what was seen of it, with numbers. `silent_for_s`: fleet seconds."""

    kind: LossKind
    detail: str
    silent_for_s: float = 0.0

    def __str__(self) -> str:
        return f"{self.kind.replace('_', ' ')}: {self.detail}"

    @property
    def is_over(self) -> bool:
        """Whether it is something that happened, rather than something that goes on."""
        return self.kind in {"crashed", "landed", "disarmed_in_air", "rebooted"}

    @property
    def in_the_air(self) -> bool:
        """Whether it may still fly, so that its air stays reserved."""
        return self.kind not in {"crashed", "landed"}

    @property
    def may_be_wrong(self) -> bool:
        """Whether it is evidently wrong, and so taken back, when the UAV is seen to fly."""
        return self.kind in {"crashed", "landed", "disarmed_in_air"}

    @property
    def may_return(self) -> bool:
        """Whether being heard again makes it ours again; who is down, or flown by somebody else, is left alone."""
        return self.kind == "heartbeat_lost"


def silent(silent_for_s: float) -> Loss:
    """Declared lost by the heartbeat monitor."""
    return Loss("heartbeat_lost", f"silent for {silent_for_s:.1f} s", silent_for_s)


def seen(change: Change | None, *, plan_is_flown: bool) -> Loss | None:
    """What a UAV's present condition, if any is known, means for an operation; None when it still counts.

    A low battery is none: it is offered to the operator (`battery` is the loss of a UAV that was told to go home, and
    `ordered` that of one which the operator commanded apart from its operation).
    One that rebooted in the air counts only if it proves that it flies its mission on.
    plan_is_flown: whether its mission should still be flying the plan, so that a return or a landing is none of ours.
    """
    if change is None or change.after not in _SEEN:
        return None
    if change.flies_on or (change.after in _ENDS_A_PLAN_TOO and not plan_is_flown):
        return None
    return Loss(_SEEN[change.after], change.cause)
