"""Work for the workers of a test's cluster: as that of a sweep, and each case leaves a line in a file."""

import os
import time
from dataclasses import replace
from pathlib import Path

from skyfolio.api.lab.sweep.parts import Batch, compute, part_of

LOG = "SKYFOLIO_TEST_SWEEP_LOG"
CASE_S = 0.1
UNFINISHED = 50


def logged() -> list[int]:
    """The number of each case that any worker has finished, as often as it has."""
    file = Path(os.environ[LOG])
    return [int(line) for line in file.read_text().split()] if file.exists() else []


def waiting(batch: Batch) -> bytes:
    """Wait instead of planning: rows for measuring what is computed twice, on a machine that does other things."""
    rows = []
    for number, _ in enumerate(batch.cases, start=batch.first):
        time.sleep(CASE_S)
        _note(number)
        rows.append({"status": "succeeded", "utility_bps": float(number)})
    return part_of(batch, rows)


def unfinished(batch: Batch) -> bytes:
    """Wait as `waiting` does for some batches, and for good for all the others: nobody can be too late to stop it."""
    if batch.first >= UNFINISHED:
        time.sleep(3600)
    return waiting(batch)


def planned(batch: Batch) -> bytes:
    """Plan as a sweep does."""
    part = compute(batch)
    for number, _ in enumerate(batch.cases, start=batch.first):
        _note(number)
    return part


def broken(batch: Batch) -> bytes:
    """Fail for the first batch."""
    if batch.first == 0:
        raise ZeroDivisionError("for a test")
    return waiting(batch)


def deadly(batch: Batch) -> bytes:
    """Kill the worker for the first batch."""
    if batch.first == 0:
        os.abort()
    return waiting(batch)


def _note(number: int) -> None:
    with Path(os.environ[LOG]).open("a") as log:  # one short line: written at once, whole
        log.write(f"{number}\n")


def of_another_version(batch: Batch) -> bytes:
    """Plan as a worker does whose planner is not that of the process that asks."""
    return compute(replace(batch, planner="0.0.0-other"))
