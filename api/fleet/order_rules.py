"""Which vehicles an order of the operator reaches: none on the ground, not heard, or flown by somebody else."""

from __future__ import annotations

from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.registry import Fleet


def reason_to_leave_alone(fleet: Fleet, uav: str, action: Action, *, force: bool = False) -> str | None:
    """Return why this vehicle is not sent the order; None if it is sent.

    force: order a vehicle to land or return even if a human or a failsafe flies it.
    """
    system = fleet.system_of(uav)
    owner = fleet.rights.owner(system)
    if owner is not None:
        return f"{owner}: order it there"
    if not fleet.is_heard(system):
        return "it is not heard"
    if fleet.is_down(system):
        return "it is on the ground"
    taken_over = fleet.taken(system)
    if taken_over is None or (force and action != "hold"):
        return None
    return f"{taken_over}; " + ("it is not made to hold" if action == "hold" else "`force` overrules that")
