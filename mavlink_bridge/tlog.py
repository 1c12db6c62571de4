"""Telemetry logs as every ground station writes them: 8 bytes (big endian) of microseconds since 1970, then a frame.

The log stands beside the data path: frames are handed to a thread that writes them, so that neither a slow nor a full
disk holds up a message to or from a vehicle.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

SUFFIX = ".tlog"
WAITING_FRAMES = 20_000
"""The number of frames that may wait for a slow disk, about 6 MB; losing those beyond is reported as a failure."""


def _ignore(reason: str) -> None:
    """Ignore it."""


class TelemetryLog:
    """One `.tlog` file; QGroundControl, Mission Planner and pymavlink read it.

    An existing file is appended to, so that a restart of the service keeps the flight's first part. A failure is
    reported to `on_failure(reason)`, once; nothing raises, and nothing is written from then on.
    """

    def __init__(
        self, path: Path, *, wall_s: Callable[[], float] = time.time, on_failure: Callable[[str], None] = _ignore
    ) -> None:
        self.path = path
        self._wall_s, self._on_failure = wall_s, on_failure
        self._waiting: queue.Queue[bytes | None] = queue.Queue(maxsize=WAITING_FRAMES)
        self._failed = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._write_all, name=f"tlog {path.name}", daemon=True)
        self._thread.start()

    def write(self, frame: bytes) -> None:
        """Add a frame, as it was before signing. Never waits and never raises."""
        if self._closed or self._failed.is_set():
            return
        try:
            self._waiting.put_nowait(int(self._wall_s() * 1e6).to_bytes(8, "big") + frame)
        except queue.Full:
            self._fail(f"the disk is too slow: {WAITING_FRAMES} frames wait to be written")

    def close(self) -> None:
        """Have the thread write what waits and end the file; does not wait for that."""
        if not self._closed:
            self._closed = True
            with suppress(queue.Full):  # a disk that hangs: the thread, a daemon, ends with the process
                self._waiting.put_nowait(None)

    def wait(self, timeout_s: float) -> bool:
        """Return whether a closed log is on disk (or has failed) within `timeout_s` wall seconds; blocks."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _write_all(self) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab") as file:
                self._write_into(file)
        except OSError as error:
            self._fail(str(error))

    def _write_into(self, file: BinaryIO) -> None:
        """Write frames until the end; flush whenever nothing waits."""
        while (entry := self._waiting.get()) is not None:
            file.write(entry)
            if self._waiting.empty():
                file.flush()

    def _fail(self, reason: str) -> None:
        if not self._failed.is_set():
            self._failed.set()
            self._on_failure(f"{self.path}: {reason}")
