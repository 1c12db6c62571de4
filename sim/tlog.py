"""The messages of a fleet on file: a MAVLink `.tlog`, as ground stations write and read it."""

import struct
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from skyfolio.sim.clock import EPOCH_S


class TlogWriter:
    """Writes frames as a `.tlog`: before each, its time in microseconds since 1970 as a big-endian integer.

    Fleet time 0 is `sim.clock.EPOCH_S`, so that the same flight always gives the same file.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = path.open("wb")

    def write(self, t_s: float, frame: bytes) -> None:
        """Add a frame that was sent at fleet time `t_s`."""
        self._file.write(struct.pack(">Q", round((EPOCH_S + t_s) * 1e6)) + frame)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
