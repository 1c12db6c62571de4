"""Figures of plans as rows of tables and lines of charts. Pure; rates in bit/s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skyfolio.api.common.slots import slot_ranges
from skyfolio.api.dashboard import charts
from skyfolio.api.dashboard.views import WhatIf
from skyfolio.planner import Plan, Scenario
from skyfolio.planner.energy.outlook import landing_of


def title(scenario: Scenario) -> str:
    """Return a short title: what a plan of this scenario was made for."""
    return f"{len(scenario.uavs)} UAVs, {len(scenario.users)} users, mu {scenario.utility.mu_per_kbps:g}"


def with_mu(scenario: Scenario, mu: float) -> Scenario:
    """Return the scenario with another weight of steadiness, mu in 1/(kbit/s)."""
    return scenario.with_changes(utility=scenario.utility.model_copy(update={"mu_per_kbps": mu}))


def sums(plan: Plan, n_slots: int) -> list[float | None]:
    """Return the sum rate in each slot of the operation's grid, None in slots outside the plan."""
    past = {user: [*[None] * (plan.first_slot - len(row)), *row] for user, row in plan.achieved_rates_bps.items()}
    before = charts.total(past, plan.first_slot)
    totals = [*before, *charts.total(plan.user_rates_bps, plan.scenario.slots)]
    return [*totals, *[None] * (n_slots - len(totals))]


def rows(plan: Plan, other: Plan | None) -> tuple[list[tuple[str, ...]], tuple[str, ...] | None]:
    """Return the rows of the table, and its head if two plans are compared."""
    shown = [option for option in (plan, other) if option is not None]
    worst = [min(sum(row) / len(row) for row in option.user_rates_bps.values()) for option in shown]
    sums = [option.summary for option in shown]
    rows: list[tuple[str, ...]] = [
        ("utility, kbit/s", *(f"{summary.utility_bps / 1e3:.2f}" for summary in sums)),
        ("mean sum rate, kbit/s", *(f"{summary.mean_sum_rate_bps / 1e3:.2f}" for summary in sums)),
        ("variance, (kbit/s)²", *(f"{summary.sum_rate_variance_kbps2:.2f}" for summary in sums)),
        ("Jain index", *(f"{summary.jain:.3f}" for summary in sums)),
        ("worst user's mean, kbit/s", *(f"{value / 1e3:.2f}" for value in worst)),
        ("gap to the upper bound", *(f"{summary.gap:.1%}" for summary in sums)),
        ("solved in", *("–" if option.solve_ms is None else f"{option.solve_ms:.0f} ms" for option in shown)),  # noqa: RUF001
    ]
    return rows, ("", "this", "other") if other else None


def unmet(plan: Plan) -> list[tuple[str, ...]]:
    """Return a row for each user below its minimum rate: what it requires, its lowest rate, and the slots concerned."""
    least = {user.id: user.min_rate_bps for user in plan.scenario.users}
    return [
        (
            user,
            f"{least[user] / 1e3:.2f}",
            f"{min(plan.user_rates_bps[user][slot] for slot in slots) / 1e3:.2f}",
            slot_ranges([plan.first_slot + slot for slot in slots]),
        )
        for user, slots in plan.unmet_min_rate_slots.items()
    ]


def altitudes(plan: Plan) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    """Return the lowest and highest altitude of each UAV in flight, and the head; no rows where none are planned."""
    datum = "home" if plan.scenario.terrain is None else "sea level"
    rows: list[tuple[str, ...]] = []
    for uav in plan.scenario.uavs if plan.altitudes_m is not None else ():
        flown = (plan.altitudes_m or {})[uav.id][: plan.scenario.last_slot(uav) + 1]
        rows.append((uav.id, f"{min(flown):.0f}", f"{max(flown):.0f}"))
    return rows, (f"altitude, m above {datum}", "lowest", "highest")


ENERGY_HEAD = ("energy, Wh", "used in the end", "left at home", "reserve", "least spare")


def energy(plan: Plan) -> list[tuple[str, ...]]:
    """Return a row for each UAV with a battery: what it uses, what is proven to be left at home, and above reserve."""
    landings = [(uav, landing) for uav in plan.scenario.uav_ids if (landing := landing_of(plan, uav)) is not None]
    return [
        (
            uav,
            f"{landing.used_wh:.1f}",
            f"{landing.home_wh:.1f} ({landing.home_wh / landing.usable_wh:.0%})",
            f"{landing.reserve_wh:.1f}",
            f"{landing.spare_wh:.1f}",
        )
        for uav, landing in landings
    ]


def trade_off(tried: Mapping[float, Plan]) -> list[tuple[float, float, float]]:
    """Return (mu, standard deviation, mean sum rate), in kbit/s, of each plan, the steadiest first."""
    points = [
        (mu, plan.summary.sum_rate_variance_kbps2**0.5, plan.summary.mean_sum_rate_bps / 1e3)
        for mu, plan in tried.items()
    ]
    return sorted(points, key=lambda point: point[1:])


def losses(found: Sequence[WhatIf]) -> list[tuple[str, ...]]:
    """Return one row for each UAV, the worst loss first."""
    worst = sorted(found, key=lambda loss: loss.mean_sum_rate_bps or 0.0)
    return [
        (loss.uav_id, loss.error or _kbps(loss.mean_sum_rate_bps), _kbps(loss.mean_sum_rate_without_replan_bps))
        for loss in worst
    ]


def planned(found: Sequence[WhatIf]) -> str:
    """Return the mean sum rate without a loss, in kbit/s."""
    return _kbps(found[0].planned_bps) if found else "-"


def _kbps(rate_bps: float | None) -> str:
    return "-" if rate_bps is None else f"{rate_bps / 1e3:.1f}"
