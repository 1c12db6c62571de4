"""What one of several services knows of the leases, and what it may do by that. Pure: each call carries the time.

A lease is a row: the operation, its owner, a fencing token that grows with every change of owner, and a beat that the
owner counts up. No clock is compared with another one. The owner counts from before it asked for a renewal: it may
send until `term_s` later. Anybody else counts from after it first saw a beat: if that is still the newest one
`term_s + margin_s` later, the owner has stopped sending, and the lease may be taken.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf

EVERYBODY = 0
"""The system id of a frame that addresses all vehicles."""
NOBODY = ""
"""The owner of a lease that a service has given up."""
DEAF_S = 5.0
"""Wall seconds for which a service by which none of the vehicles is heard leaves a lease to one by which some are."""


@dataclass(frozen=True, kw_only=True)
class Lease:
    """A row as one look found it. systems: the vehicles of the operation. renewed: whether that look renewed it.

    version: of the stored operation.
    """

    operation_id: str
    owner: str
    name: str
    token: int
    beat: int
    systems: frozenset[int]
    version: int = 0
    renewed: bool = False


@dataclass(kw_only=True)
class _Held:
    token: int
    systems: frozenset[int]
    began_s: float
    until_s: float


class LeaseBook:
    """The leases as this service (`me`) last saw them. Times are seconds of one clock that never stops.

    term_s: how long a lease is valid without a renewal. margin_s: how much longer others wait, for clocks that do not
    run equally fast.
    """

    def __init__(self, me: str, *, term_s: float, margin_s: float) -> None:
        self.me, self.term_s, self.margin_s = me, term_s, margin_s
        self._held: dict[str, _Held] = {}
        self._rows: Mapping[str, Lease] = {}
        self._seen: dict[str, tuple[tuple[str, int, int], float]] = {}
        self._looked_s = -inf

    # -- what was seen and done ---------------------------------------------------------------------------------------

    def take_in(self, rows: Iterable[Lease], began_s: float, ended_s: float) -> None:
        """Take in a look at all leases, which was begun and answered at these times."""
        self._rows = {row.operation_id: row for row in rows}
        self._looked_s = max(self._looked_s, began_s)
        for operation_id, held in self._held.items():
            row = self._rows.get(operation_id)
            if row is None or row.token != held.token or row.owner != self.me:
                if held.began_s < began_s:  # else it is newer than the look
                    held.until_s = -inf
            elif row.renewed:
                held.until_s = max(held.until_s, began_s + self.term_s)
        seen = {}
        for operation_id, row in self._rows.items():
            mark = (row.owner, row.token, row.beat)
            earlier = self._seen.get(operation_id)
            seen[operation_id] = earlier if earlier is not None and earlier[0] == mark else (mark, ended_s)
        self._seen = seen

    def hold(self, operation_id: str, token: int, systems: Iterable[int], began_s: float, ended_s: float) -> None:
        """Note that this service made or took a lease: it was asked for at `began_s`, and granted by `ended_s`."""
        self._held[operation_id] = _Held(
            token=token, systems=frozenset(systems), began_s=ended_s, until_s=began_s + self.term_s
        )

    def let_go(self, operation_id: str) -> None:
        """Note that this service no longer acts for an operation, whatever the row says."""
        self._held.pop(operation_id, None)

    def forget(self, operation_id: str) -> None:
        """Note that the row is deleted."""
        self._held.pop(operation_id, None)
        self._rows = {other: row for other, row in self._rows.items() if other != operation_id}

    def take_lapsed(self, now_s: float) -> list[str]:
        """Return the operations whose lease has run out, and let go of them."""
        lapsed = [operation_id for operation_id, held in self._held.items() if now_s >= held.until_s]
        for operation_id in lapsed:
            del self._held[operation_id]
        return lapsed

    def running_out(self, now_s: float, within_s: float) -> list[str]:
        """Return the operations whose lease, as it is, runs out within so many seconds."""
        return [operation_id for operation_id, held in self._held.items() if held.until_s - now_s < within_s]

    # -- what follows -------------------------------------------------------------------------------------------------

    @property
    def held(self) -> list[str]:
        """Return the operations that this service acts for."""
        return list(self._held)

    @property
    def rows(self) -> Mapping[str, Lease]:
        """Return the leases of the last look, by operation."""
        return self._rows

    def token(self, operation_id: str, now_s: float) -> int | None:
        """Return the fencing token under which this service acts; None if it does not, or its lease has run out."""
        held = self._held.get(operation_id)
        return None if held is None or now_s >= held.until_s else held.token

    def until_s(self, system_id: int) -> float:
        """Return until when this service may send to a vehicle as things are: -inf if another service has it.

        A vehicle that no service has may be sent to while it is known, by a look within a term, that no service has it.
        """
        for held in self._held.values():
            if system_id in held.systems:
                return held.until_s
        if any(system_id in row.systems for row in self._rows.values()):
            return -inf
        return self._looked_s + self.term_s

    def may_send(self, system_id: int, now_s: float) -> bool:
        """Return whether a frame may be sent to this vehicle now; to EVERYBODY: whether any frame may be sent."""
        if system_id == EVERYBODY:
            return now_s < self._looked_s + self.term_s or any(now_s < held.until_s for held in self._held.values())
        return now_s < self.until_s(system_id)

    def owner_of(self, operation_id: str) -> Lease | None:
        """Return the lease of an operation that another service acts for, or none; None if it is ours, or gone."""
        return None if operation_id in self._held else self._rows.get(operation_id)

    def having(self, system_id: int) -> Lease | None:
        """Return the lease by which another service has a vehicle, None if none has."""
        for row in self._rows.values():
            if system_id in row.systems and row.operation_id not in self._held:
                return row
        return None

    def takeable(self, now_s: float, deaf_to: Iterable[str] = ()) -> list[Lease]:
        """Return the leases whose owner is gone, for all that this service can see.

        deaf_to: operations of which no vehicle is heard by this service; it leaves them to others for DEAF_S longer.
        """
        deaf = frozenset(deaf_to)
        found = []
        for operation_id, row in self._rows.items():
            if operation_id in self._held:
                continue
            wait_s = 0.0 if row.owner == NOBODY else self.term_s + self.margin_s
            wait_s += DEAF_S if operation_id in deaf else 0.0
            if now_s >= self._seen[operation_id][1] + wait_s:
                found.append(row)
        return found
