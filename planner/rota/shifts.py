"""What a rota is made from, the pool of vehicles as it is now, and what it is made of: shifts.

All times are seconds from now. A vehicle cycles through: ready on its pad, outbound, on station, inbound, turnaround.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from skyfolio.planner.parts import Frozen, Identifier

Seconds = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=1e7)]
Moment = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e7, le=1e7)]
State = Literal["ready", "outbound", "on_station", "inbound", "turnaround"]


class Sortie(Frozen):
    """What one flight of a vehicle to a station takes, from a full battery, proven (`stays.py` reckons it).

    out_s: from leaving the pad until it is on station. stay_s: how long it can stay and still land with its reserve;
    out_s and back_s do not count. back_s: from leaving the station until it has landed.
    """

    out_s: Seconds
    stay_s: Seconds
    back_s: Seconds


class PoolVehicle(Frozen):
    """A vehicle of the pool, as it is now; one that is out of service is not in the pool.

    sorties: by station; a station that it cannot serve is not among them. ready: on its pad. outbound, on_station:
    bound for, or at, `station`, where it is `from_s` (negative: since then) and can stay until `until_s`. inbound:
    lands at `lands_s` (0: it waits for the crew), and is then turned around. turnaround: ready at `ready_s`.
    """

    id: Identifier
    sorties: dict[Identifier, Sortie]
    state: State = "ready"
    station: Identifier | None = None
    from_s: Moment | None = None
    until_s: Moment | None = None
    lands_s: Seconds | None = None
    ready_s: Seconds | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        flying = self.state in {"outbound", "on_station"}
        wanted = {
            "station": flying,
            "from_s": flying,
            "until_s": flying,
            "lands_s": self.state == "inbound",
            "ready_s": self.state == "turnaround",
        }
        for field, needed in wanted.items():
            if (getattr(self, field) is not None) != needed:
                raise ValueError(f"{field}: a vehicle that is {self.state} {'needs one' if needed else 'has none'}")
        if flying and self.station not in self.sorties:
            raise ValueError(f"station: {self.id!r} has no sortie to {self.station!r}")
        if self.from_s is not None and self.until_s is not None and self.until_s < self.from_s:
            raise ValueError(f"until_s: {self.until_s} must not be before from_s, {self.from_s}")
        return self


class Turnaround(Frozen):
    """What happens between landing and the next flight, and how stations change hands.

    seconds: to swap a battery. at_once: how many vehicles are turned around at the same time (crew, or pads), null for
    any number. overlap_s: for how long both are at the station when one relieves another. lead_s: how long from now
    until a vehicle that is ready can leave its pad at the earliest.
    """

    seconds: Seconds
    at_once: Annotated[int, Field(strict=True, ge=1, le=10_000)] | None = None
    overlap_s: Seconds = 0.0
    lead_s: Seconds = 0.0


class Shift(Frozen):
    """One stay of a vehicle at a station.

    leaves_pad_s, from_s, until_s, lands_s: when it leaves its pad, is on station, leaves it, has landed. turned_s,
    ready_s: when its turnaround begins, and ends. under_way: it has left its pad by now, so its beginning is a fact.
    cut: it goes on beyond the end of the rota.
    """

    vehicle: Identifier
    station: Identifier
    leaves_pad_s: Moment
    from_s: Moment
    until_s: Moment
    lands_s: Moment
    turned_s: Moment
    ready_s: Moment
    under_way: bool = False
    cut: bool = False


class Dark(Frozen):
    """A station that is not manned, in seconds from now."""

    station: Identifier
    from_s: Moment
    until_s: Moment


class Grounded(Frozen):
    """When a vehicle that is inbound now is turned around, and ready."""

    vehicle: Identifier
    turned_s: Moment
    ready_s: Moment


class Rota(Frozen):
    """Who relieves whom and when, until `horizon_s`.

    shifts: by station in order of time. grounded: of vehicles that are inbound now. dark: when a station is not manned,
    from now on. manned_share: of all stations' time. optimal: whether it is proven that no other rota until then has
    more manned time. least_fleet: fewer vehicles cannot keep all stations manned for ever (`bound.py`); null where no
    number can.
    """

    horizon_s: Seconds
    stations: tuple[Identifier, ...]
    shifts: tuple[Shift, ...]
    grounded: tuple[Grounded, ...]
    dark: tuple[Dark, ...]
    manned_share: float
    optimal: bool
    least_fleet: int | None

    def of_station(self, station: str) -> tuple[Shift, ...]:
        """Return the shifts at one station in order of time."""
        return tuple(shift for shift in self.shifts if shift.station == station)

    def reliefs(self) -> tuple[tuple[Shift, Shift], ...]:
        """Return each relief as who is relieved and who relieves, in order of time."""
        rows = [self.of_station(station) for station in self.stations]
        pairs = [pair for row in rows for pair in pairwise(row) if pair[1].from_s <= pair[0].until_s]
        return tuple(sorted(pairs, key=lambda pair: (pair[1].from_s, pair[1].station)))


def gaps(stays: Iterable[tuple[float, float]], horizon_s: float) -> list[tuple[float, float]]:
    """Return when no vehicle is there between 0 and the horizon, given from when to when each is."""
    free, at = [], 0.0
    for begin, end in sorted(stays):
        if begin > at:
            free.append((at, min(begin, horizon_s)))
        at = max(at, end)
    if at < horizon_s:
        free.append((at, horizon_s))
    return [(begin, end) for begin, end in free if begin < end]
