"""A battery in flight against its plan: what has been used, and whether what is left still suffices to come home."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.planner.plans import Plan


@dataclass(frozen=True, kw_only=True)
class Outlook:
    """One UAV's energy at a moment, Wh since its battery was full.

    used_wh: as measured. expected_wh: by the plan. at_end_wh: expected at the end of its last slot, by what was
    measured so far. margin_wh: the least that is proven to be left above the reserve, in this slot and those to come.
    """

    used_wh: float
    expected_wh: float
    at_end_wh: float
    margin_wh: float


def outlook_of(plan: Plan, uav_id: str, slots: float, charge: float) -> Outlook | None:
    """Return the outlook of a UAV; None for one without a battery in the plan.

    slots: how many slot durations of the plan are over, with fractions. charge: measured share of a full battery, 0..1.
    What it has used beyond the plan is taken off every margin to come: it is not expected to be saved again.
    """
    battery, used, margins = _rows(plan, uav_id)
    if battery is None or not used:
        return None
    last = plan.scenario.last_slot(plan.scenario.uav(uav_id))
    at = min(max(slots, 0.0), float(last + 1))
    now = min(int(at), last)
    begins_wh = used[now - 1] if now else used[0] - (used[1] - used[0] if last else 0.0)
    expected = begins_wh + (at - now) * (used[now] - begins_wh)
    measured = battery * (1.0 - charge)
    beyond = measured - expected
    return Outlook(
        used_wh=measured,
        expected_wh=expected,
        at_end_wh=used[last] + beyond,
        margin_wh=min(margins[now : last + 1]) - max(beyond, 0.0),
    )


def charge_needed(plan: Plan, uav_id: str) -> float | None:
    """Return the share of a full battery (0..1, or more if none would do) with which the plan is proven to come home.

    None for a UAV without a battery in the plan. The reserve is in it.
    """
    battery, _, margins = _rows(plan, uav_id)
    if battery is None or not margins:
        return None
    last = plan.scenario.last_slot(plan.scenario.uav(uav_id))
    return 1.0 - min(margins[: last + 1]) / battery


def _rows(plan: Plan, uav_id: str) -> tuple[float | None, list[float], list[float]]:
    battery = plan.scenario.uav(uav_id).battery
    used, margins = plan.energy_wh.get(uav_id, []), plan.energy_margin_wh.get(uav_id, [])
    return None if battery is None else battery.usable_wh, used, margins
