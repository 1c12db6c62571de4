"""The scenario: which UAVs fly, which users they serve, over which area, and for how long.

Positions are east/north metres from `Scenario.origin`; altitude is metres above each vehicle's own home, or above the
ground where there is terrain (`altitudes.py`).
Every rule is checked when the object is created, and the message names the field, its value and the rule.
Where a field ends in `_m`, its twin in `_deg` may be given instead, in degrees: a scenario keeps both (`places.py`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations
from math import dist, nan
from operator import not_
from typing import Annotated, Any, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from skyfolio.planner.altitudes import Altitude, limits_of, require_altitudes
from skyfolio.planner.as_geojson import raw_scenario
from skyfolio.planner.channels.kinds import AnyChannel
from skyfolio.planner.channels.radio import Fading, RadioChannel
from skyfolio.planner.channels.rician import Channel
from skyfolio.planner.corrections import kept, require_known
from skyfolio.planner.energy.air import Air, air_of
from skyfolio.planner.energy.heights import home_heights
from skyfolio.planner.energy.parts import Battery, RallyPoint, Rotors, Wind
from skyfolio.planner.energy.rules import require_flyable
from skyfolio.planner.fleet import Hertz, Uav, Watts
from skyfolio.planner.no_fly import NoFlyDisc, NoFlyPolygon, NoFlyZone, zone_holds
from skyfolio.planner.parts import (
    MAX_VERTICES,
    BitsPerSecond,
    Coordinate,
    Frozen,
    Identifier,
    Origin,
    Point,
    PositionDeg,
    either,
    in_degrees,
    left_out,
    without_stale_degrees,
)
from skyfolio.planner.places import Twin, require_agreement, require_closed_off, with_metres
from skyfolio.planner.terrain import Terrain
from skyfolio.planner.users import User, require_tracks
from skyfolio.planner.utilities import UtilityName

__all__ = [
    "Altitude",
    "Battery",
    "BitsPerSecond",
    "Channel",
    "Coordinate",
    "Fading",
    "Frozen",
    "Hertz",
    "Identifier",
    "NoFlyDisc",
    "NoFlyPolygon",
    "NoFlyZone",
    "Origin",
    "Point",
    "PositionDeg",
    "RallyPoint",
    "Rotors",
    "Scenario",
    "Uav",
    "User",
    "Utility",
    "Watts",
    "Wind",
    "zone_holds",
]

REACH_ROUNDING_M = 1e-10
"""An end position this little further away than a UAV can fly is in reach: what adding up its steps is off by."""


class Utility(Frozen):
    """What is maximised. `mu_per_kbps` = -2 beta in 1/(kbit/s): 0 is pure sum rate, more negative is steadier.

    `exclude_fixed_slots` leaves slot 0, whose positions cannot be chosen, out of the expectation: at large |mu| it
    would make every slot that is better than it worthless.
    """

    kind: UtilityName = "sum"
    mu_per_kbps: Annotated[float, Field(strict=True, allow_inf_nan=False, le=0, ge=-1e6)] = 0.0
    exclude_fixed_slots: bool = False


class Scenario(Frozen):
    """A planning problem, constraints (6a)-(6g) of the letter.

    `D_max` of eq. (6d) is `max_speed_mps * slot_duration_s` of each UAV; `D_min` of eq. (6e) is `min_separation_m`.
    `area_deg` is two corners, south-west and north-east, or a polygon. What UAVs may use is `area_m`: inside the
    corners, or around the polygon, where no-fly zones close off what is outside of it. Without an origin, one is chosen
    amid all places that are given in degrees.
    """

    model_config = ConfigDict(json_schema_extra=either(("area_m", "origin"), ("area_deg",)))

    origin: Origin
    area_m: tuple[Point, Point]
    slots: Annotated[int, Field(strict=True, ge=1, le=100_000)]
    slot_duration_s: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=3600)]
    altitude_m: Altitude
    min_separation_m: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=10_000)]
    uavs: Annotated[tuple[Uav, ...], Field(min_length=1)]
    users: Annotated[tuple[User, ...], Field(min_length=1)]
    channel: AnyChannel = Channel()
    utility: Utility = Utility()
    no_fly: Annotated[tuple[NoFlyZone, ...], Field(max_length=100)] = ()
    wind: Wind | None = left_out("The wind while it lasts; without it, the air is still.")
    rally_points: Annotated[tuple[RallyPoint, ...], Field(max_length=100, exclude_if=not_)] = ()
    area_deg: Annotated[tuple[PositionDeg, ...], Field(min_length=2, max_length=MAX_VERTICES)] | None = in_degrees(
        "Corners south-west and north-east, or a polygon, degrees; may be given instead of `area_m`."
    )
    terrain: Terrain | None = left_out("Ground heights; then altitudes of plans are above mean sea level.")
    clearance_m: Altitude | None = left_out(
        "What is kept over the terrain on every leg and way home, metres; default 30."
    )
    altitude_min_m: Altitude | None = left_out("The least altitude that a plan may choose, metres above the ground.")
    altitude_max_m: Altitude | None = left_out("The greatest altitude that a plan may choose, metres above the ground.")

    @model_validator(mode="before")
    @classmethod
    def _in_metres(cls, given: Any) -> Any:
        return with_metres(given)

    @model_validator(mode="after")
    def _check(self) -> Self:
        (west, south), (east, north) = self.area_m
        if not (west < east and south < north):
            raise ValueError(
                f"area_m: {self.area_m} must be [[west, south], [east, north]] with west < east and south < north"
            )
        self._check_degrees()
        require_altitudes(self)
        self._check_heights()
        _require_unique("uavs", [uav.id for uav in self.uavs])
        _require_unique("users", [user.id for user in self.users])
        require_tracks(self.users, self.slots, self.slot_duration_s)
        require_known(self.channel.corrections_db, {*self.uav_ids}, {*self.user_ids})
        for index, uav in enumerate(self.uavs):
            self._check_point(f"uavs.{index}.start_m", uav.start_m, uav.id)
            if uav.end_m is not None:
                self._check_point(f"uavs.{index}.end_m", uav.end_m, uav.id)
                self._check_reachable(index, uav)
        if all(self.last_slot(uav) < self.slots - 1 for uav in self.uavs):
            raise ValueError("uavs: leaves_at_slot takes every UAV away before the last slot; one must stay to the end")
        for a, b in combinations(self.uavs, 2):
            self._check_apart("start_m", a, b, a.start_m, b.start_m)
            if a.end_m is not None and b.end_m is not None and self.last_slot(a) == self.last_slot(b):
                self._check_apart("end_m", a, b, a.end_m, b.end_m)
        self._check_air()
        return self

    def _check_heights(self) -> None:
        uncovered = self.channel.refusal_of_area(self.area_m)
        if uncovered is not None:
            raise ValueError(f"channel.{uncovered}")
        for index, uav in enumerate(self.uavs):
            limits = limits_of(self, uav)
            high_m = limits.low_m if limits.high_m is None else limits.high_m
            refusal = self.channel.refusal_of_heights(limits.low_m, high_m)
            if refusal is not None:
                raise ValueError(
                    f"channel.kind: {refusal}, not for {limits.low_m:g} to {high_m:g} m of uavs.{index} '{uav.id}'"
                )

    def _check_air(self) -> None:
        air = self.air
        if air is not None:
            free = (nan, nan)
            starts, ends = np.array([[uav.start_m, uav.end_m or free] for uav in self.uavs], dtype=float).swapaxes(0, 1)
            require_flyable(self.uav_ids, air, starts, ends, [self.last_slot(uav) for uav in self.uavs])

    def _check_degrees(self) -> None:
        twins = [
            *(Twin(f"users.{k}.position", user.position_m, user.position_deg) for k, user in enumerate(self.users)),
            *(Twin(f"users.{k}.positions", user.positions_m, user.positions_deg) for k, user in enumerate(self.users)),
            *(Twin(f"uavs.{u}.start", uav.start_m, uav.start_deg) for u, uav in enumerate(self.uavs)),
            *(Twin(f"uavs.{u}.end", uav.end_m, uav.end_deg) for u, uav in enumerate(self.uavs)),
            *(Twin(f"uavs.{u}.home", uav.home_m, uav.home_deg) for u, uav in enumerate(self.uavs)),
            *(
                Twin(f"rally_points.{r}.position", p.position_m, p.position_deg)
                for r, p in enumerate(self.rally_points)
            ),
            *(
                Twin(f"no_fly.{z}.center", zone.center_m, zone.center_deg)
                if isinstance(zone, NoFlyDisc)
                else Twin(f"no_fly.{z}.vertices", zone.vertices_m, zone.vertices_deg)
                for z, zone in enumerate(self.no_fly)
            ),
        ]
        require_agreement(self.origin, twins)
        if self.area_deg is not None:
            outlines = [zone.vertices_m for zone in self.no_fly if isinstance(zone, NoFlyPolygon)]
            require_closed_off(self.origin, self.area_deg, self.area_m, outlines)

    def _check_point(self, field: str, point: Point, uav: str) -> None:
        (west, south), (east, north) = self.area_m
        if not (west <= point[0] <= east and south <= point[1] <= north):
            raise ValueError(f"{field}: {point} of '{uav}' lies outside area_m {self.area_m}")
        for number, zone in enumerate(self.no_fly):
            if zone_holds(zone, point):
                raise ValueError(f"{field}: {point} of '{uav}' lies inside no_fly.{number}")

    def _check_reachable(self, index: int, uav: Uav) -> None:
        assert uav.end_m is not None  # noqa: S101 - the caller has looked
        reach = uav.max_speed_mps * self.slot_duration_s * self.last_slot(uav)
        away = dist(uav.start_m, uav.end_m)
        if away > reach + REACH_ROUNDING_M:
            raise ValueError(
                f"uavs.{index}.end_m: {uav.end_m} of '{uav.id}' is {away:.6g} m from its start, but it can fly only "
                f"{reach:.6g} m until its last slot (eq. 6d)"
            )

    def _check_apart(self, field: str, a: Uav, b: Uav, at_a: Point, at_b: Point) -> None:
        apart = dist(at_a, at_b)
        if apart < self.min_separation_m:
            raise ValueError(
                f"uavs: {field} of '{a.id}' and '{b.id}' are {apart:.3g} m apart, closer than "
                f"min_separation_m {self.min_separation_m:g} (eq. 6e)"
            )

    def uav(self, uav_id: str) -> Uav:
        """Return the UAV of this id. Raises KeyError."""
        for uav in self.uavs:
            if uav.id == uav_id:
                return uav
        raise KeyError(uav_id)

    def altitude_of(self, uav: Uav) -> float:
        """Return the altitude of this UAV: its own `altitude_m`, or the fleet's.

        Metres above its own home; with terrain, what it keeps above the ground where nothing asks for more.
        """
        return self.altitude_m if uav.altitude_m is None else uav.altitude_m

    def last_slot(self, uav: Uav) -> int:
        """Return the last slot, counted from 0, in which this UAV flies."""
        return min(uav.leaves_at_slot or self.slots, self.slots) - 1

    @property
    def air(self) -> Air | None:
        """Wind and energy of the fleet, UAVs in planning order; None where the scenario has neither."""
        return self.air_for(self.uavs)

    def air_of(self, uav: Uav) -> Air | None:
        """Return wind and energy of one UAV; None where the scenario has neither."""
        return self.air_for([uav])

    @property
    def rally_m(self) -> tuple[Point, ...]:
        """Where UAVs may land instead of their homes, metres east/north; nowhere over terrain (`air_for`)."""
        return tuple(point.position_m for point in self.rally_points) if self.terrain is None else ()

    def air_for(self, uavs: Sequence[Uav]) -> Air | None:
        """Return wind and energy of these UAVs over this ground; None where there is neither.

        Over terrain they land at home only: no other way down is planned to be clear of the ground.
        """
        if self.wind is None and all(uav.battery is None for uav in uavs):
            return None
        rally = self.rally_points if self.rally_m else ()
        return air_of(uavs, home_heights(self, uavs), self.wind, rally, self.slot_duration_s)

    def longest_step_m(self, uav_id: str, move_m: tuple[float, float]) -> float:
        """Return how far a UAV flies in one slot in the direction of a move, metres: `D_max`, or less in wind."""
        uav = self.uav(uav_id)
        air = self.air_of(uav) if self.wind else None
        limit = uav.max_speed_mps * self.slot_duration_s
        return limit if air is None else float(air.longest_m(np.array([move_m], dtype=float))[0])

    @property
    def uav_ids(self) -> tuple[str, ...]:
        """Ids in planning order: axis 0 of every (n_uavs, ...) array."""
        return tuple(uav.id for uav in self.uavs)

    @property
    def user_ids(self) -> tuple[str, ...]:
        """Ids in planning order: the user axis of every array."""
        return tuple(user.id for user in self.users)

    @classmethod
    def from_geojson(cls, document: Mapping[str, Any] | str, **settings: Any) -> Self:
        """Return the scenario that a GeoJSON document, parsed or as text, describes (`as_geojson.py`).

        settings: fields of the scenario that are no place, such as `slots`; they count more than the document's.
        Raises ValueError that names the feature, and pydantic's error of fields.
        """
        return cls.model_validate(raw_scenario(document, settings))

    def with_changes(self, **changes: Any) -> Self:
        """Return a validated copy with some fields replaced; a new value may be a document, as in JSON."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        if "no_fly" in changes:  # zones close off what is outside of a polygon
            changes = {"area_deg": None, **changes}
        fields |= without_stale_degrees(type(self), changes)
        channel = fields["channel"]
        if isinstance(channel, RadioChannel) and channel.corrections_db and {"uavs", "users"} & changes.keys():
            links = kept(channel.corrections_db, *({one.id for one in fields[name]} for name in ("uavs", "users")))
            fields["channel"] = channel.model_copy(update={"corrections_db": links})
        return type(self)(**fields)


def _require_unique(field: str, ids: list[str]) -> None:
    twice = sorted(one for one, times in Counter(ids).items() if times > 1)
    if twice:
        raise ValueError(f"{field}: ids must be unique; {', '.join(map(repr, twice))} occurs more than once")
