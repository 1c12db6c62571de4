"""The audit log: who requested which change, and who was refused.

Beyond some per minute, refusals of one kind and address are counted, not listed: an attacker must not fill the disk.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import insert

from skyfolio.api.common.surroundings import monotonic_s
from skyfolio.api.store import Database
from skyfolio.api.store.tables import audit as table

REFUSALS_A_MINUTE = 10
MOST_CLIENTS = 1_000
REFUSED = frozenset({401, 403, 421, 429})
_INSERT = insert(table)


@dataclass
class _Minute:
    """Refusals of one address since `began_s`."""

    began_s: float
    count: int = 0


class AuditLog:
    """Writes rows of the audit log. `now_s`: monotonic seconds."""

    def __init__(self, database: Database, *, now_s: Callable[[], float] = monotonic_s) -> None:
        self._database, self._now_s = database, now_s
        self._minutes: OrderedDict[str, _Minute] = OrderedDict()

    def write(self, row: dict[str, Any]) -> None:
        """Store one row, unless it is one refusal too many; the next row of that address counts what was left out."""
        if row["status"] in REFUSED:
            refused = self._refused(f"{row['client']} {row['status']}")
            if refused is None:
                return
            if refused:
                row = {**row, "path": f"(after {refused} more refusals) {row['path']}"[:256]}
        self._database.write_soon((_INSERT, row))

    def _refused(self, whose: str) -> int | None:
        """Count a refusal. Return how many were left out before this one, or None when it is left out itself."""
        now = self._now_s()
        minute = self._minutes.get(whose)
        left_out = 0
        if minute is None or now - minute.began_s >= 60.0:
            left_out = 0 if minute is None else max(minute.count - REFUSALS_A_MINUTE, 0)
            minute = self._minutes[whose] = _Minute(now)
        self._minutes.move_to_end(whose)
        while len(self._minutes) > MOST_CLIENTS:
            self._minutes.popitem(last=False)
        minute.count += 1
        return left_out if minute.count <= REFUSALS_A_MINUTE else None
