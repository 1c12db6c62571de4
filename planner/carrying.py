"""Pins of a plan that a changed scenario can still keep: of a replan, of a preview, and of what an explanation solves.

A pin is dropped when the UAV or user that it names is gone, or when the UAV can no longer fly the path: the plan
matters more than the pin. What was dropped, and why, is reported.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from skyfolio.planner.pinning import PinError, pinned
from skyfolio.planner.pins import DroppedPin, Pins
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Point, Scenario


@dataclass(frozen=True)
class Carried:
    """Pins that hold from here on, and those that no longer do."""

    pins: Pins
    dropped: tuple[DroppedPin, ...] = ()

    def without_paths(self, given: Pins, slots: int, reason: str) -> Carried:
        """Return the same without the paths that were not `given` by the request itself."""
        free = [uav for uav in self.pins.pinned_uavs if uav not in given.pinned_uavs]
        pins = Pins(paths_m=given.paths_m, uavs=given.uavs, associations=self.pins.associations)
        gone = (DroppedPin(kind="path", id=uav, slots=slots, reason=reason) for uav in free)
        return Carried(pins, (*self.dropped, *gone))


def carried(
    previous: Plan,
    scenario: Scenario,
    at_slot: int,
    current_m: Mapping[str, Sequence[Point]],
    *,
    lost: Collection[str] = (),
    given: Pins | None = None,
) -> Carried:
    """Return the pins of `previous` that still hold in `scenario`, which begins at `at_slot`.

    current_m: the rest of each UAV's path, (N, 2) metres; a pinned UAV that is not on it catches up with it.
    lost: UAVs that are gone, for the reasons. given: pins of the request itself, which are kept and come first; where
    they name the same UAV or user, nothing is carried.
    """
    given = given or Pins()
    gone = _Gone(scenario, frozenset(lost))
    paths, dropped_paths = _paths(previous, gone, current_m, given)
    rows, dropped_rows = _associations(previous, gone, at_slot - previous.first_slot, given)
    base = Pins(paths_m=given.paths_m, uavs=given.uavs, associations={**rows, **given.associations})
    pins, unflyable = _flyable(scenario, base, paths, current_m)
    return Carried(pins, (*dropped_paths, *unflyable, *dropped_rows))


@dataclass(frozen=True)
class _Gone:
    """Who is no longer there, and why."""

    scenario: Scenario
    lost: frozenset[str]

    def why(self, uav: str, slot: int = 0) -> str | None:
        """Return why this UAV does not fly in that slot of the scenario; None if it does."""
        if uav in self.scenario.uav_ids:
            return None if slot <= self.scenario.last_slot(self.scenario.uav(uav)) else f"{uav!r} has left by then"
        return f"{uav!r} is lost" if uav in self.lost else f"{uav!r} no longer flies"


def _paths(
    previous: Plan, gone: _Gone, current_m: Mapping[str, Sequence[Point]], given: Pins
) -> tuple[list[str], list[DroppedPin]]:
    """Return the UAVs whose paths are carried, and those whose paths no UAV flies any more."""
    kept, dropped = [], []
    for uav in previous.pins.pinned_uavs:
        reason = gone.why(uav) or (None if uav in current_m else f"{uav!r} has returned, and starts from where it is")
        if reason is not None:
            dropped.append(DroppedPin(kind="path", id=uav, slots=gone.scenario.slots, reason=reason))
        elif uav not in given.pinned_uavs:
            kept.append(uav)
    return kept, dropped


def _associations(
    previous: Plan, gone: _Gone, begin: int, given: Pins
) -> tuple[dict[str, str | tuple[str | None, ...]], list[DroppedPin]]:
    """Return the rows that are carried, from slot `begin` of the previous plan on, free where the UAV is gone."""
    kept: dict[str, str | tuple[str | None, ...]] = {}
    dropped: list[DroppedPin] = []
    for user, wanted in previous.pins.associations.items():
        if user in given.associations:
            continue
        slots = gone.scenario.slots
        row = [wanted] * slots if isinstance(wanted, str) else _fitted(wanted[begin:], slots)
        if user not in gone.scenario.user_ids:
            slots = sum(uav is not None for uav in row)
            dropped.append(DroppedPin(kind="association", id=user, slots=slots, reason=f"{user!r} is no longer a user"))
            continue
        dropped += _freed(user, row, gone)
        still = tuple(uav if uav is not None and gone.why(uav, n) is None else None for n, uav in enumerate(row))
        if any(still):
            kept[user] = wanted if isinstance(wanted, str) and all(still) else still
    return kept, dropped


def _fitted(row: Sequence[str | None], slots: int) -> list[str | None]:
    """Return the row cut, or free for the rest, to so many slots."""
    return [*row[:slots], *[None] * (slots - len(row))]


def _freed(user: str, row: Sequence[str | None], gone: _Gone) -> Iterator[DroppedPin]:
    """Return for each reason in how many slots it frees the user."""
    reasons = [gone.why(uav, n) for n, uav in enumerate(row) if uav is not None]
    for reason in dict.fromkeys(one for one in reasons if one is not None):
        yield DroppedPin(kind="association", id=user, slots=reasons.count(reason), reason=reason)


def _flyable(
    scenario: Scenario, base: Pins, uavs: Sequence[str], current_m: Mapping[str, Sequence[Point]]
) -> tuple[Pins, list[DroppedPin]]:
    """Return the pins with the paths of as many of these UAVs as can be flown, first come first served."""
    everything = base.model_copy(update={"uavs": (*base.uavs, *uavs)})
    if not uavs or _refusal(scenario, everything, current_m) is None:
        return everything, []
    pins, dropped = base, []
    for uav in uavs:
        more = pins.model_copy(update={"uavs": (*pins.uavs, uav)})
        reason = _refusal(scenario, more, current_m)
        if reason is None:
            pins = more
        else:
            dropped.append(DroppedPin(kind="path", id=uav, slots=scenario.slots, reason=reason))
    return pins, dropped


def _refusal(scenario: Scenario, pins: Pins, current_m: Mapping[str, Sequence[Point]]) -> str | None:
    """Return why these pins cannot be kept; None if they can."""
    try:
        pinned(scenario, pins, current_m)
    except PinError as error:
        return str(error)
    return None
