"""What is seen of one drill, each with its time: virtual seconds, and what of them was excused by then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.losses import LossKind
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.api.lab.torture.drill import Blow
from skyfolio.api.store.event_log import Event
from skyfolio.planner.geometry import Point

TAKES_OVER = frozenset({"HOLD", "RETURN", "LAND", "DISARM"})
"""Actions of a failsafe that end the mission."""


def takes_over(detail: Mapping[str, Any]) -> bool:
    """Return whether a failsafe flies the vehicle now; a hold because setpoints came late is still ours to end."""
    late = detail.get("cause") == "setpoints_lost" and detail.get("action") == "HOLD"
    return detail.get("action") in TAKES_OVER and not late


@dataclass(frozen=True, kw_only=True)
class Struck:
    """A blow, when it struck (virtual seconds), and the state of the operation then."""

    at_s: float
    state: str
    blow: Blow


@dataclass(frozen=True, kw_only=True)
class Noted:
    """An event as its service announced it: when, and how much time was excused by then (virtual seconds)."""

    at_s: float
    excused_s: float
    event: Event


@dataclass(frozen=True, kw_only=True)
class Reported:
    """A report of a recovery, when it was seen first, and how much time was excused by then (virtual seconds)."""

    at_s: float
    excused_s: float
    report: RecoveryReport

    @property
    def ends_it(self) -> bool:
        """Return whether its losses are dealt with: the next recovery deals with those of one that was broken off."""
        return self.report.outcome not in {"superseded", "interrupted"}


@dataclass(frozen=True, kw_only=True)
class Stored:
    """A mission as a vehicle has stored it: its checksum, and its items as the simulator has them."""

    mission_id: int
    items: Sequence[Any]


@dataclass(frozen=True, kw_only=True)
class Gone:
    """When a vehicle died, or a human took it, and how much time was excused by then (virtual seconds)."""

    at_s: float
    excused_s: float


@dataclass(frozen=True, kw_only=True)
class SlotClock:
    """Seconds since slot 0 as an operation had them at some virtual second, and whether it was paused."""

    at_s: float
    elapsed_s: float
    paused: bool


@dataclass(frozen=True, kw_only=True)
class Slipped:
    """A slip as a keeper has reported it, and what was true just then.

    at_s: virtual seconds. elapsed_s: on the slot clock. at_m: where the vehicle was, metres east/north. mission_id: of
    what it had on board. start: which service told it, counted from 1.
    """

    system_id: int
    slot: int
    distance_m: float
    at_s: float
    elapsed_s: float
    at_m: Point
    mission_id: int
    start: int


@dataclass(kw_only=True)
class Orphans:
    """Users of lost UAVs that no other serves yet, in which plan, and since when (virtual seconds not excused)."""

    users: set[str]
    plan_id: str
    since_s: float


@dataclass(frozen=True, kw_only=True)
class Taken:
    """A step of the journal, once it was stored or held, and when (virtual seconds)."""

    at_s: float
    entry: Entry


@dataclass(kw_only=True)
class LostUav:
    """A UAV that was declared lost and may fly on, so that its air is reserved.

    stood_m: metres east/north where it was when it was last heard, None once it is heard again. end_m: where the
    mission ends that it has on board, None if it has none. lost_at_s: virtual seconds.
    """

    uav: str
    system_id: int
    kind: LossKind
    lost_at_s: float
    stood_m: Point | None
    end_m: Point | None = None
