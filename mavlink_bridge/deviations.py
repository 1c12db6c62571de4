"""Detect that a vehicle which flies its plan is not where the plan has it: its altitude, and a home that moves. Pure.

Slip, the horizontal distance, is reported slot by slot (`keeper`). Altitude is reported when it is wrong for a while,
and again when it is right. Altitudes of a mission count from the vehicle's home: one that moves in flight
(HOME_POSITION, 242) moves the whole mission up or down, and the place where a return ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.mavlink_bridge.conditions import Lasting
from skyfolio.planner.geodesy import geodetic_to_east_north
from skyfolio.planner.scenario import Origin

OFF_M, BACK_M = 5.0, 2.0
"""Altitude is off beyond the first, and right again within the second."""
LASTS_S = 3.0
"""Fleet seconds for which it has to last: gusts and GPS steps are shorter."""
SETTLE_S = 5.0
"""Fleet seconds before altitude is judged: a new mission may ask for another one."""
HOME_M = 3.0
"""GPS wanders by less than this; a home that moves further was set anew."""


@dataclass(frozen=True, slots=True)
class AltitudeOffPlan:
    """It is `off_m` above (below: negative) the plan's altitude. `off`: whether that is wrong, or right again."""

    off: bool
    off_m: float


@dataclass(frozen=True, slots=True)
class HomeMoved:
    """Its home is `moved_m` over ground and `up_m` away from where it was at the start of the flight, or moved last."""

    moved_m: float
    up_m: float


Deviation = AltitudeOffPlan | HomeMoved


class AltitudeWatch:
    """Judges the altitude of one vehicle against those of its mission. slot_s: fleet seconds of each of its slots."""

    def __init__(self, altitudes: Altitudes, slot_s: float) -> None:
        self._altitudes, self._slot_s = altitudes, slot_s
        self._since_s: float | None = None
        self._off = Lasting(LASTS_S, LASTS_S)

    def look(self, now_s: float, relative_alt_m: float, amsl_m: float) -> AltitudeOffPlan | None:
        """Return what changed, if anything. Call it only while the vehicle flies the plan.

        now_s: fleet seconds since slot 0 of the mission. relative_alt_m, amsl_m: above home and above mean sea level.
        """
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._since_s < SETTLE_S:
            return None
        off_m = (amsl_m if self._altitudes.amsl else relative_alt_m) - self._altitudes.at(now_s / self._slot_s)
        before = self._off.on
        after = self._off.update(abs(off_m) > (BACK_M if before else OFF_M), now_s)
        return None if after == before else AltitudeOffPlan(after, round(off_m, 1))


class HomeWatch:
    """Remembers the home of one vehicle."""

    def __init__(self) -> None:
        self._home: tuple[float, float, float | None] | None = None

    def look(self, home_deg: tuple[float, float] | None, amsl_m: float | None) -> HomeMoved | None:
        """Return how its home has moved since the last report, None if it has not.

        home_deg: latitude and longitude. amsl_m: metres above mean sea level.
        """
        if home_deg is None:
            return None
        before = self._home
        if before is None:
            self._home = (*home_deg, amsl_m)
            return None
        if before[:2] == home_deg and before[2] == amsl_m:
            return None
        moved_m = hypot(*geodetic_to_east_north(Origin(lat_deg=before[0], lon_deg=before[1]), *home_deg))
        up_m = 0.0 if amsl_m is None or before[2] is None else amsl_m - before[2]
        if max(moved_m, abs(up_m)) <= HOME_M:
            return None
        self._home = (*home_deg, amsl_m)
        return HomeMoved(round(moved_m, 1), round(up_m, 1))
