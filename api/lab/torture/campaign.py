"""Many drills on several cores, and the files of those that broke something."""

from __future__ import annotations

import gc
import json
import logging
import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, MutableMapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import structlog

from skyfolio.api.lab.torture.drill import Drill
from skyfolio.api.lab.torture.flight import Outcome, fly
from skyfolio.api.lab.torture.generator import drill_of
from skyfolio.api.lab.torture.shrink import smaller
from skyfolio.api.lab.torture.tally import Result, ResultFile

LONGEST_S = 120
"""Seconds of its process after which a drill hangs: virtual time no longer passes."""
HANGS = "a drill comes to its end"
UNLIKELY = "the ground itself works"


def campaign(
    seeds: Iterable[int], *, jobs: int, shrink: bool, results: ResultFile, told: Callable[[Result], None]
) -> None:
    """Fly the drill of each seed; `told` gets each result as it comes, once `results` has it."""
    settle_memory()
    try:
        for result in _results(seeds, jobs, shrink=shrink):
            results.add(result)
            told(result)
    finally:
        gc.unfreeze()


def _results(seeds: Iterable[int], jobs: int, *, shrink: bool) -> Iterator[Result]:
    if jobs == 1:
        with quiet():
            yield from (one(seed, shrink=shrink) for seed in seeds)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=begin_worker) as pool:
        yield from pool.map(_one_shrunk if shrink else one, seeds, chunksize=1)


def _one_shrunk(seed: int) -> Result:
    return one(seed, shrink=True)


def quieten() -> None:
    """Log nothing from now on: a drill provokes errors by the dozen, and invariants judge them."""
    structlog.configure(processors=[_drop])
    logging.disable(logging.CRITICAL)


def begin_worker() -> None:
    """Begin a process that flies drills."""
    quieten()
    settle_memory()


def settle_memory() -> None:
    """Leave what was loaded out of every later search for garbage: a drill makes much, and nothing of that."""
    gc.collect()
    gc.freeze()


def _drop(_logger: object, _method: str, _event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    raise structlog.DropEvent


@contextmanager
def quiet() -> Iterator[None]:
    """Log nothing meanwhile."""
    before, level = structlog.get_config(), logging.root.manager.disable
    quieten()
    try:
        yield
    finally:
        structlog.configure(**before)
        logging.disable(level)


def one(seed: int, *, shrink: bool = False) -> Result:
    """Fly the drill of one seed, in this process."""
    outcome = flown(drill_of(seed))
    small = None
    if outcome.broken and shrink:
        first = next(iter(outcome.broken))
        small = smaller(outcome.drill, lambda drill: first in flown(drill).broken)
    return Result(
        seed=seed,
        state=outcome.state,
        broken=outcome.broken,
        coverage=outcome.coverage,
        moments=outcome.moments,
        virtual_s=outcome.virtual_s,
        wall_s=outcome.wall_s,
        small=small or (outcome.drill if outcome.broken else None),
    )


def flown(drill: Drill, recording: Path | None = None) -> Outcome:
    """Fly a drill, `recording` as of `fly`; one that hangs or breaks the ground is an outcome as well."""
    try:
        with _at_most(LONGEST_S):
            return fly(drill, recording=recording)
    except _HangsError:
        broken = {HANGS: f"not within {LONGEST_S} seconds of computing"}
    except Exception as error:  # noqa: BLE001 - reported as what this drill has broken
        broken = {UNLIKELY: f"{type(error).__name__}: {error}"}
    return Outcome(drill=drill, broken=broken, state="none", coverage=Counter(), virtual_s=0.0, wall_s=0.0)


class _HangsError(KeyboardInterrupt):
    """Virtual time no longer passes. Nothing that catches exceptions may catch this one."""


@contextmanager
def _at_most(seconds: int) -> Iterator[None]:
    """End what hangs in the main thread once its process has computed for so many seconds."""

    def too_long(_number: int, _frame: object) -> None:
        raise _HangsError

    before = signal.signal(signal.SIGPROF, too_long)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def write_case(folder: Path, result: Result) -> Path:
    """Write a failing drill and what it breaks into a file that `read_case` reads; return its path."""
    assert result.small is not None  # noqa: S101 - it has failed
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"drill-{result.seed}.json"
    document = {"breaks": result.broken, "drill": result.small.model_dump(mode="json", exclude_defaults=True)}
    file.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return file


def read_case(file: Path) -> Drill:
    """Return the drill in a file. Raises ValueError or OSError."""
    return Drill.model_validate(json.loads(file.read_text(encoding="utf-8"))["drill"])
