"""Sweeps on real clusters: workers and schedulers die, it is interrupted, and no row is lost or doubled."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import psutil
import pytest

import skyfolio.sweep
from skyfolio.api.common import dask_cluster as dask_cluster_module
from skyfolio.api.common.dask_cluster import SchedulerError, own_cluster
from skyfolio.api.lab.sweep.parts import Parts, SweepError
from skyfolio.api.lab.sweep.run import Outcome, cluster, sweep
from skyfolio.api.lab.sweep.spec import Spec, spec_of
from tests.ports import free_port
from tests.sweep import work
from tests.sweep.dask_processes import ROOT, dask_cluster


@pytest.fixture(autouse=True)
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the workers of this test write down which cases they have finished."""
    monkeypatch.setenv(work.LOG, str(tmp_path / "finished"))


def cases(count: int, batch: int) -> Spec:
    vary = {"seed": {"range": [0, count - 1]}}
    return spec_of({"batch": batch, "base": {"example": "minimal"}, "set": {"starts": 1}, "vary": vary})


async def swept(spec: Spec, out: Path, scheduler: str | None, **options: Any) -> Outcome:
    return await sweep(spec, out, cluster(scheduler, 2), options.pop("stop", asyncio.Event()), **options)


def assert_complete(spec: Spec, out: Path) -> None:
    assert list(skyfolio.sweep.load(out)["case"]) == list(range(spec.n_cases))


async def test_an_own_cluster_computes_a_sweep_and_a_second_run_finds_it(tmp_path: Path) -> None:
    spec = cases(40, batch=4)
    seen: list[tuple[int, int]] = []
    outcome = await swept(spec, tmp_path, None, work=work.waiting, advance=lambda *at: seen.append(at))
    assert (outcome.stored, outcome.found, outcome.complete, outcome.broken) == (40, 0, True, 0)
    assert seen == [(stored, 40) for stored in range(0, 41, 4)]
    assert_complete(spec, tmp_path)
    assert Counter(work.logged()) == Counter(range(40))
    again = await swept(spec, tmp_path, None, work=work.waiting)
    assert (again.stored, again.found) == (40, 40)
    assert len(work.logged()) == 40


@pytest.mark.e2e
async def test_what_breaks_or_stops_on_a_cluster_costs_itself_and_no_more(tmp_path: Path) -> None:
    async with own_cluster(2, "a test") as client:
        await one_batch_breaks(client, tmp_path / "broken", work.broken, "ZeroDivisionError: for a test")
        await one_batch_breaks(client, tmp_path / "deadly", work.deadly, "KilledWorker")
        await a_stopped_sweep_keeps_what_is_finished_and_goes_on_later(client, tmp_path / "stopped")
        await a_worker_of_another_version_ends_the_sweep_with_an_error(client, tmp_path / "other")


async def swept_on(client: Any, spec: Spec, out: Path, **options: Any) -> Outcome:
    return await sweep(spec, out, nullcontext(client), options.pop("stop", asyncio.Event()), **options)


async def one_batch_breaks(client: Any, out: Path, how: Callable[[Any], bytes], said: str) -> None:
    """It is reported and left out, the others are computed, and it is tried again."""
    spec = cases(40, batch=4)
    outcome = await swept_on(client, spec, out, work=how)
    assert (outcome.stored, outcome.broken, outcome.complete) == (36, 1, False)
    assert outcome.errors[0].startswith(f"cases 0 to 3: {said}")
    assert (await swept_on(client, spec, out, work=work.waiting)).complete, "it is tried again"
    assert_complete(spec, out)


async def a_stopped_sweep_keeps_what_is_finished_and_goes_on_later(client: Any, out: Path) -> None:
    spec, stop = cases(400, batch=4), asyncio.Event()

    def advance(stored: int, _: int) -> None:
        if stored >= 16:
            stop.set()

    outcome = await swept_on(client, spec, out, work=work.waiting, stop=stop, advance=advance)
    assert outcome.stopped
    assert 16 <= outcome.stored < 400
    assert outcome.stored == len(skyfolio.sweep.load(out))
    assert stop.is_set(), "so that what is there is listed, and nothing is computed"
    rest = await swept_on(client, cases(400, batch=4), out, work=work.waiting, stop=stop)
    assert rest.found == outcome.stored


async def a_worker_of_another_version_ends_the_sweep_with_an_error(client: Any, out: Path) -> None:
    with pytest.raises(SweepError, match="a worker of the cluster cannot take part"):
        await swept_on(client, cases(8, batch=2), out, work=work.of_another_version)
    assert Parts(out).there() == set()


async def test_nobody_at_the_address_is_an_error_that_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster_module, "CONNECT_S", 0.5)
    address = f"tcp://127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    with pytest.raises(SchedulerError, match=f"scheduler: nobody answers at {address}"):
        await swept(cases(1, batch=1), tmp_path, address)
    with pytest.raises(SchedulerError, match=r"scheduler: 'localhost:1' must begin with tcp:// or tls://"):
        await swept(cases(1, batch=1), tmp_path, "localhost:1")


@pytest.mark.e2e
async def test_a_worker_that_is_killed_in_mid_run_costs_what_it_was_computing(tmp_path: Path) -> None:
    spec = cases(120, batch=5)
    with dask_cluster(2) as real:
        killed = 0

        def advance(stored: int, _: int) -> None:
            nonlocal killed
            if stored >= 40 * (killed + 1) and killed < 2:
                killed += 1
                real.kill_worker()
                real.add_worker()

        outcome = await swept(spec, tmp_path, real.address, work=work.planned, advance=advance)
    assert outcome.complete
    assert killed == 2
    assert_complete(spec, tmp_path)
    finished = Counter(work.logged())
    assert set(finished) == set(range(120))
    assert len(work.logged()) - 120 <= 2 * 2 * spec.batch, (
        "at most what it was computing, and what it had just finished"
    )


@pytest.mark.e2e
async def test_the_scheduler_going_away_ends_the_sweep_and_another_computes_the_rest(tmp_path: Path) -> None:
    spec = cases(100, batch=5)
    with dask_cluster(2) as real:

        def advance(stored: int, _: int) -> None:
            if stored == 20:
                real.kill_scheduler()

        with pytest.raises(SchedulerError, match="it went away; start the sweep again"):
            await swept(spec, tmp_path, real.address, work=work.unfinished, advance=advance)
    there = len(skyfolio.sweep.load(tmp_path))
    assert 20 <= there <= work.UNFINISHED
    outcome = await swept(spec, tmp_path, None, work=work.waiting)
    assert (outcome.found, outcome.complete) == (there, True)
    assert_complete(spec, tmp_path)


class Unreachable:
    """A future that is done, of a cluster whose scheduler dies before its result is fetched."""

    status = "finished"

    def __await__(self) -> Iterator[bytes]:
        raise OSError("the connection was closed")

    def map(self, *_: Any, **__: Any) -> list["Unreachable"]:
        """Take a batch, as a client does."""
        return [self]

    def release(self) -> None:
        """Be forgotten."""


async def test_a_result_that_cannot_be_fetched_is_the_fault_of_the_scheduler_not_of_the_batch(tmp_path: Path) -> None:
    with pytest.raises(SchedulerError, match="it went away; start the sweep again"):
        await swept_on(Unreachable(), cases(5, batch=5), tmp_path)


LONG = """
batch = 1
[base]
layout = {kind = "uniform", uavs = 8, users = 60, slots = 400}
[vary]
starts = [1, 512]
seed = {range = [0, 30]}
"""
"""First one start each: a second; then 512, which takes longer than any test waits."""


@contextmanager
def commanded(spec: Path, out: Path) -> Iterator[subprocess.Popen[str]]:
    """`skyfolio sweep` in a process group of its own, as a terminal starts it."""
    command = [sys.executable, "-m", "skyfolio", "sweep", str(spec), "--out", str(out), "--workers", "2", "--json"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.e2e
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_all_processes_at_once_and_nothing_finished_is_lost(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "long.toml").write_text(LONG)
    out = tmp_path / "out"
    parts = Parts(out)
    with commanded(tmp_path / "long.toml", out) as process:
        while len(there := parts.there()) < 4:
            assert process.poll() is None, process.stderr and process.stderr.read()
            time.sleep(0.05)
        family = psutil.Process(process.pid).children(recursive=True)
        assert len(family) >= 2
        os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
        began_s = time.monotonic()
        printed, said = process.communicate(timeout=60)
        took_s = time.monotonic() - began_s
    assert process.returncode == 1
    assert "Traceback" not in said
    told = json.loads(printed)
    assert told["stopped"]
    assert there <= parts.there()
    assert told["stored"] == len(parts.there()) == len(skyfolio.sweep.load(out))
    assert took_s < 60, "far less than what the workers were computing"
    assert ended(family)


def ended(family: list[psutil.Process]) -> bool:
    """Whether all of them end: who watches over resources does so a moment after its parent."""
    return not psutil.wait_procs(family, timeout=30)[1]


@pytest.mark.e2e
def test_ctrl_c_while_the_cluster_starts_ends_it_without_a_word_of_its_workers(tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text(LONG)
    with commanded(tmp_path / "long.toml", tmp_path / "out") as process:
        while not (family := psutil.Process(process.pid).children(recursive=True)):
            assert process.poll() is None
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        printed, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in said
    told = json.loads(printed)
    assert (told["stopped"], told["stored"]) == (True, 0)
    assert ended(family)


@pytest.mark.e2e
async def test_a_sweep_that_waits_for_the_first_worker_of_a_cluster_can_be_stopped(tmp_path: Path) -> None:
    stop = asyncio.Event()
    asyncio.get_running_loop().call_later(0.5, stop.set)
    with dask_cluster(0) as real:
        outcome = await swept(cases(8, batch=2), tmp_path, real.address, stop=stop)
    assert (outcome.stopped, outcome.stored) == (True, 0)
