"""What users of a flight were measured to get, and what that says about the channel.

A slot in which a user was measured counts with the mean of its measurements; other slots count as the channel model has
them. From the SINR of the last slots the corrections of all links are learned (`planner.learning`).
"""

from __future__ import annotations

import asyncio
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, log2, log10
from statistics import median
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator
from sqlalchemy import insert, select

from skyfolio.api.common.errors import InvalidError
from skyfolio.api.flights.flight_timeline import FlightTimeline
from skyfolio.api.flights.track import Track
from skyfolio.api.store import Database
from skyfolio.api.store.tables import measurements as table
from skyfolio.planner import Observation, learned_corrections_db
from skyfolio.planner.corrections import correction_db

LEAST_DB, MOST_DB = -40.0, 100.0
"""What SINR are held to: no service, and more than any radio has."""
LEARN_SLOTS = 10
"""From the measurements of so many of the last slots the channel is learned."""
DIFFERENT_DB = 3.0
"""A plan made ahead of a loss is not used where a link has turned out to be so much better or worse."""
AHEAD_S = 1.0
"""Fleet seconds by which the clock of a base station may be ahead."""
_INSERT = insert(table)


class Measurement(BaseModel):
    """What one user got at one moment: bit/s, or the SINR in dB, or both.

    `uav_id`: which UAV was to serve it; `elapsed_s`: fleet seconds since slot 0. 0 bit/s says that it got nothing.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    uav_id: str = Field(max_length=64)
    user_id: str = Field(max_length=64)
    elapsed_s: float = Field(ge=0, le=1e9, allow_inf_nan=False)
    rate_bps: float | None = Field(default=None, ge=0, le=1e15, allow_inf_nan=False)
    sinr_db: float | None = Field(default=None, ge=-200, le=200, allow_inf_nan=False)

    @model_validator(mode="after")
    def _says_something(self) -> Measurement:
        if self.rate_bps is None and self.sinr_db is None:
            raise ValueError("rate_bps, sinr_db: one of them must be given")
        return self


@dataclass
class _Slot:
    """Measured in one slot: bit/s by user, and by link the moments and SINR."""

    rates_bps: dict[str, list[float]] = field(default_factory=dict)
    sinr_db: dict[tuple[str, str], list[tuple[float, float]]] = field(default_factory=dict)


class MeasuredRates:
    """The measurements of one flight.

    timeline: its clock, and by which plans users were served. track: where every UAV was. lost: returns since when
    each lost UAV is lost, fleet seconds.
    """

    def __init__(self, timeline: FlightTimeline, track: Track, lost: Callable[[], Mapping[str, float]]) -> None:
        self._timeline, self._track, self._lost = timeline, track, lost
        self._slots: dict[int, _Slot] = {}
        self._known: set[tuple[str, str, float]] = set()
        self._is_new = False
        self._first_slot = 0
        self.corrections_db: dict[str, dict[str, float]] | None = None
        """By UAV and user, by how much each link is better than the channel model says; None before it is known."""

    def __bool__(self) -> bool:
        return bool(self._known)

    @property
    def slots(self) -> dict[str, list[int]]:
        """Return in which slots each user that was ever measured was measured."""
        found: dict[str, list[int]] = {}
        for number in sorted(self._slots):
            for user in self._slots[number].rates_bps:
                found.setdefault(user, []).append(number)
        return found

    def rate_bps(self, user: str, slot: int) -> float | None:
        """Return the mean of what was measured of a user in a slot; None where nothing was."""
        rates = self._slots[slot].rates_bps.get(user) if slot in self._slots else None
        return sum(rates) / len(rates) if rates else None

    def over(
        self, modelled: Mapping[str, Sequence[float | None]], first_slot: int = 0
    ) -> Mapping[str, Sequence[float | None]]:
        """Return the rates, bit/s by user and slot, with those that were measured in the place of those modelled.

        first_slot: the slot of the operation with which the rows begin.
        """
        if not self._known:
            return modelled
        rows = {user: list(row) for user, row in modelled.items()}
        for number, slot in self._slots.items():
            for user, rates in slot.rates_bps.items():
                if 0 <= number - first_slot < len(rows[user]):
                    rows[user][number - first_slot] = sum(rates) / len(rates)
        return rows

    def forget_before(self, slot: int) -> None:
        """Forget what was measured in slots before this one of the operation, and take in no more of it."""
        self._first_slot = max(slot, self._first_slot)
        self._slots = {number: kept for number, kept in self._slots.items() if number >= slot}
        slot_s = self._timeline.slot_s
        self._known = {key for key in self._known if key[2] // slot_s >= slot}

    def check(self, measurements: Iterable[Measurement]) -> None:
        """Raise InvalidError, which names the measurement and the field, unless all are of this flight, and past."""
        scenario = self._timeline.first_plan.scenario
        uavs, users = {*self._timeline.uav_ids}, {*scenario.user_ids}
        now_s = self._timeline.now_s()
        for number, one in enumerate(measurements):
            where = f"measurements.{number}"
            if one.uav_id not in uavs:
                raise InvalidError(f"{where}.uav_id: {one.uav_id!r} is not a UAV of this operation")
            if one.user_id not in users:
                raise InvalidError(f"{where}.user_id: {one.user_id!r} is not a user of this operation")
            if one.elapsed_s > now_s + AHEAD_S:
                raise InvalidError(
                    f"{where}.elapsed_s: {one.elapsed_s:g} is in the future: {now_s:.2f} s have passed since slot 0"
                )

    def add(self, measurements: Iterable[Measurement]) -> list[Measurement]:
        """Take in measurements that were checked; return those that are new.

        One of the same link and moment as an earlier one is the same measurement, sent again.
        """
        new = []
        for one in measurements:
            key = (one.uav_id, one.user_id, one.elapsed_s)
            number = int(one.elapsed_s // self._timeline.slot_s)
            if key in self._known or not self._first_slot <= number < self._timeline.n_slots:
                continue
            self._known.add(key)
            self._is_new = True
            new.append(one)
            self._take_in(self._slots.setdefault(number, _Slot()), one)
        return new

    def _take_in(self, slot: _Slot, one: Measurement) -> None:
        hertz = self.allocated_hz(one.uav_id, one.user_id, one.elapsed_s)
        rate, sinr_db = one.rate_bps, one.sinr_db
        if rate is None and sinr_db is not None and hertz is not None:
            rate = hertz * log2(1.0 + 10 ** (sinr_db / 10))
        if sinr_db is None and rate is not None and hertz:
            sinr_db = _sinr_db(rate / hertz)
        if rate is not None:
            slot.rates_bps.setdefault(one.user_id, []).append(rate)
        if sinr_db is not None:
            held = min(max(sinr_db, LEAST_DB), MOST_DB)
            slot.sinr_db.setdefault((one.uav_id, one.user_id), []).append((one.elapsed_s, held))

    def allocated_hz(self, uav: str, user: str, at_s: float) -> float | None:
        """Return the band that a UAV was to give a user at that moment; None if another one was to serve it."""
        serving = self._timeline.serving
        plan = serving[max(bisect_right(serving, at_s, key=lambda entry: entry.from_s) - 1, 0)].plan
        n = min(max(int(at_s // self._timeline.slot_s) - plan.first_slot, 0), plan.scenario.slots - 1)
        if user not in plan.association or plan.association[user][n] != uav:
            return None
        return plan.bandwidth_hz[user][n]

    # -- what it says about the channel ---------------------------------------------------------------------------

    async def learn(self) -> bool:
        """Learn the corrections anew, beside the event loop, if there are new measurements; return whether it did."""
        if not self._is_new:
            return False
        self._is_new = False
        scenario, observations = self._timeline.first_plan.scenario, self._observations()
        self.corrections_db = await asyncio.to_thread(learned_corrections_db, scenario, observations)
        return True

    def differ_from(self, planned_db: Mapping[str, Mapping[str, float]]) -> bool:
        """Return whether a link is by DIFFERENT_DB better or worse than a plan with these corrections assumed."""
        return any(
            abs(db - correction_db(planned_db, uav, user)) > DIFFERENT_DB
            for uav, row in (self.corrections_db or {}).items()
            for user, db in row.items()
        )

    def _observations(self) -> list[Observation]:
        """Return one observation of each link and slot: the median of what was measured, of the last slots."""
        found = []
        for number in sorted(self._slots)[-LEARN_SLOTS:]:
            for (uav, user), measured in self._slots[number].sinr_db.items():
                at_s = median(at for at, _ in measured)
                where = self._heard_at(at_s)
                if uav in where:
                    sinr_db = median(value for _, value in measured)
                    found.append(Observation(user_id=user, uav_id=uav, sinr_db=sinr_db, slot=number, positions_m=where))
        return found

    def _heard_at(self, at_s: float) -> dict[str, Any]:
        """Return where every UAV that was not lost was at that moment, metres east/north."""
        if not len(self._track):
            return {}
        after = bisect_left(range(len(self._track)), at_s, key=self._track.at_s)
        _, where = self._track[min(after, len(self._track) - 1)]
        lost = self._lost()
        return {uav: place for uav, place in where.items() if at_s <= lost.get(uav, inf)}


class MeasurementStore:
    """The stored measurements of one operation."""

    def __init__(self, database: Database, operation_id: str) -> None:
        self._database, self._operation_id = database, operation_id

    def write(self, measurements: Collection[Measurement]) -> None:
        """Store measurements; they are held while the database does not answer."""
        if measurements:
            rows = [{"operation_id": self._operation_id, **one.model_dump()} for one in measurements]
            self._database.write_soon(*self._database.owned(self._operation_id), (_INSERT, rows), keep=True)

    async def read(self) -> list[Measurement]:
        """Return every measurement that is kept, in the order of their coming. Raises StoreError."""
        query = select(table).where(table.c.operation_id == self._operation_id).order_by(table.c.id)
        names = Measurement.model_fields
        return [Measurement(**{name: getattr(row, name) for name in names}) for row in await self._database.rows(query)]


def _sinr_db(efficiency: float) -> float:
    """Return the SINR that carries so many bit/s/Hz, dB."""
    if efficiency <= 0.0:
        return LEAST_DB
    if efficiency > MOST_DB / 10.0 * log2(10.0):
        return MOST_DB
    return 10.0 * log10(2.0**efficiency - 1.0) if efficiency > 1e-6 else LEAST_DB
