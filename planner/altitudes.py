"""When altitudes are part of a plan, between which limits, and the rules of a scenario about them.

Without terrain and without limits every UAV keeps its `altitude_m` above its own home, and plans have no altitudes.
Otherwise a plan gives the altitude of each UAV in each slot: with terrain in metres above mean sea level, the one datum
of all UAVs wherever they took off; without, in metres above home. Limits are heights above the highest ground under the
legs that meet in a slot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple, Protocol

from pydantic import Field

from skyfolio.planner.parts import Point
from skyfolio.planner.terrain import Terrain

CLEARANCE_M = 30.0
"""Kept over ground where a scenario with terrain does not say."""
CLIMB_MPS = 1.5
"""How fast a UAV climbs and descends where a scenario does not say: both common autopilots do with their defaults."""

Altitude = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.1, le=20_000)]
"""Metres above home or ground."""
LOWEST_M, HIGHEST_M = -500, 30_000
Amsl = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=LOWEST_M, le=HIGHEST_M)]
"""Metres above mean sea level."""
ClimbRate = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=50)]


class Limited(Protocol):
    """What a scenario and a UAV say alike of altitudes."""

    @property
    def altitude_min_m(self) -> float | None:
        """The least altitude to choose from."""

    @property
    def altitude_max_m(self) -> float | None:
        """The greatest altitude to choose from."""


class LimitedUav(Limited, Protocol):
    """What a UAV says of its altitudes."""

    @property
    def id(self) -> str:
        """Its name."""

    @property
    def altitude_m(self) -> float | None:
        """Its own altitude."""

    @property
    def start_altitude_m(self) -> float | None:
        """How high it flies already."""

    @property
    def max_climb_mps(self) -> float | None:
        """How fast it climbs and descends."""


class LimitedFleet(Limited, Protocol):
    """What a scenario says of altitudes and ground."""

    @property
    def altitude_m(self) -> float:
        """The altitude of UAVs that have none of their own."""

    @property
    def clearance_m(self) -> float | None:
        """What is kept over the terrain."""

    @property
    def terrain(self) -> Terrain | None:
        """The ground."""

    @property
    def area_m(self) -> tuple[Point, Point]:
        """Where UAVs fly."""

    @property
    def uavs(self) -> Sequence[LimitedUav]:
        """The UAVs."""


class AltitudeLimits(NamedTuple):
    """The least and the greatest height of a UAV above the highest ground under its legs, metres.

    With both alike it follows the ground, as low as that allows.
    """

    low_m: float
    high_m: float | None


def plans_altitudes(scenario: LimitedFleet) -> bool:
    """Return whether plans of this scenario have altitudes."""
    return scenario.terrain is not None or any(limits_of(scenario, uav).high_m is not None for uav in scenario.uavs)


def limits_of(scenario: LimitedFleet, uav: LimitedUav) -> AltitudeLimits:
    """Return the limits of a UAV, its own before the fleet's; no upper one where none of both is given.

    Without an upper limit nothing is to be decided: it flies as low as ground, ways home and its climb rate allow.
    """
    low = scenario.altitude_min_m if uav.altitude_min_m is None else uav.altitude_min_m
    high = scenario.altitude_max_m if uav.altitude_max_m is None else uav.altitude_max_m
    wanted = scenario.altitude_m if uav.altitude_m is None else uav.altitude_m
    if low is None and high is None:
        return AltitudeLimits(wanted, None)
    return AltitudeLimits(wanted if low is None else low, wanted if high is None else high)


def climb_mps(uav: LimitedUav) -> float:
    """Return how fast a UAV climbs and descends, m/s."""
    return CLIMB_MPS if uav.max_climb_mps is None else uav.max_climb_mps


def clearance_of(scenario: LimitedFleet) -> float:
    """Return the metres that are kept over ground everywhere; 0 without terrain."""
    if scenario.terrain is None:
        return 0.0
    return CLEARANCE_M if scenario.clearance_m is None else scenario.clearance_m


def require_altitudes(scenario: LimitedFleet) -> None:
    """Check terrain, clearance and limits. Raises ValueError that names field and rule."""
    for index, uav in enumerate(scenario.uavs):
        low, high = limits_of(scenario, uav)
        if high is not None and low > high:
            raise ValueError(
                f"uavs.{index}: the altitude of '{uav.id}' cannot lie between {low:g} m, the least, and {high:g} m, "
                "the greatest (altitude_min_m, altitude_max_m; altitude_m where one of them is not given)"
            )
        if low < clearance_of(scenario):
            raise ValueError(
                f"uavs.{index}: the least altitude of '{uav.id}', {low:g} m, must not be less than clearance_m "
                f"{clearance_of(scenario):g}"
            )
    wrong = next(_out_of_place(scenario), None)
    if wrong is not None:
        raise ValueError(wrong)


def _out_of_place(scenario: LimitedFleet) -> Iterator[str]:
    """Yield what is given though nothing asks for it, and terrain that is too small."""
    if scenario.terrain is None and scenario.clearance_m is not None:
        yield "clearance_m: it is kept over terrain, and there is none"
    decided = plans_altitudes(scenario)
    for index, uav in enumerate(scenario.uavs):
        if uav.start_altitude_m is not None and not decided:
            yield f"uavs.{index}.start_altitude_m: it needs terrain, or limits of altitudes"
    if scenario.terrain is not None:
        (west, south), (east, north) = scenario.area_m
        low, high = scenario.terrain.bounds_m
        if not (low[0] <= west and low[1] <= south and east <= high[0] and north <= high[1]):
            yield f"terrain: its heights, from {low} to {high} m, must cover area_m {scenario.area_m}"
