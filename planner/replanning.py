"""Planning the rest of an operation after something changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.plans import Cause, Plan
from planner.problem import Past, problem_of
from planner.repair import toward
from planner.scenario import Scenario
from planner.solve import plan

Array = NDArray[np.float64]


class ReplanError(ValueError):
    """A replan was asked for that makes no sense: unknown UAV, slot outside the plan, nobody left."""


def replan(
    previous: Plan,
    *,
    failed: Sequence[str],
    at_slot: int,
    positions_m: Mapping[str, tuple[float, float]] | None = None,
    achieved_rates_bps: Mapping[str, Sequence[float]] | None = None,
    cause: Cause | None = None,
    **options: Any,
) -> Plan:
    """Plan the remaining slots for the survivors of `previous`.

    failed: ids of the UAVs that are gone. at_slot: the first slot to plan, on the operation's slot grid.
    positions_m: where the survivors are when that slot begins, metres east/north (default: where the plan has them).
    achieved_rates_bps: what each user got in the slots before `at_slot` (default: what the plan promised).
    options: as for `plan`; the method is the previous plan's unless another is named. Raises as `remaining` does.
    """
    scenario, past = remaining(previous, failed, at_slot, positions_m, achieved_rates_bps)
    problem = problem_of(scenario, past)
    shifted = np.array([previous.trajectories_m[uav][at_slot - previous.first_slot :] for uav in scenario.uav_ids])
    return plan(
        scenario,
        past=past,
        warm_start_m=toward(problem, problem.hover(), shifted),  # the old paths, as far as they are feasible from here
        cause=cause or Cause(uav_ids=tuple(failed)),
        parent=previous.id,
        revision=previous.revision + 1,
        **{"method": previous.method, **options},
    )


def remaining(
    previous: Plan,
    failed: Sequence[str],
    at_slot: int,
    positions_m: Mapping[str, tuple[float, float]] | None = None,
    achieved_rates_bps: Mapping[str, Sequence[float]] | None = None,
) -> tuple[Scenario, Past]:
    """The scenario that is left, survivors at their live positions, and the past that counts; as in `replan`.

    Raises ReplanError for unknown ids, a slot outside the plan, no survivors, survivors closer than `D_min`, or rates
    that are not finite, negative or of the wrong length.
    """
    begin = at_slot - previous.first_slot
    _check_request(previous, failed, begin, positions_m)
    planned = {uav.id: previous.trajectories_m[uav.id][begin] for uav in previous.scenario.uavs}
    now = {**planned, **(positions_m or {})}
    survivors = tuple(
        uav.model_copy(
            update={
                "start_m": _into_area(previous.scenario, now[uav.id]),
                "leaves_at_slot": None if uav.leaves_at_slot is None else uav.leaves_at_slot - begin,
            }
        )
        for uav in previous.scenario.uavs
        if uav.id not in failed and previous.scenario.last_slot(uav) >= begin
    )
    try:
        scenario = previous.scenario.with_changes(uavs=survivors, slots=previous.scenario.slots - begin)
    except ValueError as error:
        raise ReplanError(f"positions_m: {error}") from error
    return scenario, Past(first_slot=at_slot, rates_bps=_achieved(previous, begin, achieved_rates_bps))


def _check_request(
    previous: Plan, failed: Sequence[str], begin: int, positions_m: Mapping[str, tuple[float, float]] | None
) -> None:
    known = previous.scenario.uav_ids
    for field, ids in (("failed", failed), ("positions_m", list(positions_m or {}))):
        unknown = [one for one in ids if one not in known]
        if unknown:
            raise ReplanError(f"{field}: {unknown[0]!r} is not a UAV of plan {previous.id}")
    if set(known) <= set(failed):
        raise ReplanError("failed: no UAV would be left to plan for")
    if not 0 <= begin < previous.scenario.slots:
        last = previous.first_slot + previous.scenario.slots - 1
        raise ReplanError(f"at_slot: {begin + previous.first_slot} must lie in {previous.first_slot}..{last}")


def _into_area(scenario: Scenario, point: Sequence[float]) -> tuple[float, float]:
    """A live position a little outside the area is taken at its edge: the plan brings the UAV back in."""
    (west, south), (east, north) = scenario.area_m
    return min(max(float(point[0]), west), east), min(max(float(point[1]), south), north)


def _achieved(previous: Plan, begin: int, given: Mapping[str, Sequence[float]] | None) -> Array:
    """(K, M) bit/s: all slots before the new plan, from the report or else from the promise."""
    rows = []
    for user in previous.scenario.user_ids:
        promised = [*previous.achieved_rates_bps.get(user, []), *previous.user_rates_bps[user][:begin]]
        row = list(given[user]) if given and user in given else promised
        if len(row) != len(promised):
            raise ReplanError(f"achieved_rates_bps.{user}: has {len(row)} slots, but {len(promised)} have passed")
        if not all(np.isfinite(row)) or min(row, default=0.0) < 0:
            raise ReplanError(f"achieved_rates_bps.{user}: rates must be finite and not negative")
        rows.append(row)
    unknown = [user for user in given or {} if user not in previous.scenario.user_ids]
    if unknown:
        raise ReplanError(f"achieved_rates_bps: {unknown[0]!r} is not a user of plan {previous.id}")
    return np.array(rows, dtype=float)
