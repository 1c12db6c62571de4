"""The optimiser: numbers in, numbers out.

It plans bandwidth, UAV-user association and trajectories of a fleet of flying base stations, and replans after a
loss. Nothing here touches files, sockets, clocks or global random state: seeds, observers, clocks and stopping rules
are passed in. `scenario.py` and `plans.py` are what goes in and comes out, `reference/` is the letter as printed,
`feasibility.py` is the independent check that every emitted plan passes. Symbols of the letter are used only here.
"""

from planner.changes import Changes, ReplanError
from planner.delivered import delivered_rates_bps
from planner.examples import EXAMPLES, letter
from planner.fast import UnreachableEndError
from planner.feasibility import InfeasiblePlanError, Violation, violations
from planner.methods import METHODS
from planner.plans import Cause, Iteration, Plan, PlanStatus, Summary
from planner.problem import Past
from planner.replanning import cause_of, remaining, replan
from planner.scenario import Channel, Origin, Scenario, Uav, User, Utility
from planner.separation import closest_approach
from planner.solve import converged, plan
from planner.stopping import AnyOf, Deadline, MaxIterations, RelativeGain, StopToken

__all__ = [
    "EXAMPLES",
    "METHODS",
    "AnyOf",
    "Cause",
    "Changes",
    "Channel",
    "Deadline",
    "InfeasiblePlanError",
    "Iteration",
    "MaxIterations",
    "Origin",
    "Past",
    "Plan",
    "PlanStatus",
    "RelativeGain",
    "ReplanError",
    "Scenario",
    "StopToken",
    "Summary",
    "Uav",
    "UnreachableEndError",
    "User",
    "Utility",
    "Violation",
    "cause_of",
    "closest_approach",
    "converged",
    "delivered_rates_bps",
    "letter",
    "plan",
    "remaining",
    "replan",
    "violations",
]
