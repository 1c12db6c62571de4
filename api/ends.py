"""How each UAV of an operation ended, and what that makes of the operation."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import hypot

from api.flight import Flight
from api.losses import Loss
from api.rates import Point

HOME_M = 15.0
"""Down within this of its home a UAV has returned; autopilots land within a few metres of it, and GPS wanders."""
GROUND_M = 3.0
"""Disarmed higher than this above home is falling, not landed."""


class UavEnd(StrEnum):
    """Where a UAV was when its operation ended."""

    FLOWN = "flown"
    """It flew its plan to the end, and is down."""
    RETURNED = "returned"
    """It left its plan, and is down at its home."""
    LANDED_ELSEWHERE = "landed_elsewhere"
    """It left its plan, and is down somewhere else."""
    LOST = "lost"
    """It crashed, or was not heard any more."""
    IN_THE_AIR = "in_the_air"
    """It is heard, and still flies."""


@dataclass(frozen=True, kw_only=True)
class LastSeen:
    """What a UAV last said. Metres east/north of the origin; `up_m` above its home. heard: its link is not lost."""

    heard: bool
    armed: bool
    up_m: float
    mode: str
    at_m: Point | None
    home_m: Point


def end_of(seen: LastSeen | None, loss: Loss | None) -> UavEnd:
    """The end of one UAV; `loss`: why it no longer counted or left its plan before the end, None: it did not."""
    if seen is None or (loss is not None and loss.kind == "crashed"):
        return UavEnd.LOST
    if seen.armed:
        return UavEnd.IN_THE_AIR if seen.heard else UavEnd.LOST
    if loss is None:
        return UavEnd.FLOWN
    if seen.up_m > GROUND_M and loss.kind != "landed":
        return UavEnd.LOST
    at_home = seen.at_m is not None and hypot(seen.at_m[0] - seen.home_m[0], seen.at_m[1] - seen.home_m[1]) <= HOME_M
    return UavEnd.RETURNED if at_home else UavEnd.LANDED_ELSEWHERE


def ends_of(flight: Flight) -> dict[str, UavEnd]:
    """The end of every UAV of a flight that has begun, as of now; before slot 0 nobody has flown anything."""
    if flight.elapsed_s() is None:
        return {}
    return {uav: end_of(_last_seen(flight, uav), flight.roster.left_its_plan(uav)) for uav in flight.systems}


def shortfall(flight: Flight) -> str | None:
    """Why the operation is not completed, by name; None when it is.

    It is when every UAV that the last plan in force counts has flown to its end, and nobody is in the air; one that was
    sent home by order has done what it should.
    """
    ends = ends_of(flight)
    counted = set(flight.plan.scenario.uav_ids) - flight.roster.retired
    short = {
        uav: _words(end, _last_seen(flight, uav), flight.roster.left_its_plan(uav))
        for uav, end in ends.items()
        if end is UavEnd.IN_THE_AIR or (uav in counted and end is not UavEnd.FLOWN)
    }
    return "; ".join(f"{uav} {words}" for uav, words in short.items()) or None


def _words(end: UavEnd, seen: LastSeen | None, loss: Loss | None) -> str:
    where = "" if end is not UavEnd.IN_THE_AIR or seen is None else f" at {seen.up_m:.0f} m in mode '{seen.mode}'"
    return f"{end.value.replace('_', ' ')}{where}" + ("" if loss is None else f" ({loss})")


def _last_seen(flight: Flight, uav: str) -> LastSeen | None:
    said = flight.on_board(uav)
    if said is None:
        return None
    return LastSeen(
        heard=flight.roster.is_heard(uav),
        armed=said.armed,
        up_m=said.relative_alt_m,
        mode=said.mode.value,
        at_m=flight.roster.last_seen_m(uav),
        home_m=flight.home_m(uav),
    )
