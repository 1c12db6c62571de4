"""The study's jobs on a real Dask scheduler with workers that are processes."""

import math
import socket
import time
from threading import Timer

import pytest

from skyfolio.api.common.dask_cluster import SchedulerError
from skyfolio.api.lab.reproduce.batch import Batch, silent
from skyfolio.api.lab.reproduce.cluster import ClusterBatch
from tests.ports import free_port
from tests.sweep.dask_processes import dask_cluster


def test_a_cluster_computes_each_job_once_and_raises_what_a_job_raises() -> None:
    counts: list[tuple[int, int]] = []

    def advance(done: int, of: int) -> None:
        counts.append((done, of))

    with dask_cluster(workers=2) as cluster, ClusterBatch(advance, cluster.address) as runs:
        assert runs.run(math.factorial, [1, 2, 3, 2]) == {1: 1, 2: 2, 3: 6}
        assert runs.run(math.factorial, [3, 4]) == {3: 6, 4: 24}
        assert counts == [(0, 3), (1, 3), (2, 3), (3, 3), (3, 4), (4, 4)]
        with pytest.raises(ValueError, match="factorial"):
            runs.run(math.factorial, [5, -1, 6])
        cluster.kill_worker()
        jobs = range(100)
        with Batch(silent, 1) as here:
            assert runs.run(math.isqrt, jobs) == here.run(math.isqrt, jobs)


def test_a_scheduler_that_goes_away_ends_it_by_name() -> None:
    with dask_cluster(workers=1) as cluster, ClusterBatch(silent, cluster.address) as runs:
        Timer(1.0, cluster.kill_scheduler).start()
        with pytest.raises(SchedulerError, match=cluster.address):
            runs.run(time.sleep, [0.1 + 1e-6 * number for number in range(1000)])


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyfolio.api.common.dask_cluster.CONNECT_S", 0.2)
    address = f"tcp://127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    with pytest.raises(SchedulerError, match=address), ClusterBatch(silent, address):
        pass
