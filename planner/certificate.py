"""A proof of how good any plan can be at most, as tight as time allows: by branch and bound, or by crowding."""

from __future__ import annotations

from collections.abc import Callable

from skyfolio.planner.areas.ceiling import lower_ceilings, slot_ceilings_kbps
from skyfolio.planner.areas.size import is_large_problem
from skyfolio.planner.arrays import Array
from skyfolio.planner.bound import best_tables, lifted_kbps, may_crowd, upper_bound_kbps
from skyfolio.planner.branch_and_bound import MAX_UAVS, Certificate, certificate
from skyfolio.planner.crowding.proof import VISITS, Proof, Visit
from skyfolio.planner.gradient import rate_weights
from skyfolio.planner.optimistic import optimistic_rates_kbps
from skyfolio.planner.problem import Problem

FEW_VISITS = VISITS[:1]
"""For the first of two proofs, so that time is left for the second."""


class UnprovableError(ValueError):
    """A search knows nothing of this problem; the message names the field. The bound of its plan holds all the same."""


def prove(
    problem: Problem,
    rates_kbps: Array,
    *,
    tolerance: float = 0.005,
    stop: Callable[[], bool] = lambda: False,
    told: Callable[[float], None] = lambda _: None,
) -> Certificate:
    """Bound the utility of every feasible plan; valid whenever it is stopped.

    rates_kbps: (K, N), those of a good plan, at which proofs begin. tolerance: relative gap at which branch and bound
    leaves a slot. told: called with what is proven so far, in kbit/s. Fleets of up to three are branched over
    positions; the bound of larger ones is the crowding bound, whose `nodes` are assignments. Raises
    UnprovableError for rates averaged over draws, channels that are no inverse square, and users that move.
    """
    if problem.draws.size:
        raise UnprovableError(
            "channel.fading: of 'expected' rates only the bound that comes with the plan is known; a search tightens "
            "that of 'mean', 'sampled' and 'held'"
        )
    if problem.bends is not None:
        raise UnprovableError(
            "channel.kind, channel.antenna: a search tightens the bound of the letter's channel without an antenna; "
            "of others only the bound that comes with the plan is known"
        )
    if problem.n_uavs > MAX_UAVS and not may_crowd(problem):
        raise UnprovableError(
            f"users: with more than {MAX_UAVS} UAVs, and users that move or whose place is uncertain, only the bound "
            "that comes with the plan is known"
        )
    if problem.n_uavs <= MAX_UAVS:
        return certificate(problem, rates_kbps, tolerance=tolerance, max_nodes=10**9, stop=stop)
    if is_large_problem(problem):
        return _of_large(problem, rates_kbps, stop, told)
    root = upper_bound_kbps(problem, rates_kbps)
    told(root)
    if problem.kind == "sum" or problem.mu == 0.0:
        return _by_slots(problem, rates_kbps, root, VISITS, stop, told)
    first = _by_slots(problem, rates_kbps, root, FEW_VISITS, stop, told)
    return _by_tangent_plane(problem, rates_kbps, first, stop, told)


def _of_large(
    problem: Problem, rates_kbps: Array, stop: Callable[[], bool], told: Callable[[float], None]
) -> Certificate:
    """From bounds of the slots' sum rates without a table of all pairs and slots."""
    bounds = slot_ceilings_kbps(problem, rates_kbps)
    root = lifted_kbps(problem, bounds)
    told(root)
    looks, finished = lower_ceilings(problem, rates_kbps, bounds, stop, lambda: told(lifted_kbps(problem, bounds)))
    return Certificate(lifted_kbps(problem, bounds), root, bounds, rates_kbps.sum(axis=0), looks, finished)


def _by_slots(
    problem: Problem,
    rates_kbps: Array,
    root: float,
    visits: tuple[Visit, ...],
    stop: Callable[[], bool],
    told: Callable[[float], None],
) -> Certificate:
    """From bounds of the slots' sum rates: for `sum` as they are, else by Jensen's inequality."""
    optimistic = optimistic_rates_kbps(problem)
    even = not problem.absent.size and bool((problem.weight == 1.0).all())
    weights = problem.weight[:, None] * problem.there
    bounds = (weights * best_tables(optimistic)(weights)).sum(axis=0)
    proof = Proof(
        problem,
        rates_kbps,
        bounds,
        None if even else weights,
        stop,
        lambda: told(min(root, lifted_kbps(problem, bounds))),
        visits=visits,
    )
    finished = proof.run()
    bound = min(root, lifted_kbps(problem, bounds))
    return Certificate(bound, root, bounds, (weights * rates_kbps).sum(axis=0), proof.looks, finished)


def _by_tangent_plane(
    problem: Problem, rates_kbps: Array, before: Certificate, stop: Callable[[], bool], told: Callable[[float], None]
) -> Certificate:
    """Return the lesser of what is proven and the tangent plane of a concave utility at the plan."""
    weights = rate_weights(problem, rates_kbps)
    offset = problem.utility_kbps(rates_kbps)
    best = (weights * rates_kbps).sum(axis=0)
    bounds = (weights * best_tables(optimistic_rates_kbps(problem))(weights)).sum(axis=0)

    def least() -> float:
        return min(before.bound_kbps, offset + float((bounds - best).sum()))

    proof = Proof(problem, rates_kbps, bounds, weights, stop, lambda: told(least()))
    finished = proof.run()
    looks = before.nodes + proof.looks
    if least() < before.bound_kbps:
        return Certificate(least(), before.root_kbps, bounds, best, looks, finished)
    return Certificate(
        before.bound_kbps, before.root_kbps, before.slot_bounds_kbps, before.slot_best_kbps, looks, finished
    )
