"""A battery and its plan: what is left at home, and in flight what has been used and whether the rest suffices."""

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


@dataclass(frozen=True, kw_only=True)
class Landing:
    """One UAV's energy as planned, Wh.

    used_wh: expected to be used by the end of its last slot, since its battery was full. home_wh: proven to be left
    when it has come home from there and landed. reserve_wh: of it never planned with. spare_wh: the least that is
    proven to be left above the reserve, from wherever on the way it goes home. usable_wh: in a full battery.
    """

    used_wh: float
    home_wh: float
    reserve_wh: float
    spare_wh: float
    usable_wh: float


def landing_of(plan: Plan, uav_id: str) -> Landing | None:
    """Return how a UAV comes home by the plan; None for one without a battery in the plan."""
    battery = plan.scenario.uav(uav_id).battery
    usable, used, margins = _rows(plan, uav_id)
    if battery is None or usable is None or not used:
        return None
    last = plan.scenario.last_slot(plan.scenario.uav(uav_id))
    reserve = usable * battery.reserve_share
    return Landing(
        used_wh=used[last],
        home_wh=margins[last] + reserve,
        reserve_wh=reserve,
        spare_wh=min(margins[: last + 1]),
        usable_wh=usable,
    )


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
