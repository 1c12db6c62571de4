"""`skyfolio bound`: a plan, and a proven bound on its distance from the optimum."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from skyfolio.api.plans.area_threads import AreaThreads
from skyfolio.planner import Deadline, Scenario, plan
from skyfolio.planner.branch_and_bound import MAX_UAVS
from skyfolio.planner.certificate import prove
from skyfolio.planner.problem import problem_of


def certify(
    scenario: Scenario,
    *,
    tolerance: float,
    seconds: float,
    told: Callable[[float, float], None] = lambda _seconds, _bound_bps: None,
    clock: Callable[[], float] = time.monotonic,
) -> dict[str, Any]:
    """Return the plan's utility beside the bound of every feasible plan, as planned and after proving on (bit/s).

    told: called now and then with the seconds since the beginning and what is proven by then (bit/s; the plan's own
    bound until there is more). clock: by which the seconds pass.
    """
    began = clock()
    deadline = Deadline(seconds, clock=clock)
    with AreaThreads() as run_areas:
        made = plan(scenario, run_areas=run_areas)
    if made.altitudes_m is not None:
        raise ValueError("terrain: of plans with altitudes only the bound that comes with them is known")
    reached = made.summary.upper_bound_bps

    def tell(bound_kbps: float | None = None) -> None:
        nonlocal reached
        reached = min(reached, bound_kbps * 1e3) if bound_kbps is not None else reached
        told(clock() - began, reached)

    def stop() -> bool:
        tell()
        return deadline([])

    rates_kbps = np.array([made.user_rates_bps[user] for user in scenario.user_ids]) / 1e3
    proven = prove(problem_of(scenario), rates_kbps, tolerance=tolerance, stop=stop, told=tell)
    utility = made.summary.utility_bps
    root, bound = (max(one * 1e3, utility) for one in (proven.root_kbps, proven.bound_kbps))
    return {
        "plan": made.id,
        "utility_bps": utility,
        "root_bound_bps": root,
        "root_gap": root / utility - 1,
        "upper_bound_bps": bound,
        "gap": bound / utility - 1,
        "slot_upper_bounds_bps": (proven.slot_bounds_kbps * 1e3).tolist(),
        "method": "branch and bound" if len(scenario.uavs) <= MAX_UAVS else "crowding",
        "looked_at": proven.nodes,
        "finished": proven.finished,
        "seconds": clock() - began,
    }


def shown(figures: dict[str, Any]) -> str:
    """Return the figures in two sentences."""
    ended = "nothing was left to try" if figures["finished"] else "stopped early; the bound holds"
    what = "rectangles" if figures["method"] == "branch and bound" else "assignments"
    return (
        f"utility {figures['utility_bps'] / 1e3:.2f} kbit/s; no feasible plan has more than "
        f"{figures['upper_bound_bps'] / 1e3:.2f} kbit/s: at most {figures['gap']:.2%} better "
        f"(bound of every plan: {figures['root_gap']:.2%}).\n"
        f"{figures['looked_at']:,} {what} in {figures['seconds']:.1f} s, {ended}."
    )
