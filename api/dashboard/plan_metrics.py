"""What plans are worth, as rows of tables and lines of charts. Pure; rates in bit/s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skyfolio.api.common.slots import slot_ranges
from skyfolio.api.dashboard import charts
from skyfolio.api.dashboard.views import WhatIf
from skyfolio.planner import Plan, Scenario


def title(scenario: Scenario) -> str:
    """What a plan was made for."""
    return f"{len(scenario.uavs)} UAVs, {len(scenario.users)} users, mu {scenario.utility.mu_per_kbps:g}"


def with_mu(scenario: Scenario, mu: float) -> Scenario:
    """The same scenario with another weight of steadiness."""
    return scenario.with_changes(utility=scenario.utility.model_copy(update={"mu_per_kbps": mu}))


def sums(plan: Plan, n_slots: int) -> list[float | None]:
    """Sum rate in each slot of the operation's grid, None where the plan says nothing."""
    before: list[float | None] = [None] * plan.first_slot
    if plan.achieved_rates_bps:
        before = list(charts.total(plan.achieved_rates_bps, plan.first_slot))
    made = [*before, *charts.total(plan.user_rates_bps, plan.scenario.slots)]
    return [*made, *[None] * (n_slots - len(made))]


def rows(plan: Plan, other: Plan | None) -> tuple[list[tuple[str, ...]], tuple[str, ...] | None]:
    """Rows of the table, and its head when two plans are compared."""
    shown = [each for each in (plan, other) if each is not None]
    worst = [min(sum(row) / len(row) for row in each.user_rates_bps.values()) for each in shown]
    sums = [each.summary for each in shown]
    rows: list[tuple[str, ...]] = [
        ("utility, kbit/s", *(f"{each.utility_bps / 1e3:.2f}" for each in sums)),
        ("mean sum rate, kbit/s", *(f"{each.mean_sum_rate_bps / 1e3:.2f}" for each in sums)),
        ("variance, (kbit/s)²", *(f"{each.sum_rate_variance_kbps2:.2f}" for each in sums)),
        ("Jain index", *(f"{each.jain:.3f}" for each in sums)),
        ("worst user's mean, kbit/s", *(f"{value / 1e3:.2f}" for value in worst)),
        ("gap to the upper bound", *(f"{each.gap:.1%}" for each in sums)),
        ("solved in", *("–" if each.solve_ms is None else f"{each.solve_ms:.0f} ms" for each in shown)),  # noqa: RUF001
    ]
    return rows, ("", "this", "other") if other else None


def unmet(plan: Plan) -> list[tuple[str, ...]]:
    """Rows of the users that do not get their least rate: what each asks for, gets at least, and when it is short."""
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


def trade_off(tried: Mapping[float, Plan]) -> list[tuple[float, float, float]]:
    """(mu, standard deviation, mean sum rate in kbit/s) of each plan by its mu, from the steadiest to the least."""
    points = [
        (mu, plan.summary.sum_rate_variance_kbps2**0.5, plan.summary.mean_sum_rate_bps / 1e3)
        for mu, plan in tried.items()
    ]
    return sorted(points, key=lambda point: point[1:])


def losses(found: Sequence[WhatIf]) -> list[tuple[str, ...]]:
    """One row a UAV, the worst loss first."""
    worst = sorted(found, key=lambda one: one.mean_sum_rate_bps or 0.0)
    return [
        (one.uav_id, one.error or _kbps(one.mean_sum_rate_bps), _kbps(one.mean_sum_rate_without_replan_bps))
        for one in worst
    ]


def planned(found: Sequence[WhatIf]) -> str:
    """The mean sum rate without a loss, kbit/s."""
    return _kbps(found[0].planned_bps) if found else "-"


def _kbps(rate_bps: float | None) -> str:
    return "-" if rate_bps is None else f"{rate_bps / 1e3:.1f}"
