"""The optimiser: numbers in, numbers out.

It plans bandwidth, UAV-user association and trajectories of a fleet of flying base stations, and replans after a
loss. Nothing here touches files, sockets, clocks or global random state: seeds, observers, clocks and stopping rules
are passed in. `scenario.py` and `plans.py` define the input and the output, `reference/` is the letter as printed,
`feasibility.py` is the independent check that every emitted plan passes. Symbols of the letter are used only here.

Names are loaded on first use (PEP 562), so that a program that only reads a `Scenario` or a `Plan` never loads numba.
`rehearsal.py` compiles every kernel ahead of time; add a new entry kernel there.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skyfolio.planner.changes import Changes, ReplanError
    from skyfolio.planner.comparison import Comparison
    from skyfolio.planner.delivered import delivered_rates_bps
    from skyfolio.planner.examples import EXAMPLES, letter
    from skyfolio.planner.explanation.explain import explain
    from skyfolio.planner.explanation.findings import Explanation
    from skyfolio.planner.explanation.resolving import Budget
    from skyfolio.planner.feasibility import InfeasiblePlanError, Violation, violations
    from skyfolio.planner.learning import Observation, learned_corrections_db
    from skyfolio.planner.methods import METHODS
    from skyfolio.planner.pinning import PinError, pinned
    from skyfolio.planner.pins import DroppedPin, Pins
    from skyfolio.planner.plan_arrays import PlanArrays
    from skyfolio.planner.plans import Cause, Disruption, Iteration, Plan, PlanStatus, Summary
    from skyfolio.planner.previewing import preview
    from skyfolio.planner.problem import Past
    from skyfolio.planner.reassociation import reassociate
    from skyfolio.planner.registries import register_channel, register_method, register_utility
    from skyfolio.planner.remainder import cause_of, remaining, rest_of_paths_m
    from skyfolio.planner.replanning import replan
    from skyfolio.planner.robustness.assess import assess
    from skyfolio.planner.robustness.disturbances import Disturbances
    from skyfolio.planner.robustness.findings import Robustness, RobustnessError
    from skyfolio.planner.robustness.trial import Losses, Trial, require_possible
    from skyfolio.planner.scenario import Channel, Origin, Scenario, Uav, User, Utility
    from skyfolio.planner.separation import closest_approach
    from skyfolio.planner.solve import converged, plan
    from skyfolio.planner.stopping import AnyOf, Deadline, MaxIterations, RelativeGain, StopToken
    from skyfolio.planner.unreachable import UnreachableEndError
    from skyfolio.planner.unsuited import UnsuitedError

__all__ = [
    "EXAMPLES",
    "METHODS",
    "AnyOf",
    "Budget",
    "Cause",
    "Changes",
    "Channel",
    "Comparison",
    "Deadline",
    "Disruption",
    "Disturbances",
    "DroppedPin",
    "Explanation",
    "InfeasiblePlanError",
    "Iteration",
    "Losses",
    "MaxIterations",
    "Observation",
    "Origin",
    "Past",
    "PinError",
    "Pins",
    "Plan",
    "PlanArrays",
    "PlanStatus",
    "RelativeGain",
    "ReplanError",
    "Robustness",
    "RobustnessError",
    "Scenario",
    "StopToken",
    "Summary",
    "Trial",
    "Uav",
    "UnreachableEndError",
    "UnsuitedError",
    "User",
    "Utility",
    "Violation",
    "assess",
    "cause_of",
    "closest_approach",
    "converged",
    "delivered_rates_bps",
    "explain",
    "learned_corrections_db",
    "letter",
    "pinned",
    "plan",
    "preview",
    "reassociate",
    "register_channel",
    "register_method",
    "register_utility",
    "remaining",
    "replan",
    "require_possible",
    "rest_of_paths_m",
    "violations",
]

_HOMES = {
    "changes": (
        "Changes",
        "ReplanError",
    ),
    "comparison": ("Comparison",),
    "delivered": ("delivered_rates_bps",),
    "examples": (
        "EXAMPLES",
        "letter",
    ),
    "explanation.explain": ("explain",),
    "explanation.findings": ("Explanation",),
    "explanation.resolving": ("Budget",),
    "feasibility": (
        "InfeasiblePlanError",
        "Violation",
        "violations",
    ),
    "learning": (
        "Observation",
        "learned_corrections_db",
    ),
    "methods": ("METHODS",),
    "pinning": (
        "PinError",
        "pinned",
    ),
    "pins": (
        "DroppedPin",
        "Pins",
    ),
    "plan_arrays": ("PlanArrays",),
    "plans": (
        "Cause",
        "Disruption",
        "Iteration",
        "Plan",
        "PlanStatus",
        "Summary",
    ),
    "previewing": ("preview",),
    "problem": ("Past",),
    "reassociation": ("reassociate",),
    "registries": (
        "register_channel",
        "register_method",
        "register_utility",
    ),
    "remainder": (
        "cause_of",
        "remaining",
        "rest_of_paths_m",
    ),
    "replanning": ("replan",),
    "robustness.assess": ("assess",),
    "robustness.disturbances": ("Disturbances",),
    "robustness.findings": (
        "Robustness",
        "RobustnessError",
    ),
    "robustness.trial": (
        "Losses",
        "Trial",
        "require_possible",
    ),
    "scenario": (
        "Channel",
        "Origin",
        "Scenario",
        "Uav",
        "User",
        "Utility",
    ),
    "separation": ("closest_approach",),
    "solve": (
        "converged",
        "plan",
    ),
    "stopping": (
        "AnyOf",
        "Deadline",
        "MaxIterations",
        "RelativeGain",
        "StopToken",
    ),
    "unreachable": ("UnreachableEndError",),
    "unsuited": ("UnsuitedError",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name from the module where it lives. Raises AttributeError for any other name."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value
