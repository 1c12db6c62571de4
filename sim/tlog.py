"""What was said, on file: a MAVLink `.tlog`, as ground stations write and read it."""

import struct
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Protocol, Self

from skyfolio.sim.clock import EPOCH_S


class Tap(Protocol):
    """Hears every message of every vehicle, at fleet time `t_s`: frames as the vehicle sent them or understood them,
    before and after whatever the link did to them."""

    def frame(self, t_s: float, system_id: int, frame: bytes) -> None:
        """Hear a frame that a vehicle sends."""
        ...

    def heard(self, t_s: float, system_id: int, message: Any) -> None:
        """Hear a message that a vehicle takes in."""
        ...

    def answered(self, t_s: float, system_id: int, name: str) -> None:
        """Hear the name of a message that answers one."""
        ...


class TlogWriter:
    """Writes frames as a `.tlog`: before each, its time in microseconds since 1970 as a big-endian integer.

    Fleet time 0 is `sim.clock.EPOCH_S`, so that the same flight gives the same file.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = path.open("wb")

    def write(self, t_s: float, frame: bytes) -> None:
        """Add a frame."""
        self._file.write(struct.pack(">Q", round((EPOCH_S + t_s) * 1e6)) + frame)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
