"""When a fleet is planned by areas, and what cannot be."""

from __future__ import annotations

from skyfolio.planner.corrections import are_of_uavs
from skyfolio.planner.problem import Problem
from skyfolio.planner.scenario import Scenario
from skyfolio.planner.tracks import are_plain

MOST_AT_ONCE = 20_000_000
"""U K N up to which a fleet is planned at once."""


def is_large(scenario: Scenario) -> bool:
    """Return whether the scenario is planned by areas unless another method is named."""
    cells = len(scenario.uavs) * len(scenario.users) * scenario.slots
    channel = scenario.channel
    alike = channel.is_inverse_square and channel.fading == "mean" and are_of_uavs(channel.corrections_db)
    return cells > MOST_AT_ONCE and alike and are_plain(scenario)


def is_large_problem(problem: Problem) -> bool:
    """Return the same of its arrays: whether tables of U K N numbers are to be avoided, and need not be made."""
    alike = problem.snr_gain.strides[1] == 0 and not problem.draws.size and problem.bends is None
    return problem.snr_gain.size > MOST_AT_ONCE and alike and problem.has_plain_users
