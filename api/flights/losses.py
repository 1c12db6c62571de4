"""Why a UAV of an operation no longer counts: silent, on the ground, or no longer ours to command. Pure.

Silence is judged by the heartbeat monitor, everything else by the classifier of what the autopilot reports.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from skyfolio.mavlink_bridge import FlightMode
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
_LANDS_NOWHERE = frozenset({FlightMode.MISSION, FlightMode.OFFBOARD, FlightMode.GUIDED})
"""Modes in which a UAV that flies its plan comes down only at the end of its mission."""
_ENDS_A_PLAN_TOO = frozenset({Condition.LANDED, Condition.FAILSAFE, Condition.REBOOTED})
"""A mission ends with a return and a landing: after the plan these are as planned, or no longer matter."""


@dataclass(frozen=True)
class Loss:
    """Why one UAV is lost to the operation, and what was seen of it, with numbers. `silent_for_s`: fleet seconds."""

    kind: LossKind
    detail: str
    silent_for_s: float = 0.0

    def __str__(self) -> str:
        return f"{self.kind.replace('_', ' ')}: {self.detail}"

    @property
    def is_over(self) -> bool:
        """Return whether it is something that happened, rather than something that goes on."""
        return self.kind in {"crashed", "landed", "disarmed_in_air", "rebooted"}

    @property
    def in_the_air(self) -> bool:
        """Return whether the UAV may still fly, so that its air stays reserved."""
        return self.kind not in {"crashed", "landed"}

    @property
    def may_be_wrong(self) -> bool:
        """Return whether the loss is evidently wrong, and so withdrawn, if the UAV is seen to fly."""
        return self.kind in {"crashed", "landed", "disarmed_in_air"}

    @property
    def comes_down(self) -> bool:
        """Return whether the UAV was seen to leave its plan under power, and so to land where it was sent or flown."""
        return self.kind in {"battery", "ordered", "in_failsafe", "human_took_over", "landed"}

    @property
    def may_return(self) -> bool:
        """Return whether the UAV may be readmitted when it is heard again.

        A UAV that is on the ground, or flown by somebody else, is left alone.
        """
        return self.kind == "heartbeat_lost"


def silent(silent_for_s: float) -> Loss:
    """Return the loss of a UAV that the heartbeat monitor has declared lost, after so many fleet seconds of silence."""
    return Loss("heartbeat_lost", f"silent for {silent_for_s:.1f} s", silent_for_s)


def seen(change: Change | None, *, plan_is_flown: bool) -> Loss | None:
    """Return the loss that a UAV's present condition means for an operation; None if the UAV still counts.

    plan_is_flown: whether the mission should still be flying the plan, so that a return or a landing is not part of it.
    A low battery is no loss: the UAV is offered to the operator. (`battery` is the loss of a UAV that was sent home,
    `ordered` that of one which the operator commanded apart from its operation.) A UAV that rebooted in the air counts
    only if it proves that it flies its mission on.
    """
    if change is None or change.after not in _SEEN:
        return None
    if change.flies_on or (change.after in _ENDS_A_PLAN_TOO and not plan_is_flown):
        return None
    return Loss(_SEEN[change.after], change.cause)


def really(loss: Loss, mode: FlightMode | None) -> Loss:
    """Return what the loss of a UAV that is on the ground before its plan ends really is.

    mode: in which it is now. One that was not seen to come down may have landed, but not in a mode that does not land.
    """
    if loss.kind != "landed" or mode not in _LANDS_NOWHERE:
        return loss
    return Loss("crashed", f"{loss.detail}, in mode '{mode}', which does not land before its plan ends")
