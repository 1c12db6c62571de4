"""Sped-up time that waits for whoever is late, so that no flight depends on how loaded the machine is.

At eight times real time an event loop that gets no turn for half a second misses four seconds of the fleet. `pace`
gives seconds in which that does not happen: they pass as on the wall while every participant keeps up, and as slowly as
a real fleet's while one is late. Whatever lives in this process takes its time from there: the service and the fleet,
and the timers of their event loops (`PacedLoop`, `paced`).
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.sim import ScaledClock

AHEAD_S = 0.3
"""Fleet seconds that may pass before a participant has its next turn."""
TURNS = 6
"""Turns of an event loop in that time: the machine has to be late by several before time waits."""
LOOK_S = 0.02
"""Seconds between two looks of a test at what it waits for."""
LOOKS_AHEAD_S = 1.0
"""Fleet seconds that may pass until a test looks again: it asks the service, which takes a while."""


class Pace:
    """Monotonic seconds of a fleet that lives `speedup` times as fast as real ones. From any thread.

    While the turn of a participant is overdue they pass `speedup` times more slowly, so that the fleet lives in real
    time: a delay costs it no more than it would cost a real one. `source`: wall seconds.
    """

    def __init__(self, speedup: float, *, source: Callable[[], float] = time.monotonic) -> None:
        self.speedup = speedup
        self._source = source
        self._lock = threading.Lock()
        self._wall_s = self._now_s = self._began_s = source()
        self._began_utc = time.time()
        self._until: dict[object, float] = {}
        self.waited_s = 0.0
        """Wall seconds that time has waited, so far."""

    def __call__(self) -> float:
        """Seconds now, from the wall's at the beginning; they never run backwards."""
        with self._lock:
            return self._advance()

    def _advance(self) -> float:
        wall_s = self._source()
        passed_s, self._wall_s = wall_s - self._wall_s, wall_s
        free_s = min(passed_s, max(0.0, min(self._until.values(), default=float("inf")) - self._now_s))
        late_s = passed_s - free_s
        self.waited_s += late_s
        self._now_s += free_s + late_s / max(self.speedup, 1.0)
        return self._now_s

    def utc(self) -> float:
        """UTC seconds that pass with these."""
        return self._began_utc + self() - self._began_s

    @contextmanager
    def participant(self, ahead_s: float = AHEAD_S) -> Iterator[Callable[[], None]]:
        """Time waits for the caller, from now to the end; what is given tells of each of its turns.

        ahead_s: fleet seconds that may pass from one turn to the next.
        """
        who = object()

        def turn() -> None:
            with self._lock:
                self._until[who] = self._advance() + ahead_s / self.speedup

        turn()
        try:
            yield turn
        finally:
            with self._lock:
                self._advance()
                del self._until[who]

    def every_s(self) -> float:
        """Seconds between two turns of an event loop."""
        return min(0.01, AHEAD_S / self.speedup / TURNS)

    def clock(self) -> FleetClock:
        """For a service: fleet seconds from now on."""
        return FleetClock(self.speedup, seconds=self, utc=self.utc)

    def fleet_clock(self) -> ScaledClock:
        """For a simulated fleet: fleet seconds from now on."""
        return ScaledClock(self.speedup, source=self)

    def until(
        self, is_so: Callable[[], object], what: Callable[[], str] | str = "not so in time", *, within_s: float = 90.0
    ) -> None:
        """Look until it is so. AssertionError after `within_s` seconds of this pace."""
        deadline_s = self() + within_s
        with self.participant(LOOKS_AHEAD_S) as turn:
            while not is_so():
                turn()
                if self() >= deadline_s:
                    raise AssertionError(what if isinstance(what, str) else what())
                time.sleep(min(LOOK_S, LOOKS_AHEAD_S / self.speedup / 4))


@cache
def pace(speedup: float) -> Pace:
    """The pace of everything in this process that lives so fast."""
    return Pace(speedup)


class PacedLoop(asyncio.SelectorEventLoop):
    """An event loop that takes part in a pace, and whose timers follow it."""

    def __init__(self, followed: Pace) -> None:
        self._pace = followed
        super().__init__()
        self._part = followed.participant()
        self._turn = self._part.__enter__()
        self._take_turn()

    def time(self) -> float:
        return self._pace()

    def close(self) -> None:
        if not self.is_closed():
            self._part.__exit__(None, None, None)
        super().close()

    def _take_turn(self) -> None:
        self._turn()
        self.call_later(self._pace.every_s(), self._take_turn)


def loop_options(speedup: float) -> dict[str, Callable[[], PacedLoop]]:
    """What makes anyio, and so `TestClient`, use such a loop."""
    return {"loop_factory": partial(PacedLoop, pace(speedup))}


@contextmanager
def paced(speedup: float) -> Iterator[Pace]:
    """The running loop takes part in a new pace meanwhile, and its timers follow it."""
    made, loop = Pace(speedup), asyncio.get_running_loop()
    with made.participant() as turn:
        again: asyncio.Handle = loop.call_soon(lambda: None)

        def take_turn() -> None:
            nonlocal again
            turn()
            again = loop.call_later(made.every_s(), take_turn)

        setattr(loop, "time", made)  # noqa: B010 - a method, for this loop alone
        again = loop.call_soon(take_turn)
        try:
            yield made
        finally:
            again.cancel()
            delattr(loop, "time")
