"""`skyfolio bound`: a plan, and a proven bound on its distance from the optimum."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from skyfolio.planner import Deadline, Scenario, plan
from skyfolio.planner.branch_and_bound import MAX_UAVS, certificate
from skyfolio.planner.problem import problem_of


class TooManyUavsError(ValueError):
    """The fleet is too large for branch and bound over positions."""


def certify(scenario: Scenario, *, tolerance: float, seconds: float) -> dict[str, Any]:
    """Return the plan's utility beside the bound of every feasible plan, at the root and after branching (bit/s).

    Raises TooManyUavsError beyond three UAVs.
    """
    if len(scenario.uavs) > MAX_UAVS:
        raise TooManyUavsError(f"uavs: branch and bound takes at most {MAX_UAVS} UAVs, not {len(scenario.uavs)}")
    began = time.perf_counter()
    best = plan(scenario)
    rates_kbps = np.array([best.user_rates_bps[user] for user in scenario.user_ids]) / 1e3
    deadline = Deadline(seconds, clock=time.monotonic)
    proven = certificate(
        problem_of(scenario), rates_kbps, tolerance=tolerance, max_nodes=10**9, stop=lambda: deadline([])
    )
    utility = best.summary.utility_bps
    root, bound = (max(bound_kbps * 1e3, utility) for bound_kbps in (proven.root_kbps, proven.bound_kbps))
    return {
        "plan": best.id,
        "utility_bps": utility,
        "root_bound_bps": root,
        "root_gap": root / utility - 1,
        "upper_bound_bps": bound,
        "gap": bound / utility - 1,
        "slot_upper_bounds_bps": (proven.slot_bounds_kbps * 1e3).tolist(),
        "rectangles": proven.nodes,
        "finished": proven.finished,
        "seconds": time.perf_counter() - began,
    }


def shown(figures: dict[str, Any]) -> str:
    """Return the figures in two sentences."""
    ended = "all slots settled" if figures["finished"] else "stopped early; the bound holds"
    return (
        f"utility {figures['utility_bps'] / 1e3:.2f} kbit/s; no feasible plan has more than "
        f"{figures['upper_bound_bps'] / 1e3:.2f} kbit/s: at most {figures['gap']:.2%} better "
        f"(root bound: {figures['root_gap']:.2%}).\n"
        f"{figures['rectangles']:,} rectangles in {figures['seconds']:.1f} s, {ended}."
    )
