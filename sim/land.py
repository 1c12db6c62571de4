"""The ground under a vehicle, where it is not level: what it stands on, lands on, and can fly into."""

from collections.abc import Callable
from typing import Protocol

from skyfolio.sim.geo import LocalFrame, Place


class Land(Protocol):
    """Ground heights around one vehicle."""

    def up_m(self, place: Place) -> float:
        """Return the ground at metres east and north of the spawn point, in metres above the ground there."""


class Level:
    """Level ground everywhere."""

    def up_m(self, place: Place) -> float:  # noqa: ARG002 - alike everywhere
        """Return 0."""
        return 0.0


class Hills:
    """Ground of any height. `amsl_m(lat_deg, lon_deg)` returns it in metres above mean sea level."""

    def __init__(self, amsl_m: Callable[[float, float], float]) -> None:
        self.amsl_m = amsl_m

    def around(self, frame: LocalFrame, home_alt_m: float) -> Land:
        """Return the ground as a vehicle has it that was put down at the origin of `frame`, at this height."""
        return _Around(self, frame, home_alt_m)


class _Around:
    def __init__(self, hills: Hills, frame: LocalFrame, home_alt_m: float) -> None:
        self._hills, self._frame, self._home_alt_m = hills, frame, home_alt_m

    def up_m(self, place: Place) -> float:
        return self._hills.amsl_m(*self._frame.to_geodetic(*place)) - self._home_alt_m
