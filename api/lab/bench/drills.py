"""How much of a core a whole drill in virtual time takes, and which parts of the product it takes it for."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median
from types import FrameType
from typing import Any

from rich.table import Table

from skyfolio.api.flights.operation_views import State
from skyfolio.api.lab.torture.campaign import quiet, settle_memory
from skyfolio.api.lab.torture.drill import Blow, Drill, Moment
from skyfolio.api.lab.torture.flight import fly

SAMPLE_S = 0.002
"""CPU seconds between two looks at what runs."""
_KILL = Blow(when=Moment(state=State.FLYING, after_s=40.0), kind="vehicle", options={"kind": "kill", "system_id": 3})
DRILLS = {
    "3 UAVs, 20 slots": Drill(seed=2, slots=20),
    "3 UAVs, 20 slots, a loss": Drill(seed=2, slots=20, blows=(_KILL,)),
    "3 UAVs, 20 slots, streamed to": Drill(seed=2, slots=20, guidance="stream"),
}
PARTS = {
    "skyfolio.sim": "simulated vehicles",
    "skyfolio.mavlink_bridge": "bridge",
    "skyfolio.planner": "planner",
    "skyfolio.api.lab.torture": "what must hold",
    "skyfolio.api.lab.virtual.disk": "database",
    "skyfolio.api.lab.virtual.wire": "framing",
    "skyfolio.api.lab.virtual.codec": "framing",
    "skyfolio.api.lab.virtual": "event loop",
    "skyfolio.api.store": "database",
    "skyfolio.api": "service",
}
"""What the time of a module counts for, by the longest name that it begins with."""


def drill_figures(runs: int) -> dict[str, Any]:
    """Return CPU seconds (best and median of `runs`) and flown seconds for each drill, and the shares of the parts.

    The first run of each, which solves its plans, does not count. A busy machine takes more CPU seconds for the same
    work, because cores share caches and clocks: the best run is the one that was disturbed least.
    """
    figures: dict[str, Any] = {}
    shares: Counter[str] = Counter()
    with quiet():
        for name, drill in DRILLS.items():
            flown_s = fly(drill).virtual_s
            settle_memory()
            took_s = sorted(_cpu_s(drill) for _ in range(runs))
            with _sampled(shares):
                fly(drill)
            figures[name] = {
                "flown_s": round(flown_s, 1),
                "cpu_p50_s": round(median(took_s), 3),
                "cpu_best_s": round(took_s[0], 3),
                "times_real_time": round(flown_s / median(took_s)),
            }
    samples = sum(shares.values())
    return {"drills": figures, "parts": {part: round(count / samples, 3) for part, count in shares.most_common()}}


def _cpu_s(drill: Drill) -> float:
    began_s = time.process_time()
    fly(drill)
    return time.process_time() - began_s


@contextmanager
def _sampled(shares: Counter[str]) -> Iterator[None]:
    """Count, each SAMPLE_S of CPU time, the part that runs: the innermost of our own modules on the stack."""

    def look(_number: int, frame: FrameType | None) -> None:
        shares[_part_of(frame)] += 1

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_S, SAMPLE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _part_of(frame: FrameType | None) -> str:
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module.startswith("skyfolio."):
            return next((part for prefix, part in _LONGEST_FIRST if module.startswith(prefix)), "service")
        frame = frame.f_back
    return "event loop"


_LONGEST_FIRST = sorted(PARTS.items(), key=lambda entry: -len(entry[0]))


def tables(figures: dict[str, Any]) -> list[Table]:
    """Return the figures as tables for a terminal."""
    drills = Table("drill", "flown, s", "CPU p50, s", "CPU best, s", "times real time", title="Drills in virtual time")
    for name, row in figures["drills"].items():
        drills.add_row(name, *map(str, row.values()))
    parts = Table("part", "share of the time", title="Where the time goes")
    for part, share in figures["parts"].items():
        parts.add_row(part, f"{share:.0%}")
    return [drills, parts]
