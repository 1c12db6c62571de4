"""Plans for the eye, in a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group
from rich.table import Table

from skyfolio.api.common.slots import slot_ranges
from skyfolio.planner import Plan
from skyfolio.planner.energy.outlook import landing_of


def plan_table(plan: Plan) -> Group:
    """Return the summary of a plan, the average rate of each user, and the energy of each UAV that has a battery."""
    summary = Table(title=f"{plan.id} (revision {plan.revision}, {plan.status.value})", show_header=False)
    measures = plan.summary
    for name, value in (
        ("slots", f"{plan.first_slot} to {plan.first_slot + plan.scenario.slots - 1}"),
        ("utility", f"{measures.utility_bps / 1e3:.2f} kbit/s"),
        ("mean sum rate", f"{measures.mean_sum_rate_bps / 1e3:.2f} kbit/s"),
        ("variance of the sum rate", f"{measures.sum_rate_variance_kbps2:.3f} (kbit/s)^2"),
        ("Jain index", f"{measures.jain:.3f}"),
        ("upper bound", f"{measures.upper_bound_bps / 1e3:.2f} kbit/s (gap {measures.gap:.1%})"),
        ("solved in", "-" if plan.solve_ms is None else f"{plan.solve_ms:.1f} ms"),
    ):
        summary.add_row(name, value)
    users = Table("user", "mean rate, kbit/s", "served by")
    for user, rates in plan.user_rates_bps.items():
        serving = [uav for uav, rate in zip(plan.association[user], rates, strict=True) if rate > 0]
        users.add_row(user, f"{sum(rates) / len(rates) / 1e3:.2f}", ", ".join(sorted(set(serving))) or "-")
    return Group(summary, users, *_energy(plan))


def _energy(plan: Plan) -> Iterator[Table]:
    """Yield a table of who comes home with how much, where UAVs have batteries."""
    landings = [(uav, landing) for uav in plan.scenario.uav_ids if (landing := landing_of(plan, uav)) is not None]
    if not landings:
        return
    table = Table("UAV", "used in the end, Wh", "left at home, at least, Wh", "of it reserve, Wh", "least spare, Wh")
    for uav, landing in landings:
        left = f"{landing.home_wh:.1f} ({landing.home_wh / landing.usable_wh:.0%})"
        table.add_row(uav, f"{landing.used_wh:.1f}", left, f"{landing.reserve_wh:.1f}", f"{landing.spare_wh:.1f}")
    yield table


def unmet(plan: Plan) -> list[str]:
    """Return a line for each user that does not get its minimum rate: which, how much of what, and in which slots.

    Slots are counted on the operation's grid.
    """
    least = {user.id: user.min_rate_bps for user in plan.scenario.users}
    return [
        f"{user} gets less than its min_rate_bps {least[user]:g} in slots "
        f"{slot_ranges([plan.first_slot + slot for slot in slots])} "
        f"(at least {min(plan.user_rates_bps[user][slot] for slot in slots) / 1e3:.2f} kbit/s)"
        for user, slots in plan.unmet_min_rate_slots.items()
    ]
