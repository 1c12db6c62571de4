"""Calls every kernel that Python uses once, on a tiny problem, so that none is left to compile while aircraft fly.

An `entry` has one signature whatever the problem (`fast.arena.plain`), so one call of each compiles everything.
A test then runs plans and replans of every kind, and fails if a kernel was not rehearsed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skyfolio.planner import areas
from skyfolio.planner.branch_and_bound import certificate
from skyfolio.planner.crowding.bound import first_field
from skyfolio.planner.crowding.slots import everywhere, ground_of
from skyfolio.planner.examples import minimal
from skyfolio.planner.fast import PricedClimb, Tolls, optimise, served_rates_bps
from skyfolio.planner.problem import problem_of
from skyfolio.planner.scenario import NoFlyDisc
from skyfolio.planner.stopping import MaxIterations


def rehearse() -> None:
    """Solve a tiny problem with an end position and a no-fly zone, branch once, and bound slots: every entry kernel."""
    easy = minimal()
    first, *others = easy.uavs
    home = first.model_copy(update={"end_m": first.start_m})
    zone = NoFlyDisc(center_m=(100.0, 20.0), radius_m=10.0)
    problem = problem_of(easy.with_changes(uavs=(home, *others), no_fly=(zone,)))
    solution = optimise(problem, MaxIterations(1), n_starts=3)  # hovering, and places that were looked for
    areas.optimise(problem, MaxIterations(1), n_starts=1)
    rates_kbps = served_rates_bps(problem, solution) / 1e3
    free = Tolls(
        former_m=solution.paths_m,
        serving=solution.serving,
        served=solution.bandwidth_hz > 0.0,
        per_metre=0.0,
        per_user=0.0,
    )
    shared = replace(problem, kind="pooled", mu=-0.1)
    for made in PricedClimb(shared, free, 1.0).steps(optimise(shared, MaxIterations(1), n_starts=1)):
        served_rates_bps(shared, made)
    certificate(problem, np.ascontiguousarray(rates_kbps), max_nodes=1)
    ground = ground_of(problem)
    slot = everywhere(problem, ground, 1)
    first_field(ground, slot, None).improve(slot, 1)
