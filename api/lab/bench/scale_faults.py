"""Sweeps whose workers are killed, and sweeps that are stopped by Ctrl-C."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from skyfolio.api.common import kernels
from skyfolio.api.common.dask_cluster import own_cluster
from skyfolio.api.lab.bench.scale_sweep import PURPOSE, study
from skyfolio.api.lab.sweep.case import row_of
from skyfolio.api.lab.sweep.parts import Batch, Parts, part_of
from skyfolio.api.lab.sweep.results import load
from skyfolio.api.lab.sweep.run import sweep
from skyfolio.api.lab.sweep.spec import Base

WORKERS = 2
LOOK_S = 0.02
FIRST = 16
"""Cases that are timed to find out how many there must be."""
LONG = """batch = 1
[base]
layout = {kind = "uniform", uavs = 8, users = 60, slots = 400}
[vary]
starts = [1, 64]
seed = {range = [0, 30]}
"""
"""First one start each, which takes a second; then 64, which takes minutes."""


async def killed_row(kill_every_s: float, kills: int) -> dict[str, Any]:
    """Sweep for so long that a worker is killed `kills` times, and compare the rows with the cases.

    recomputed: how many cases workers finished more than once, as a share of all.
    """
    killed: list[int] = []
    with tempfile.TemporaryDirectory() as folder:
        log, out = Path(folder) / "finished", Path(folder) / "out"
        async with own_cluster(WORKERS, PURPOSE) as client:
            await client.run(kernels.load_all)
            first = await sweep(study(FIRST), Path(folder) / "first", nullcontext(client), asyncio.Event())
            seconds = kill_every_s * (kills + 0.5)
            spec = study(FIRST + int(FIRST / first.seconds * seconds))
            killing = asyncio.create_task(_kill_workers(client, kill_every_s, kills, killed))
            work = partial(noting, str(log))
            outcome = await sweep(spec, out, nullcontext(client), asyncio.Event(), work=work)
            killing.cancel()
            with suppress(asyncio.CancelledError):
                await killing
        rows = list(load(out)["case"])
        finished = log.read_text().split()
    return {
        "kill_every_s": kill_every_s,
        "killed": len(killed),
        "seconds": outcome.seconds,
        "cases": spec.n_cases,
        "lost": len(set(range(spec.n_cases)) - set(rows)),
        "doubled": len(rows) - len(set(rows)),
        "recomputed": (len(finished) - len(set(finished))) / spec.n_cases,
        "load": os.getloadavg()[0],
    }


async def _kill_workers(client: Any, every_s: float, kills: int, killed: list[int]) -> None:
    """Kill one worker after the other as the kernel does that runs out of memory; each is started again by itself."""
    while len(killed) < kills:
        await asyncio.sleep(every_s)
        pids = [pid for pid in (await client.run(os.getpid)).values() if pid not in killed]
        os.kill(pids[0], signal.SIGKILL)
        killed.append(pids[0])


def noting(log: str, batch: Batch) -> bytes:
    """Compute a batch as a sweep does, and leave a line in a file for each case that is finished."""
    base, rows = Base.model_validate_json(batch.base), []
    for number, varied in enumerate(batch.cases, start=batch.first):
        rows.append(row_of(base, {**batch.fixed, **varied}))
        with Path(log).open("a", encoding="utf-8") as lines:  # one short line: written at once, whole
            lines.write(f"{number}\n")
    return part_of(batch, rows)


def stop_row(times: int) -> dict[str, Any]:
    """Stop `skyfolio sweep` by Ctrl-C in mid-solve; seconds until its process has ended, and parts that were lost."""
    took_s, lost = [], 0
    for _ in range(times):
        with tempfile.TemporaryDirectory() as folder:
            seconds, lost_now = _stopped(Path(folder))
        took_s.append(seconds)
        lost += lost_now
    return {"times": times, "p50_s": median(took_s), "max_s": max(took_s), "lost": lost, "load": os.getloadavg()[0]}


def _stopped(folder: Path) -> tuple[float, int]:
    spec, parts = folder / "long.toml", Parts(folder / "out")
    spec.write_text(LONG, encoding="utf-8")
    command = [sys.executable, "-m", "skyfolio", "sweep", str(spec), "--out", str(folder / "out"), "--json"]
    with subprocess.Popen(  # noqa: S603
        [*command, "--workers", str(WORKERS)], stdout=subprocess.DEVNULL, start_new_session=True
    ) as process:
        try:
            while len(there := parts.there()) < WORKERS:
                if process.poll() is not None:
                    raise RuntimeError(f"the sweep ended with {process.returncode}")
                time.sleep(LOOK_S)
            os.killpg(process.pid, signal.SIGINT)
            began = time.perf_counter()
            process.wait()
            return time.perf_counter() - began, len(there - parts.there())
        finally:
            process.kill()
