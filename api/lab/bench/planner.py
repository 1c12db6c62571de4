"""`skyfolio bench planner`: runs parts, each in a process of its own, and keeps their figures together in one file.

A run replaces the parts that it measured and leaves the others (`figures.py`).
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Lock
from typing import TypeAlias

from skyfolio.api.lab.bench.best_known import improve
from skyfolio.api.lab.bench.effort import Effort
from skyfolio.api.lab.bench.figures import Row, load, save
from skyfolio.api.lab.bench.instances import text_of
from skyfolio.api.lab.bench.measure import cores, machine
from skyfolio.api.lab.bench.parts import SECTIONS, Part
from skyfolio.api.lab.bench.shares import values_of

Runner: TypeAlias = Callable[[Part, int], Row]
TIMEOUT_S = 7200.0


def measure(
    parts: Sequence[Part],
    effort: Effort,
    *,
    file: Path | None = None,
    best_known: Path | None = None,
    run: Runner | None = None,
    told: Callable[[str], None] = lambda _: None,
) -> Row:
    """Measure these parts and return all figures: those in `file` and the new ones, which are written there one by one.

    Two parts run at a time where there are two cores: those whose figures are times on one, the others on another.
    best_known: the file of best known values, improved when beaten. run: measures one part on a core; default: alone in
    a process of its own. told: called with progress.
    """
    run = run or (lambda part, core: in_a_process(part, core, effort))
    figures, lock, halted = load(file), Lock(), Event()

    def one_after_the_other(queue: Sequence[Part], core: int) -> None:
        for part in queue:
            if halted.is_set():
                return
            began = time.perf_counter()
            found = run(part, core)
            seconds = time.perf_counter() - began
            with lock:
                figures["parts"][part.name] = _described(found, effort, seconds)
                if file is not None:
                    save(figures, file)
                told(_told(part, found, seconds, _beaten(part, found, best_known)))

    lanes = _lanes(parts)
    with ThreadPoolExecutor(len(lanes)) as threads:
        running = [threads.submit(one_after_the_other, queue, core) for core, queue in lanes.items()]
        try:
            for lane in as_completed(running):
                lane.result()
        finally:  # after an interruption no lane begins another part
            halted.set()
    return figures


def _lanes(parts: Sequence[Part]) -> dict[int, list[Part]]:
    """Return by core what runs there, one part after the other; whatever is timed has a core for itself if it can."""
    timed, others = ([part for part in parts if SECTIONS[part.section].timed is timed] for timed in (True, False))
    *rest, last = cores()
    return {last: timed, rest[-1]: others} if rest else {last: list(parts)}


def _beaten(part: Part, found: Row, best_known: Path | None) -> list[str]:
    """Note values that beat what is known, and return of which instances."""
    if best_known is None:
        return []
    values = values_of(part.section, found.get("figures", {}))
    return [one.name for one in values if improve(one.name, one.utility_kbps, one.found_by, one.seconds, best_known)]


def _described(found: Row, effort: Effort, seconds: float) -> Row:
    at = datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
    return {"effort": effort.name, "at": at, "seconds": round(seconds, 1), "machine": machine(), **found}


def _told(part: Part, found: Row, seconds: float, better: Sequence[str]) -> str:
    beaten = f"; better than what was known: {', '.join(better)}" if better else ""
    return f"{part.name}: {found.get('skipped', 'measured')}, {seconds:.0f} s{beaten}"


def in_a_process(part: Part, core: int, effort: Effort) -> Row:
    """Return the figures of one part, or the reason why there are none. Raises KeyboardInterrupt as its process did."""
    command = [sys.executable, "-m", "skyfolio.api.lab.bench.child", part.section, text_of(part.size), part.kind]
    command += ["--effort", effort.name, "--core", str(core)]
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, capture_output=True, text=True, timeout=TIMEOUT_S, check=True, env={**os.environ, **one_thread}
        )
    except subprocess.TimeoutExpired:
        return {"skipped": f"not done after {TIMEOUT_S:.0f} s"}
    except subprocess.CalledProcessError as error:
        if error.returncode == -signal.SIGINT:
            raise KeyboardInterrupt from error
        return {"skipped": (error.stderr.strip().splitlines() or ["failed"])[-1]}
    found: Row = json.loads(done.stdout)
    return found
