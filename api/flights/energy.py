"""The batteries of a flight against its plan: what clients see of them, and who would not come home any more."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from pydantic import BaseModel

from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.planner import Plan
from skyfolio.planner.endurance import proven_by_wh
from skyfolio.planner.energy.outlook import Outlook, outlook_of

GAUGE_SHARE = 0.01
"""Vehicles report their charge in whole per cent: a margin missed by less than this share may be rounding."""


class EnergyView(BaseModel):
    """The energy of one UAV, Wh since its battery was full.

    `used_wh`: by its own gauge; `expected_wh`: by the plan; `at_end_wh`: expected at the end of its last slot, by what
    it has used so far; `margin_wh`: the least that is proven to be left above its reserve when it comes home from this
    slot or a later one. Below 0 it is offered as low on battery.
    """

    used_wh: float
    expected_wh: float
    at_end_wh: float
    margin_wh: float


def energy_view(outlook: Outlook | None) -> EnergyView | None:
    """Return the outlook as clients see it."""
    if outlook is None:
        return None
    return EnergyView(
        used_wh=round(outlook.used_wh, 2),
        expected_wh=round(outlook.expected_wh, 2),
        at_end_wh=round(outlook.at_end_wh, 2),
        margin_wh=round(outlook.margin_wh, 2),
    )


def outlook_in_flight(plan: Plan, uav: str, elapsed_s: float | None, telemetry: Telemetry | None) -> Outlook | None:
    """Return the outlook of a UAV; None where the plan has no battery of it, or its charge is unknown.

    Nor is there one before slot 0, or after its last slot: what it uses then, on its way home, was taken off the margin
    before. elapsed_s: fleet seconds since slot 0 of the operation.
    """
    if elapsed_s is None or telemetry is None or telemetry.battery is None or uav not in plan.trajectories_m:
        return None
    slots = elapsed_s / plan.scenario.slot_duration_s - plan.first_slot
    if slots > plan.scenario.last_slot(plan.scenario.uav(uav)) + 1:
        return None
    return outlook_of(plan, uav, slots, telemetry.battery)


def used_by_slot_wh(
    plan: Plan,
    uavs: Iterable[str],
    at_slot: int,
    elapsed_s: float,
    telemetry: Callable[[str], Telemetry | None],
) -> dict[str, float]:
    """Return what UAVs will have used when a slot begins, Wh, of those that use more than their plan has proven.

    By then each uses what the plan has proven for that time on top of what its gauge says now. A gauge that says less
    than the proof, or more by no more than rounding, is left out: the proof counts. elapsed_s: fleet seconds since slot
    0 of the operation.
    """
    now = elapsed_s / plan.scenario.slot_duration_s - plan.first_slot
    used = {}
    for uav in uavs:
        heard = telemetry(uav)
        charge = None if heard is None else heard.battery
        proven = [proven_by_wh(plan, uav, slots) for slots in (now, at_slot - plan.first_slot)]
        if charge is None or proven[0] is None or proven[1] is None:
            continue
        battery = plan.scenario.uav(uav).battery
        usable_wh = 0.0 if battery is None else battery.usable_wh
        beyond_wh = usable_wh * (1.0 - charge) - proven[0]
        if beyond_wh > GAUGE_SHARE * usable_wh:
            used[uav] = proven[1] + beyond_wh
    return used


class EnergyWatch:
    """Tells of UAVs whose energy no longer suffices for the plan in force.

    plan, elapsed_s, telemetry: of the flight, asked anew each time.
    """

    def __init__(
        self,
        plan: Callable[[], Plan],
        elapsed_s: Callable[[], float | None],
        telemetry: Callable[[str], Telemetry | None],
    ) -> None:
        self._plan, self._elapsed_s, self._telemetry = plan, elapsed_s, telemetry

    def outlook(self, uav: str) -> Outlook | None:
        """Return the outlook of a UAV; None where nothing is known of it."""
        return outlook_in_flight(self._plan(), uav, self._elapsed_s(), self._telemetry(uav))

    def lacking(self, uav: str) -> str | None:
        """Return in words what a UAV lacks to fly on and come home with its reserve; None while it has enough."""
        outlook = self.outlook(uav)
        if outlook is None:
            return None
        battery = self._plan().scenario.uav(uav).battery
        allowed = 0.0 if battery is None else GAUGE_SHARE * battery.usable_wh
        if outlook.margin_wh >= -allowed:
            return None
        return (
            f"{outlook.used_wh:.1f} Wh used where the plan has {outlook.expected_wh:.1f} Wh: "
            f"{-outlook.margin_wh:.1f} Wh too little to fly on and come home with its reserve"
        )
