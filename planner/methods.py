"""The ways to plan, by name: every method takes the same problem and returns the same kind of solution."""

from __future__ import annotations

from typing import Protocol

from skyfolio.planner import areas, baselines, fast
from skyfolio.planner.arrays import Array
from skyfolio.planner.problem import Problem
from skyfolio.planner.solution import Observer, Solution
from skyfolio.planner.stopping import StoppingRule
from skyfolio.planner.unsuited import UnsuitedError


class Method(Protocol):
    """The signature of every method."""

    def __call__(
        self,
        problem: Problem,
        stop: StoppingRule,
        start_m: Array | None,
        observer: Observer,
        *,
        n_starts: int | None,
        seed: int,
    ) -> Solution:
        """Return the best solution found from `start_m`, (U, N, 2) metres, until `stop` returns True.

        n_starts, seed: for methods that try several starts; others begin once and draw nothing.
        """
        ...


def _paper(
    problem: Problem,
    stop: StoppingRule,
    start_m: Array | None,
    observer: Observer,
    *,
    n_starts: int | None,  # noqa: ARG001 - the letter begins once
    seed: int,  # noqa: ARG001 - and draws nothing
) -> Solution:
    """Run Algorithm 1 as printed; cvxpy is imported here, on first use, because that takes a second.

    Raises UnsuitedError for rates averaged over draws, and for channels that are no inverse square: the letter has no
    surrogate of them.
    """
    if problem.draws.size:
        raise UnsuitedError(
            "channel.fading: the method 'paper' knows one gain of each link (eq. 2), not 'expected' rates; use 'fast'"
        )
    if problem.bends is not None:
        raise UnsuitedError(
            "channel.kind, channel.antenna: the method 'paper' knows the letter's channel without an antenna (eq. 2); "
            "use 'fast'"
        )
    from skyfolio.planner.reference import algorithm_1  # noqa: PLC0415

    return algorithm_1(problem, stop, fast.flyable(problem, start_m), observer)


DEFAULT_METHOD, AREAS = "fast", "areas"
METHODS: dict[str, Method] = {
    DEFAULT_METHOD: fast.optimise,
    AREAS: areas.optimise,
    "paper": _paper,
    "sr_max": baselines.sr_max,
    "static": baselines.static,
    "baseline1": baselines.baseline1,
    "baseline2": baselines.baseline2,
    "baseline2_fixed": baselines.baseline2_fixed,
}


def method_of(name: str) -> Method:
    """Return the method of this name. Raises UnsuitedError with the known names."""
    if name not in METHODS:
        raise UnsuitedError(f"method: {name!r} must be one of {', '.join(METHODS)}")
    return METHODS[name]
