"""Sweeps on 1 to 4 workers of a Dask cluster, in this process, and in a plain pool of processes; what each costs."""

from __future__ import annotations

import asyncio
import os
import pickle
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np

from skyfolio.api.common import kernels
from skyfolio.api.common.dask_cluster import own_cluster
from skyfolio.api.lab.sweep.case import row_of
from skyfolio.api.lab.sweep.farm import Work, farmed
from skyfolio.api.lab.sweep.parts import Batch, batches_of, compute
from skyfolio.api.lab.sweep.spec import Spec, spec_of

PURPOSE = "bench scale"
BATCH = 8
COPIED_MB = 64
COPY_FOR_S = 0.5
PART_BYTES = 8_000
"""Bytes that come back of a batch without work, as many as a part of a few cases has."""


class Size(NamedTuple):
    """Cores that everything runs on, and workers."""

    cores: int
    workers: int


@dataclass
class Shares:
    """What the cores did in the meantime, core seconds: `ours` in this process, `busy` in all of the machine."""

    wall_s: float = 0.0
    ours_s: float = 0.0
    busy_s: float = 0.0


def study(cases: int) -> Spec:
    """Return the sweep that is measured: the letter's layouts at random, each planned and replanned after a loss."""
    vary = {"layout.seed": {"range": [0, cases - 1]}}
    fixed = {"failed": ["uav-1"], "utility.mu_per_kbps": -0.1}
    return spec_of({"batch": BATCH, "base": {"layout": {"kind": "letter"}}, "set": fixed, "vary": vary})


def alone_row(cases: int) -> dict[str, Any]:
    """Compute the cases in this process, without a cluster."""
    spec = study(cases)
    with on_cores(1), _watched() as shares:
        for varied in spec.cases():
            row_of(spec.base, {**spec.fixed, **varied})
    return _row(cases, Size(1, 1), shares, shares.ours_s, 0.0)


def pool_row(cases: int, size: Size) -> dict[str, Any]:
    """Compute the same batches in a plain pool of processes: what no engine at all would cost."""
    batches = batches_of(study(cases))
    with on_cores(size.cores), _pool(size.workers) as pool:
        list(pool.map(_warm, range(size.workers)))
        with _watched() as shares:
            worked_s = sum(pool.map(_computed_cpu_s, batches))
    return _row(cases, size, shares, worked_s, shares.ours_s)


def swept_row(cases: int, size: Size) -> dict[str, Any]:
    """Compute the batches as a sweep does, on a cluster of its own."""
    with on_cores(size.cores):
        shares, worked_s = asyncio.run(_farmed(size.workers, batches_of(study(cases)), compute))
    return _row(cases, size, shares, worked_s, shares.ours_s)


def _row(cases: int, size: Size, shares: Shares, worked_s: float, engine_s: float) -> dict[str, Any]:
    """Return a row. worked_s, engine_s: core seconds of the workers, and of scheduler and client together."""
    capacity_s = size.cores * shares.wall_s
    return {
        "cores": size.cores,
        "workers": size.workers,
        "cases": cases,
        "seconds": shares.wall_s,
        "cases_per_s": cases / shares.wall_s,
        "cpu_ms_per_case": worked_s / cases * 1e3,
        "engine_share": engine_s / capacity_s,
        "others_share": max(0.0, shares.busy_s - worked_s - engine_s) / capacity_s,
        "idle_share": max(0.0, capacity_s - shares.busy_s) / capacity_s,
        "load": os.getloadavg()[0],
    }


async def _farmed(workers: int, batches: Sequence[Batch], work: Work) -> tuple[Shares, float]:
    """Return what happened from the first batch to the last result, and the processor seconds of all workers.

    Workers have loaded their kernels before.
    """
    async with own_cluster(workers, PURPOSE) as client:
        await client.run(kernels.load_all)
        spent = sum((await client.run(time.process_time)).values())
        with _watched() as shares:
            async for done in farmed(client, work, batches, asyncio.Event()):
                assert done.error is None, done.error  # noqa: S101 - a figure of broken batches would be none
        return shares, sum((await client.run(time.process_time)).values()) - spent


def engine_rows(rounds: int) -> dict[str, Any]:
    """Measure what a batch costs beside its work: in Dask and in a plain pool, and to pickle and unpickle.

    per_s: batches without work that one worker is given in a second. client_cpu_ms, worker_cpu_ms: of each.
    """
    batches = batches_of(study(rounds * BATCH))
    shares, worked_s = asyncio.run(_farmed(1, batches, _nothing))
    with _pool(1) as pool:
        pool.submit(_nothing, batches[0]).result()
        with _watched() as pooled:
            list(pool.map(_nothing, batches))
    return {
        "batches": rounds,
        "dask": {**_each(shares, rounds), "worker_cpu_ms": worked_s / rounds * 1e3},
        "pool": _each(pooled, rounds),
        "pickled": _pickled(batches[0]),
    }


def _each(shares: Shares, rounds: int) -> dict[str, float]:
    return {
        "per_s": rounds / shares.wall_s,
        "ms": shares.wall_s / rounds * 1e3,
        "client_cpu_ms": shares.ours_s / rounds * 1e3,
    }


def _pickled(batch: Batch, times: int = 200) -> dict[str, float]:
    """Measure a batch on its way out and a part of its size on its way back: bytes, milliseconds for both ways."""
    part = compute(batch)
    sizes = [len(pickle.dumps(one)) for one in (batch, part)]
    began = time.perf_counter()
    for _ in range(times):
        for one in (batch, part):
            pickle.loads(pickle.dumps(one))  # noqa: S301 - what was pickled in the same line
    return {"batch_bytes": sizes[0], "part_bytes": sizes[1], "ms": (time.perf_counter() - began) / times * 1e3}


def copied(processes: int) -> dict[str, float]:
    """Measure how fast so many processes at once copy memory that fits no cache, GB/s each."""
    with _pool(processes) as pool:
        list(pool.map(time.sleep, [0.5] * processes))
        speeds = list(pool.map(_copied_gb_s, [COPY_FOR_S] * processes))
    return {"processes": processes, "gb_per_s_each": sum(speeds) / processes}


def _copied_gb_s(seconds: float) -> float:
    source = np.ones(COPIED_MB << 17)
    target = np.empty_like(source)
    began, rounds = time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        np.copyto(target, source)
        rounds += 1
    return 2 * source.nbytes * rounds / (time.perf_counter() - began) / 1e9


def _warm(_number: int) -> None:
    """Load all kernels; slow enough for every process of a pool to get one of these."""
    kernels.load_all()
    time.sleep(0.5)


def _computed_cpu_s(batch: Batch) -> float:
    """Compute a batch, and return its processor seconds."""
    before = time.process_time()
    compute(batch)
    return time.process_time() - before


def _nothing(batch: Batch) -> bytes:  # noqa: ARG001 - as any work
    return bytes(PART_BYTES)


def _pool(processes: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"))


@contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Run this process, and those that it starts meanwhile, on so many cores."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(before)[-count:]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def _watched() -> Iterator[Shares]:
    """Watch this process and its cores; the figures are there at the end."""
    shares = Shares()
    began, ours, busy = time.perf_counter(), time.process_time(), _busy_s()
    yield shares
    shares.wall_s = time.perf_counter() - began
    shares.ours_s, shares.busy_s = time.process_time() - ours, _busy_s() - busy


def _busy_s() -> float:
    """Return the seconds that the cores of this process have been busy since the machine started."""
    import psutil  # noqa: PLC0415 - Dask needs it, and Dask is an extra

    times = psutil.cpu_times(percpu=True)
    return float(sum(sum(times[core]) - times[core].idle - times[core].iowait for core in os.sched_getaffinity(0)))
