"""What clients see of a pool: its vehicles, its stations, and the rota."""

from __future__ import annotations

from pydantic import BaseModel

from skyfolio.api.flights.endless.pool import MemberState
from skyfolio.planner.geometry import Point
from skyfolio.planner.rota.shifts import Rota


class MemberView(BaseModel):
    """One vehicle of the pool. `charge`: as it reports, 0 to 1."""

    state: MemberState
    station: str | None
    since_s: float
    because: str
    charge: float | None


class StationView(BaseModel):
    """One station: where it is, which UAV mans it, and since when none does."""

    place_m: Point
    manned_by: str | None
    dark_since_s: float | None


class ReliefView(BaseModel):
    """The pool of an operation, its stations, and the rota: seconds from `made_at_s`, fleet seconds since slot 0.

    `reliefs`: how many vehicles have taken over a station so far. `rota.least_fleet`: fewer vehicles cannot keep all
    stations manned; `rota.dark`: when stations will not be.
    """

    pool: dict[str, MemberView]
    stations: dict[str, StationView]
    reliefs: int
    rota: Rota | None
    made_at_s: float
