"""Warm timings, quantiles, memory, and a description of the machine."""

from __future__ import annotations

import os
import platform
import resource
import sys
import time
from collections.abc import Callable, Sequence
from math import ceil
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")


def timed(
    call: Callable[[], Result], *, runs: int, budget_s: float, least: int = 3, warm: bool = True
) -> tuple[dict[str, Any], Result]:
    """Return p50 and p99 in milliseconds of up to `runs` calls, fewer (but `least`) once `budget_s` is spent.

    warm: one more call comes first that is not timed. `cpu_p50_ms` is processor time, which other programs on the
    machine do not lengthen; the budget is of processor time too, so that a busy machine measures as much.
    """
    if warm:
        call()
    spent: list[float] = []
    busy: list[float] = []
    while not spent or (len(spent) < runs and (len(spent) < least or sum(busy) < budget_s)):
        began, cpu = time.perf_counter(), time.process_time()
        result = call()
        busy.append(time.process_time() - cpu)
        spent.append(time.perf_counter() - began)
    p50, p99 = np.percentile(np.array(spent) * 1e3, [50, 99])
    figures = {"p50_ms": float(p50), "p99_ms": float(p99), "best_ms": min(spent) * 1e3}
    return figures | {"cpu_p50_ms": float(np.median(busy)) * 1e3, "runs": len(spent)}, result


def quantile(values: Sequence[float], share: float) -> float:
    """Return the value that this share of the values does not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, ceil(share * len(ordered)) - 1))]


def peak_mb() -> float:
    """Return the most memory this process has held so far, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1024 if sys.platform != "darwin" else peak / 1024**2


def cores() -> list[int]:
    """Return the numbers of the cores that this process may run on, or of all cores where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def pin_to_core(number: int) -> None:
    """Run on this core from now on, where the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {number})


def machine() -> dict[str, Any]:
    """Return what this was measured on, and how busy it was with other things (load of the last minute)."""
    return {
        "platform": platform.platform(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "python": platform.python_version(),
        "load": os.getloadavg()[0],
    }


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
