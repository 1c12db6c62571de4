"""Telemetry logs as every ground station writes them: 8 bytes (big endian) of microseconds since 1970, then a frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

SUFFIX = ".tlog"


class TelemetryLog:
    """One `.tlog` file; QGroundControl, Mission Planner and pymavlink read it. Raises OSError if it cannot be made."""

    def __init__(self, path: Path, *, wall_s: Callable[[], float] = time.time) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._wall_s = wall_s
        self._file: BinaryIO | None = path.open("wb")

    def write(self, frame: bytes) -> None:
        """Add a frame, as it was before signing."""
        if self._file is not None:
            self._file.write(int(self._wall_s() * 1e6).to_bytes(8, "big") + frame)

    def close(self) -> None:
        """Flush and end the file."""
        file, self._file = self._file, None
        if file is not None:
            file.close()
