"""`explain()`: why a finished plan is as it is."""

from __future__ import annotations

from collections.abc import Callable

from skyfolio.planner.explanation.binding import lifted_prices
from skyfolio.planner.explanation.findings import Explanation, Price
from skyfolio.planner.explanation.ledger import Ledger
from skyfolio.planner.explanation.prices import band_prices, full_slots, speed_price
from skyfolio.planner.explanation.resolving import Budget, Resolver
from skyfolio.planner.explanation.users import user_reasons
from skyfolio.planner.explanation.worths import one_more, per_uav
from skyfolio.planner.plans import Plan

MOST_CELLS = 100_000_000
"""UAVs x users x slots of a plan that can be explained: half a minute of processor time."""


def _never() -> bool:
    return False


def explain(plan: Plan, *, budget: Budget | None = None, stop: Callable[[], bool] = _never) -> Explanation:
    """Explain a finished plan: reasons of users, worths of changes, prices of constraints.

    budget: what may be solved (default: `Budget()`). stop: polled between and within resolves; once it says so, the
    rest is bounds and derivatives, and `complete` is false. The same inputs give the same explanation unless
    `stop` speaks. Raises ReplanError for a plan whose scenario cannot be planned from, and ValueError for one of
    expected fading, whose rates no single gain explains, for one with altitudes, and for one that is too large.
    """
    cells = len(plan.scenario.uavs) * len(plan.scenario.users) * plan.scenario.slots
    if cells > MOST_CELLS:
        raise ValueError(f"slots: {cells:,} UAVs x users x slots are too many to be explained; at most {MOST_CELLS:,}")
    if plan.scenario.channel.fading == "expected":
        raise ValueError(
            "channel.fading: a plan of 'expected' rates cannot be explained: its reasons are those of one gain a link"
        )
    if plan.altitudes_m is not None:
        raise ValueError("terrain: a plan with altitudes cannot be explained: its reasons are those of level ground")
    ledger = Ledger.of(plan)
    resolver = Resolver(ledger, budget or Budget(), stop)
    base = resolver.nothing_changed() if resolver.small_enough else plan
    without = lifted_prices(ledger, resolver)
    users = user_reasons(ledger, base, {kind: made for kind, (_, made) in without.items() if made is not None})
    worth = (*one_more(ledger, resolver, base), *per_uav(ledger, resolver, base))
    return Explanation(
        plan_id=plan.id,
        utility_bps=plan.summary.utility_bps,
        searched_utility_bps=base.summary.utility_bps,
        users=users,
        worth=worth,
        constraints=(*_derived(ledger), *(price for price, _ in without.values())),
        resolves=resolver.count,
        complete=not resolver.interrupted,
        notes=_notes(ledger, resolver),
    )


def _notes(ledger: Ledger, resolver: Resolver) -> tuple[str, ...]:
    notes = []
    if not resolver.small_enough:
        notes.append(
            f"{ledger.problem.snr_gain.size} cells are more than {resolver.budget.most_cells}, or no resolve is "
            "allowed: bounds and derivatives only"
        )
    elif resolver.count >= resolver.budget.most_resolves:
        notes.append(f"all {resolver.count} resolves are spent: the rest is bounds and derivatives")
    changed = ledger.plan.disruption
    if changed is not None and changed.weight_kbps > 0.0:
        notes.append(
            f"the plan was made to change little (disruption_weight {changed.weight_kbps:g}): the resolves were not"
        )
    if resolver.interrupted:
        notes.append("time was up before all resolves were done: the rest is bounds and derivatives")
    return tuple(notes)


def _derived(ledger: Ledger) -> list[Price]:
    """Return the prices of band and speed, one row a UAV."""
    prices, full = band_prices(ledger), full_slots(ledger)
    rows = []
    for u, uav in enumerate(ledger.scenario.uav_ids):
        rows.append(
            Price(
                constraint="band",
                uav_ids=(uav,),
                slots=int(full[u]),
                per="hertz",
                price_bps=float(prices[u]),
                method="derivative",
            )
        )
        slots, price = speed_price(ledger, u)
        if slots:
            rows.append(
                Price(constraint="speed", uav_ids=(uav,), slots=slots, per="m/s", price_bps=price, method="derivative")
            )
    return rows
