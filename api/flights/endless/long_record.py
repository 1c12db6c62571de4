"""What is remembered of an operation without a fixed end: all of the newest slots, and less of those before.

In memory are places, rates, measurements and plans of the newest slots (`Horizon.kept_slots`). As a slot leaves that
window, what its users got is stored (`slot_rates`), its track is thinned to one sample in THINNED_S, and its
measurements and the plans that were made ahead of losses under plans that are no longer in force are deleted.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from sqlalchemy import BindParameter, bindparam, delete, func, insert, select
from sqlalchemy.dialects import postgresql, sqlite

from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.track import Seen
from skyfolio.api.store import Database
from skyfolio.api.store.tables import contingencies, measurements, slot_rates, track
from skyfolio.api.store.writer import Statement

STEP_SLOTS = 5
"""So many slots leave the window at once."""
THINNED_S = 5.0
"""Fleet seconds between the samples of a track that are kept for good."""
SlotRates = Mapping[str, float | None]
_OURS: BindParameter[str] = bindparam("operation_id_")
_FROM: BindParameter[float] = bindparam("from_s")
_TO: BindParameter[float] = bindparam("to_s")
_FORGET_TRACK = delete(track).where(track.c.operation_id == _OURS, track.c.elapsed_s >= _FROM, track.c.elapsed_s < _TO)
_FORGET_MEASUREMENTS = delete(measurements).where(
    measurements.c.operation_id == _OURS, measurements.c.elapsed_s >= _FROM, measurements.c.elapsed_s < _TO
)
_FORGET_AHEAD = delete(contingencies).where(contingencies.c.plan_id == bindparam("plan_id_"))
_TRACK = insert(track)


class LongRecord:
    """Moves one flight's window, and stores what leaves it."""

    def __init__(self, database: Database, operation_id: str, flight: Flight) -> None:
        self._database, self._id, self._flight = database, operation_id, flight

    def move(self) -> None:
        """Let the slots leave the window that are older than it, several at once."""
        horizon, slot = self._flight.horizon, self._flight.slot()
        if horizon is None or slot is None:
            return
        oldest = slot - horizon.kept_slots
        if oldest >= self._flight.rates_from_slot + STEP_SLOTS:
            self._forget_before(oldest)

    def end(self) -> None:
        """Store the rates that are still in memory: the operation is over."""
        if self._flight.horizon is not None:
            first = self._flight.rates_from_slot
            self._write(self._rates(first, self._flight.n_slots))

    async def stored_slots(self) -> int:
        """Return the first slot whose rates are not stored yet. Raises StoreError."""
        query = select(func.max(slot_rates.c.slot)).where(slot_rates.c.operation_id == self._id)
        newest = (await self._database.rows(query))[0][0]
        return 0 if newest is None else newest + 1

    def _forget_before(self, slot: int) -> None:
        flight, first = self._flight, self._flight.rates_from_slot
        from_s, to_s = first * flight.slot_s, slot * flight.slot_s
        rates = self._rates(first, slot)
        kept = thinned(flight.record.between(from_s, to_s))
        old_plans = flight.forget_before(slot)
        window = {"operation_id_": self._id, "from_s": from_s, "to_s": to_s}
        statements: list[Statement] = [(_FORGET_TRACK, window), (_FORGET_MEASUREMENTS, window)]
        if kept:
            rows = [
                {"operation_id": self._id, "elapsed_s": at_s, "positions": json.dumps(places)} for at_s, places in kept
            ]
            statements.append((_TRACK, rows))
        if old_plans:
            statements.append((_FORGET_AHEAD, [{"plan_id_": plan.id} for plan in old_plans]))
        self._write(rates, *statements)

    def _rates(self, first: int, end: int) -> list[dict[str, Any]]:
        """Return the rows of these slots, the first one on and before the other."""
        begin, by_user = self._flight.rates_from_slot, self._flight.reported_rates_bps()
        return [
            {
                "operation_id": self._id,
                "slot": slot,
                "rates_bps": json.dumps({user: row[slot - begin] for user, row in by_user.items()}),
            }
            for slot in range(first, end)
        ]

    def _write(self, rates: Sequence[dict[str, Any]], *statements: Statement) -> None:
        add = postgresql.insert if self._database.is_postgresql else sqlite.insert
        rows: list[Statement] = [(add(slot_rates).on_conflict_do_nothing(), [*rates])] if rates else []
        self._database.write_soon(*self._database.owned(self._id), *rows, *statements, keep=True)


async def stored_rates(
    database: Database, operation_id: str, from_slot: int, limit: int
) -> list[tuple[int, SlotRates]]:
    """Return what each user got, bit/s, in up to `limit` stored slots of an operation. Raises StoreError."""
    query = select(slot_rates.c.slot, slot_rates.c.rates_bps).where(
        slot_rates.c.operation_id == operation_id, slot_rates.c.slot >= from_slot
    )
    rows = await database.rows(query.order_by(slot_rates.c.slot).limit(limit))
    return [(row.slot, json.loads(row.rates_bps)) for row in rows]


def thinned(samples: Iterable[Seen], every_s: float = THINNED_S) -> list[Seen]:
    """Return the first sample of each `every_s` fleet seconds."""
    kept: list[Seen] = []
    for sample in samples:
        if not kept or sample[0] // every_s > kept[-1][0] // every_s:
            kept.append(sample)
    return kept
