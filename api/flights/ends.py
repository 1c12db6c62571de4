"""How each UAV of an operation ended, and what that makes of the operation.

What happened while no vehicle was heard is inferred from where a UAV is on the ground: one that went home meanwhile has
not flown its plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import dist

from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.losses import Loss
from skyfolio.planner.geometry import Point

NEAR_M = 15.0
"""Metres from a place within which a UAV has landed there: autopilots land within a few metres, and GPS drifts."""
GROUND_M = 3.0
"""Metres above home; a UAV that is disarmed higher than this is falling, and has not landed."""


_FELL = frozenset({"crashed", "disarmed_in_air"})
"""Without thrust a multirotor falls, and one that is seen to have landed after all is lost as `landed`."""


class UavEnd(StrEnum):
    """Where a UAV was when its operation ended."""

    FLOWN = "flown"
    """It flew its plan to the end, and is on the ground."""
    RETURNED = "returned"
    """It left its plan, and is on the ground at its home."""
    LANDED_ELSEWHERE = "landed_elsewhere"
    """It left its plan, and is on the ground somewhere else."""
    LOST = "lost"
    """It crashed, or was no longer heard."""
    IN_THE_AIR = "in_the_air"
    """It is heard, and still flies."""

    @property
    def is_down(self) -> bool:
        """Return whether it stands on the ground undamaged."""
        return self in {UavEnd.FLOWN, UavEnd.RETURNED, UavEnd.LANDED_ELSEWHERE}


@dataclass(frozen=True, kw_only=True)
class LastSeen:
    """What a UAV last reported; places in metres east/north of the origin, `up_m` above its home.

    heard: its link is not lost. returns_m: home, and where it may land instead. ends_m: the places on the ground where
    its plan may end; empty if none is known.
    """

    heard: bool
    armed: bool
    up_m: float
    mode: str
    at_m: Point | None
    returns_m: tuple[Point, ...]
    ends_m: tuple[Point, ...] = ()

    def is_near(self, *places_m: Point) -> bool:
        """Return whether its position is known and near one of these places."""
        at_m = self.at_m
        return at_m is not None and any(dist(at_m, place_m) <= NEAR_M for place_m in places_m)


def end_of(seen: LastSeen | None, loss: Loss | None) -> UavEnd:
    """Return how one UAV ended.

    loss: why it no longer counted, or left its plan before the end; None if it did neither.
    """
    if seen is None or (loss is not None and loss.kind in _FELL):
        return UavEnd.LOST
    if seen.armed:
        return UavEnd.IN_THE_AIR if seen.heard else UavEnd.LOST
    if loss is None:
        if seen.at_m is None or not seen.ends_m or seen.is_near(*seen.ends_m):
            return UavEnd.FLOWN
    elif seen.up_m > GROUND_M and loss.kind != "landed":
        return UavEnd.LOST
    return UavEnd.RETURNED if seen.is_near(*seen.returns_m) else UavEnd.LANDED_ELSEWHERE


def ends_of(flight: Flight) -> dict[str, UavEnd]:
    """Return how every UAV of a flight that has begun ended, as of now; before slot 0 nothing has been flown."""
    if flight.elapsed_s() is None:
        return {}
    return {uav: end_of(_last_seen(flight, uav), flight.roster.left_its_plan(uav)) for uav in flight.systems}


def shortfall(flight: Flight) -> str | None:
    """Return why the operation is not completed, by UAV; None if it is.

    It is completed if every UAV that counts in the last plan in force has flown to its end, and none is in the air. A
    UAV that was sent home by order, and is on the ground, has done what it should.
    """
    counted, retired = set(flight.plan.scenario.uav_ids), flight.roster.retired
    short = {
        uav: _in_words(end, _last_seen(flight, uav), flight.roster.left_its_plan(uav))
        for uav, end in ends_of(flight).items()
        if end is UavEnd.IN_THE_AIR
        or (uav in counted and end is not UavEnd.FLOWN and not (uav in retired and end.is_down))
    }
    return "; ".join(f"{uav} {end}" for uav, end in short.items()) or None


def _in_words(end: UavEnd, seen: LastSeen | None, loss: Loss | None) -> str:
    where = "" if end is not UavEnd.IN_THE_AIR or seen is None else f" at {seen.up_m:.0f} m in mode '{seen.mode}'"
    return f"{end.value.replace('_', ' ')}{where}" + ("" if loss is None else f" ({loss})")


def _last_seen(flight: Flight, uav: str) -> LastSeen | None:
    telemetry = flight.telemetry(uav)
    if telemetry is None:
        return None
    return LastSeen(
        heard=flight.roster.is_heard(uav),
        armed=telemetry.armed,
        up_m=telemetry.relative_alt_m,
        mode=telemetry.mode.value,
        at_m=flight.roster.last_seen_m(uav),
        returns_m=flight.landing_m(uav),
        ends_m=flight.ends_m(uav),
    )
