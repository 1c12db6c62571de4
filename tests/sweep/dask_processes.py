"""A real Dask scheduler and real workers, each a process of its own."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.ports import free_port

ROOT = Path(__file__).resolve().parents[2]


class Cluster:
    """A scheduler and its workers, which may be killed and replaced."""

    def __init__(self) -> None:
        self.address = f"tcp://127.0.0.1:{free_port(socket.SOCK_STREAM)}"
        self.workers: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._scheduler()

    def add_worker(self) -> None:
        """Start a worker of one thread."""
        self.workers.append(self._process("worker", self.address, "--nthreads", "1", "--no-nanny"))

    def kill_worker(self) -> None:
        """Kill the oldest worker, as the kernel does that runs out of memory."""
        worker = self.workers.pop(0)
        worker.kill()
        worker.wait()

    def kill_scheduler(self) -> None:
        """Kill the scheduler."""
        self.scheduler.kill()
        self.scheduler.wait()

    def start_again(self) -> None:
        """Start another scheduler at the same address, and a worker."""
        self.scheduler = self._scheduler()
        self.add_worker()

    def _scheduler(self) -> subprocess.Popen[bytes]:
        port = int(self.address.rpartition(":")[2])
        scheduler = self._process("scheduler", "--port", str(port))
        while not _listens(port):
            assert scheduler.poll() is None, "the scheduler has ended"
            time.sleep(0.1)
        return scheduler

    def close(self) -> None:
        """End everything."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()

    def _process(self, part: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *arguments, "--host", "127.0.0.1"]
        return subprocess.Popen(
            [*command, "--no-dashboard", *(["--dashboard-address", "127.0.0.1:0"] if part == "scheduler" else [])],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def dask_cluster(workers: int) -> Iterator[Cluster]:
    """A cluster of so many workers."""
    cluster = Cluster()
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.close()
