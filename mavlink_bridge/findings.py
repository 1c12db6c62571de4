"""What the preflight audit compares, and what it finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.planner.geometry import Point

START_WITHIN_M = 15.0
"""A UAV that stands further from its first point flies through air that the plan has given to others."""


class Level(StrEnum):
    """How grave a finding is."""

    BLOCKER = "blocker"
    WARNING = "warning"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One row of the audit. `name`: parameter or measurement; `found` and `should` as text with units.

    refuses: a blocker that keeps it on the ground even where blockers are only reported.
    """

    level: Level
    name: str
    found: str
    should: str
    why: str
    refuses: bool = False


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What a vehicle has reported. Positions in metres east/north of the origin; None: not reported.

    gps_fix: GPS_FIX_TYPE (3 is a 3D fix). battery: share of charge, 0..1, of which nothing is known unless
    `battery_told`. mav_type: MAV_TYPE of its HEARTBEAT. model: from its own parameters.
    """

    autopilot: Autopilot
    parameters: Mapping[str, float]
    model: VehicleModel
    at_m: Point | None = None
    home_m: Point | None = None
    gps_fix: int | None = None
    satellites: int | None = None
    battery: float | None = None
    battery_told: bool = True
    mav_type: int | None = None
    home_amsl_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class OverGround:
    """What a plan over terrain needs of a vehicle: metres.

    home_ground_m: the ground where its home is, above mean sea level. clearance_m: what is kept over it. way_home_m:
    the least height over the ground on its ways home from everywhere on its path.
    """

    home_ground_m: float
    clearance_m: float
    way_home_m: float


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What the operation needs of this vehicle.

    path_m: (n_slots, 2) metres east/north. `stream`: guided by setpoints; force_stream: even if the vehicle would not
    hold when they end. lost_after_s: when a link is declared lost. items: the length of its mission; max_items: what it
    can store. start_within_m: a UAV further from its first point does not take off. altitude_m: the greatest, above
    its home. climb_m: by how much its altitude may change in a slot; 0 where it keeps one. ground: what it needs over
    terrain.
    battery_at_least: the charge (0..1) below
    which no UAV should fly; battery_for_plan: with which it is proven to come home from the plan, None where the plan
    says nothing of energy.
    """

    path_m: list[Point]
    slot_s: float
    altitude_m: float
    max_speed_mps: float
    items: int
    max_items: int
    stream: bool = False
    force_stream: bool = False
    start_within_m: float = START_WITHIN_M
    lost_after_s: float = 5.5
    battery_at_least: float = 0.3
    climb_m: float = 0.0
    ground: OverGround | None = None
    battery_for_plan: float | None = None


def blocker(name: str, found: str, should: str, why: str, *, refuses: bool = False) -> Finding:
    """Return a finding of this level: what was found, what it should be, and why."""
    return Finding(level=Level.BLOCKER, name=name, found=found, should=should, why=why, refuses=refuses)


def warning(name: str, found: str, should: str, why: str) -> Finding:
    """Return a finding of this level: what was found, what it should be, and why."""
    return Finding(level=Level.WARNING, name=name, found=found, should=should, why=why)
