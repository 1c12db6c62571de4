"""The leases of this service, where several share one database: renewed, lost and taken over."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Awaitable, Callable, Collection, Iterable
from dataclasses import dataclass
from math import inf

import structlog

from skyfolio.api.common.errors import ConflictError
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.surroundings import new_token
from skyfolio.api.store.errors import StoreError
from skyfolio.api.store.lease_book import Lease, LeaseBook
from skyfolio.api.store.lease_rows import FIRST_TOKEN, LeaseRows
from skyfolio.api.store.lease_table import LeaseTable
from skyfolio.api.store.writer import Statement

log = structlog.get_logger()
LOOKS_A_TERM = 10
"""How often a lease is renewed while it is valid: two or three looks may fail or be slow."""
MARGIN = 0.2
"""Share of the term for which others wait beyond it."""
WRONG_CLOCK_S = 0.5
"""Seconds between the clocks of a service and the database that readiness tells of. Leases depend on neither."""
LAST_SHARE = 0.5
"""Share of the term that is left when what needs us all the time is brought to an end: that takes a second."""
LAPSE_EVERY_S = 0.05
"""How often leases that have run out are looked for. What is sent to vehicles does not wait for that."""


def seconds() -> float:
    """Return seconds of this machine's clock that goes on while the process is stopped and the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


@dataclass(kw_only=True)
class Followers:
    """What is to be done when leases change hands.

    running_out: our lease of this operation is not renewed and soon runs out (called again and again). lost: it has
    run out. taken: we have taken over this operation; what it raises gives the lease
    up. renewed: our leases are valid for longer. is_heard: whether any of these vehicles is heard by this service.
    """

    running_out: Callable[[str], None] = lambda _operation_id: None
    lost: Callable[[str], None] = lambda _operation_id: None
    taken: Callable[[str], Awaitable[None]] | None = None
    renewed: Callable[[], None] = lambda: None
    is_heard: Callable[[Collection[int]], bool] = lambda _systems: True


class Leases:
    """Which operations this service acts for, and which vehicles it may send to.

    clock: seconds that never stop (`seconds`). `run` and `watch` are its tasks: the first asks the database, the
    second needs none.
    """

    def __init__(self, table: LeaseRows, *, term_s: float, clock: Callable[[], float] = seconds) -> None:
        self._table, self._clock = table, clock
        self.book = LeaseBook(table.me, term_s=term_s, margin_s=MARGIN * term_s)
        self.followers = Followers()
        self._taking: dict[str, asyncio.Task[None]] = {}
        self.trouble: str | None = None
        """Why the database did not answer the last look, None if it did."""

    @classmethod
    def of(cls, settings: Settings) -> Leases:
        """Return the leases of a service with these settings; its id is new in each process."""
        name = settings.service_name or f"{socket.gethostname()}:{settings.port}"
        term_s = settings.lease_s
        table = LeaseTable(settings.database_url, me=new_token(16), name=name[:64], timeout_s=term_s)
        return cls(table, term_s=term_s)

    @property
    def name(self) -> str:
        """Return what the operators call this service."""
        return self._table.name

    @property
    def state(self) -> str:
        """Return 'ok', 'ok: ' and what is to be known, or what is wrong."""
        if self.trouble is not None:
            return f"not renewed: {self.trouble}"[:200]
        ahead_s = self._table.clock_ahead_s
        if abs(ahead_s) < WRONG_CLOCK_S:
            return "ok"
        return (
            f"ok: this machine's clock is {abs(ahead_s):.1f} s {'ahead of' if ahead_s > 0 else 'behind'} the "
            "database's: slots would shift by that when an operation is taken over"
        )

    # -- tasks --------------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Look once, so that it is known who has what. Raises StoreError."""
        try:
            await self._table.adopt()
        except Exception as error:
            raise StoreError(f"leases: {error}") from error
        await self.look()

    async def run(self) -> None:
        """Renew and look until cancelled."""
        while True:
            began_s = self._clock()
            try:
                await self.look()
            except StoreError as error:
                if self.trouble is None:
                    log.warning("leases are not renewed", reason=str(error))
                self.trouble = str(error)
            await asyncio.sleep(max(0.01, self.book.term_s / LOOKS_A_TERM - (self._clock() - began_s)))

    async def watch(self) -> None:
        """Let go of what has run out, and take over what others have, until cancelled."""
        while True:
            now_s = self._clock()
            for operation_id in self.book.take_lapsed(now_s):
                log.critical("lease lost", operation_id=operation_id, reason=self.trouble or "taken over, or too late")
                self.followers.lost(operation_id)
            for operation_id in self.book.running_out(now_s, LAST_SHARE * self.book.term_s):
                self.followers.running_out(operation_id)
            if self.trouble is None and now_s < self.book.until_s(0):
                self._take_over(now_s)
            await asyncio.sleep(LAPSE_EVERY_S)

    async def close(self) -> None:
        """Give up all leases, once nothing is sent any more."""
        for task in self._taking.values():
            task.cancel()
        await asyncio.gather(*self._taking.values(), return_exceptions=True)
        try:
            await self._table.leave()
        except StoreError as error:
            log.warning("leases are not given up: others wait until they run out", reason=str(error))

    async def look(self) -> None:
        """Renew what this service holds, and take in every lease. Raises StoreError."""
        began_s = self._clock()
        rows = await self._table.look(self.book.held)
        self.book.take_in(rows, began_s, self._clock())
        self.trouble = None
        self.followers.renewed()

    def _take_over(self, now_s: float) -> None:
        if self.followers.taken is None:
            return
        deaf_to = [row.operation_id for row in self.book.rows.values() if not self.followers.is_heard(row.systems)]
        for lease in self.book.takeable(now_s, deaf_to):
            if lease.operation_id not in self._taking:
                task = asyncio.create_task(self._take(lease), name=f"take over {lease.operation_id}")
                self._taking[lease.operation_id] = task

    async def _take(self, lease: Lease) -> None:
        began_s, taken = self._clock(), self.followers.taken
        try:
            token = await self._table.take(lease)
            if token is None or taken is None:
                return
            self.book.hold(lease.operation_id, token, lease.systems, began_s, self._clock())
            await taken(lease.operation_id)
        except Exception:
            log.exception("not taken over", operation_id=lease.operation_id)
            self.book.let_go(lease.operation_id)
        finally:
            self._taking.pop(lease.operation_id, None)

    # -- what follows -------------------------------------------------------------------------------------------------

    def may_send(self, system_id: int) -> bool:
        """Return whether a frame may be sent to this vehicle now; 0: whether any may be sent at all."""
        return self.book.may_send(system_id, self._clock())

    def until_s(self, system_ids: Iterable[int]) -> float:
        """Return until which second of this machine's clock this service may send to all of these."""
        return min(map(self.book.until_s, system_ids), default=inf)

    def claim(self, operation_id: str, systems: Collection[int]) -> list[Statement]:
        """Return what stores the lease of a new operation together with it. Raises ConflictError."""
        for system_id in sorted(systems):
            lease = self.book.having(system_id)
            if lease is not None:
                where = f"operation {lease.operation_id} of service {lease.name!r}"
                raise ConflictError(f"vehicles: system {system_id} already flies {where}")
        return self._table.made(operation_id, systems)

    def claimed(self, operation_id: str, systems: Collection[int], began_s: float) -> None:
        """Act for a new operation from now on, whose lease was asked for at `began_s`, and is stored."""
        self.book.hold(operation_id, FIRST_TOKEN, systems, began_s, self._clock())

    async def wait_until_alone(self, claimed_s: float) -> None:
        """Return once no other service counts the vehicles as free that were claimed by that second."""
        while (left_s := claimed_s + self.book.term_s - self._clock()) > 0:  # noqa: ASYNC110
            await asyncio.sleep(left_s)

    def now_s(self) -> float:
        """Return the seconds of this machine's clock."""
        return self._clock()

    def require(self, operation_id: str) -> list[Statement]:
        """Return what begins the transactions of an operation: they are refused once another service has it."""
        token = self.book.token(operation_id, self._clock())
        return [self._table.required(operation_id, -1 if token is None else token)]

    def ended(self, operation_id: str) -> Statement:
        """Return what deletes the lease of an operation that is over."""
        return self._table.ended(operation_id)
