"""Which vehicles an order of the operator reaches: not those on the ground, not heard, or flown by somebody else."""

from __future__ import annotations

from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.registry import Fleet


def reason_to_leave_alone(fleet: Fleet, uav: str, action: Action, *, force: bool = False) -> str | None:
    """Why this vehicle is not given the order; None when it is."""
    system = fleet.system_of(uav)
    if not fleet.is_heard(system):
        return "it is not heard"
    if fleet.is_down(system):
        return "it is on the ground"
    taken = fleet.taken(system)
    if taken is None or (force and action != "hold"):
        return None
    return f"{taken}; " + ("it is not made to hold" if action == "hold" else "`force` overrules that")
