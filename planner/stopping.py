"""Stopping rules: tiny callables that combine. A rule receives the history and returns whether to stop.

`AnyOf(MaxIterations(50), RelativeGain(1e-4), Deadline(0.2, clock=time.monotonic))`
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from skyfolio.planner.plans import Iteration


class StoppingRule(Protocol):
    """A rule that decides whether the optimiser returns what it has; `interrupts` if it stops before convergence."""

    interrupts: bool

    def __call__(self, history: Sequence[Iteration]) -> bool:
        """Return whether to stop after the iterations of `history`."""
        ...


class MaxIterations:
    """Stop after `limit` iterations, `L` of Algorithm 1."""

    interrupts = False

    def __init__(self, limit: int) -> None:
        if limit < 1:
            raise ValueError(f"MaxIterations: limit {limit} must be at least 1")
        self.limit = limit

    def __call__(self, history: Sequence[Iteration]) -> bool:
        """Return whether `history` has reached the limit."""
        return len(history) >= self.limit


class RelativeGain:
    """Stop when an iteration raised the utility by less than `tolerance` of its size: convergence."""

    interrupts = False

    def __init__(self, tolerance: float) -> None:
        if not tolerance >= 0:
            raise ValueError(f"RelativeGain: tolerance {tolerance} must be at least 0")
        self.tolerance = tolerance

    def __call__(self, history: Sequence[Iteration]) -> bool:
        """Return whether the last iteration gained too little."""
        if len(history) < 2:
            return False
        before, now = history[-2].utility_bps, history[-1].utility_bps
        return now - before <= self.tolerance * max(abs(now), 1e-9)


class Deadline:
    """Stop `seconds` after the rule was created, by the given monotonic clock."""

    interrupts = True

    def __init__(self, seconds: float, *, clock: Callable[[], float]) -> None:
        if not seconds > 0:
            raise ValueError(f"Deadline: seconds {seconds} must be above 0")
        self.clock, self.until = clock, clock() + seconds

    def __call__(self, history: Sequence[Iteration]) -> bool:  # noqa: ARG002
        """Return whether the time is over."""
        return self.clock() >= self.until


class StopToken:
    """Stop on request: `is_set` is polled between steps (a threading or multiprocessing event fits)."""

    interrupts = True

    def __init__(self, is_set: Callable[[], bool]) -> None:
        self.is_set = is_set

    def __call__(self, history: Sequence[Iteration]) -> bool:  # noqa: ARG002
        """Return whether a stop was requested."""
        return self.is_set()


class AnyOf:
    """Stop when any of the rules says so; it interrupts if an interrupting rule did."""

    def __init__(self, *rules: StoppingRule) -> None:
        self.rules = rules
        self.interrupts = False

    def __call__(self, history: Sequence[Iteration]) -> bool:
        """Return whether any rule stops after the iterations of `history`."""
        saying = [rule for rule in self.rules if rule(history)]
        self.interrupts = any(rule.interrupts for rule in saying)
        return bool(saying)
