"""Stopping rules: tiny callables that combine. A rule sees the history and says whether to stop.

`AnyOf(MaxIterations(50), RelativeGain(1e-4), Deadline(0.2, clock=time.monotonic))`
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from skyfolio.planner.plans import Iteration


class StoppingRule(Protocol):
    """Whether the optimiser should return what it has. `interrupts` says that it did not finish by itself."""

    interrupts: bool

    def __call__(self, history: Sequence[Iteration]) -> bool:
        """True to stop after the iterations of `history`."""
        ...


class MaxIterations:
    """Stop after `limit` iterations, `L` of Algorithm 1."""

    interrupts = False

    def __init__(self, limit: int) -> None:
        if limit < 1:
            raise ValueError(f"MaxIterations: limit {limit} must be at least 1")
        self.limit = limit

    def __call__(self, history: Sequence[Iteration]) -> bool:
        return len(history) >= self.limit


class RelativeGain:
    """Stop when an iteration raised the utility by less than `tolerance` of its size: convergence."""

    interrupts = False

    def __init__(self, tolerance: float) -> None:
        if not tolerance >= 0:
            raise ValueError(f"RelativeGain: tolerance {tolerance} must be at least 0")
        self.tolerance = tolerance

    def __call__(self, history: Sequence[Iteration]) -> bool:
        if len(history) < 2:
            return False
        before, now = history[-2].utility_bps, history[-1].utility_bps
        return now - before <= self.tolerance * max(abs(now), 1e-9)


class Deadline:
    """Stop `seconds` after the first question, by the given monotonic clock."""

    interrupts = True

    def __init__(self, seconds: float, *, clock: Callable[[], float]) -> None:
        if not seconds > 0:
            raise ValueError(f"Deadline: seconds {seconds} must be above 0")
        self.clock, self.until = clock, clock() + seconds

    def __call__(self, history: Sequence[Iteration]) -> bool:  # noqa: ARG002
        return self.clock() >= self.until


class StopToken:
    """Stop when somebody asks: `is_set` is polled between steps (a threading or multiprocessing event fits)."""

    interrupts = True

    def __init__(self, is_set: Callable[[], bool]) -> None:
        self.is_set = is_set

    def __call__(self, history: Sequence[Iteration]) -> bool:  # noqa: ARG002
        return self.is_set()


class AnyOf:
    """Stop when any of the rules says so; it interrupts when an interrupting one did."""

    def __init__(self, *rules: StoppingRule) -> None:
        self.rules = rules
        self.interrupts = False

    def __call__(self, history: Sequence[Iteration]) -> bool:
        saying = [rule for rule in self.rules if rule(history)]
        self.interrupts = any(rule.interrupts for rule in saying)
        return bool(saying)
