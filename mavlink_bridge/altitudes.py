"""How high a UAV flies along its path, and from what its altitudes count. Pure.

A plan over terrain has altitudes above mean sea level: missions and setpoints then say so (MAV_FRAME_GLOBAL, and
MAV_FRAME_GLOBAL_INT for setpoints), so that vehicles with different homes fly the same surface. Without terrain they
count from each vehicle's own home.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from skyfolio.mavlink_bridge.findings import OverGround
from skyfolio.mavlink_bridge.items import Frame
from skyfolio.planner.altitudes import clearance_of, climb_mps
from skyfolio.planner.geometry import Point
from skyfolio.planner.plans import Plan
from skyfolio.planner.scenario import Scenario

_CENTIMETRES = 100
_LEVEL_M = 0.5
"""A UAV whose altitudes differ by less keeps one."""


@dataclass(frozen=True)
class Altitudes:
    """The altitudes of one UAV when slots begin: (n_slots,) metres; `amsl`: above mean sea level, not above home."""

    metres: tuple[float, ...]
    amsl: bool = False

    def at(self, slots: float) -> float:
        """Return the altitude `slots` slot durations after the first; beyond the ends, theirs."""
        last = len(self.metres) - 1
        at = min(max(slots, 0.0), float(last))
        low = min(int(at), max(last - 1, 0))
        here, there = self.metres[low], self.metres[min(low + 1, last)]
        return here + (at - low) * (there - here)

    def climb_m(self, slots: float) -> float:
        """Return by how much it climbs in the slot that is being flown; 0 before the first and after the last."""
        slot = int(slots // 1)
        inside = slots >= 0 and slot + 1 < len(self.metres)
        return self.metres[slot + 1] - self.metres[slot] if inside else 0.0

    def from_slot(self, slot: int) -> Altitudes:
        """Return the rest of the altitudes."""
        return Altitudes(self.metres[slot:], self.amsl)

    def begun_at(self, altitude_m: float) -> Altitudes:
        """Return the altitudes with another first one."""
        return Altitudes((altitude_m, *self.metres[1:]), self.amsl)

    def raised_by(self, higher_m: float) -> Altitudes:
        """Return all altitudes so much higher."""
        return Altitudes(tuple(metres + higher_m for metres in self.metres), self.amsl)

    @property
    def lowest_m(self) -> float:
        """The least altitude."""
        return min(self.metres)

    @property
    def highest_m(self) -> float:
        """The greatest altitude."""
        return max(self.metres)

    @property
    def mission_frame(self) -> Frame:
        """The frame of mission items."""
        return Frame.GLOBAL if self.amsl else Frame.GLOBAL_RELATIVE_ALT_INT

    @property
    def setpoint_frame(self) -> Frame:
        """The frame of streamed setpoints."""
        return Frame.GLOBAL_INT if self.amsl else Frame.GLOBAL_RELATIVE_ALT_INT


def altitudes_of(plan: Plan, uav_id: str) -> Altitudes:
    """Return the altitudes of a UAV on its path: planned ones, cut off upwards to a centimetre, or its one altitude."""
    if plan.altitudes_m is None:
        level = plan.scenario.altitude_of(plan.scenario.uav(uav_id))
        return Altitudes((level,) * len(plan.trajectories_m[uav_id]))
    metres = tuple(ceil(metres * _CENTIMETRES) / _CENTIMETRES for metres in plan.altitudes_m[uav_id])
    return Altitudes(metres, plan.scenario.terrain is not None)


def climb_in_slot_m(plan: Plan, uav_id: str) -> float:
    """Return by how much the altitude of a UAV may change in a slot of this plan or of a replan; 0 if it keeps one."""
    altitudes, scenario = altitudes_of(plan, uav_id), plan.scenario
    if altitudes.highest_m - altitudes.lowest_m < _LEVEL_M:
        return 0.0
    return climb_mps(scenario.uav(uav_id)) * scenario.slot_duration_s


def ground_m(scenario: Scenario, point_m: Point) -> float:
    """Return the height of the ground in the datum of missions: above mean sea level, or 0 without terrain."""
    return 0.0 if scenario.terrain is None else float(scenario.terrain.height_m(np.array(point_m)))


def lowest_over_ground_m(scenario: Scenario, path_m: Sequence[Point], altitude_m: float) -> float | None:
    """Return the least height over the ground of a straight way at one altitude, or of a place; None without terrain.

    path_m: its places, (1 or more, 2) metres east/north. altitude_m: above mean sea level.
    """
    if scenario.terrain is None:
        return None
    starts = np.array(path_m[:-1] or path_m, dtype=float)
    ends = np.array(path_m[1:] or path_m, dtype=float)
    return altitude_m - float(scenario.terrain.highest_on_segments(starts, ends).max())


def over_ground(plan: Plan, uav_id: str, home_m: Point | None) -> OverGround | None:
    """Return what a plan over terrain needs of a vehicle with this home, metres east/north; None without terrain.

    home_m: None where it is not known: the plan's own start.
    """
    scenario, altitudes = plan.scenario, altitudes_of(plan, uav_id)
    if scenario.terrain is None or not altitudes.amsl:
        return None
    uav = scenario.uav(uav_id)
    path = np.array(plan.trajectories_m[uav_id][: scenario.last_slot(uav) + 1])
    home = np.array(home_m or uav.start_m)
    ends = np.vstack([path[1:], path[-1:]])
    levels = np.array(altitudes.metres[: len(path)])
    lowest = np.minimum(levels, np.append(levels[1:], levels[-1]))
    between = scenario.terrain.highest_in_triangles(np.broadcast_to(home, path.shape), path, ends)
    return OverGround(
        home_ground_m=float(scenario.terrain.height_m(home)),
        clearance_m=clearance_of(scenario),
        way_home_m=float((lowest - between).min()),
    )
