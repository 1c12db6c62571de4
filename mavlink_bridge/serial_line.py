"""A telemetry radio or a cable as a link: it sends whole frames or none, and never waits for the line."""

from __future__ import annotations

import asyncio
import os

import serial

from skyfolio.mavlink_bridge.errors import ConnectionFailed
from skyfolio.mavlink_bridge.framing import Framer
from skyfolio.mavlink_bridge.links import MOST_WAITING_BYTES, READ_BYTES, RETRY_S, OneEnd, OnFrames


class SerialLine(OneEnd):
    """A telemetry radio or a cable; opened again whenever it was unplugged."""

    def __init__(self, url: str, device: str, baud: int, on_frames: OnFrames) -> None:
        self.url = url
        self._device, self._baud = device, baud
        self._on_frames = on_frames
        self._framer = Framer()
        self._loop = asyncio.get_running_loop()
        self.dropped = 0
        """The number of frames that were not sent because too much waited."""
        self._waiting = bytearray()
        self._port: serial.Serial | None = None
        self._again: asyncio.TimerHandle | None = None

    async def open(self) -> None:
        """Open the device."""
        try:
            self._begin()
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise ConnectionFailed(self.url, str(error)) from error

    def send(self, frame: bytes, system_id: int) -> None:
        """Write the frame into the line, if it is plugged in: whole, or not at all while too much waits."""
        del system_id
        if self._port is None:
            return
        if len(self._waiting) + len(frame) > MOST_WAITING_BYTES:
            self.dropped += 1
            return
        self._waiting += frame
        self._flush()

    def close(self) -> None:
        """Close the device."""
        if self._again is not None:
            self._again.cancel()
        self._end()

    def _begin(self) -> None:
        self._port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)
        os.set_blocking(self._port.fileno(), False)
        self._loop.add_reader(self._port.fileno(), self._read)

    def _flush(self) -> None:
        """Write what the line takes now; the rest when it takes more."""
        if self._port is None:
            return
        try:
            written = os.write(self._port.fileno(), self._waiting) if self._waiting else 0
        except BlockingIOError:
            written = 0
        except OSError:
            self._broken()
            return
        del self._waiting[:written]
        if self._waiting:
            self._loop.add_writer(self._port.fileno(), self._flush)
        else:
            self._loop.remove_writer(self._port.fileno())

    def _read(self) -> None:
        if self._port is None:
            return
        try:
            data = self._port.read(READ_BYTES)
        except OSError:
            self._broken()
            return
        frames = self._framer.feed(data)
        if frames:
            self._on_frames(self, frames)

    def _end(self) -> None:
        port, self._port = self._port, None
        self._waiting.clear()
        if port is not None:
            self._loop.remove_reader(port.fileno())
            self._loop.remove_writer(port.fileno())
            port.close()

    def _broken(self) -> None:
        self._end()
        self._again = self._loop.call_later(RETRY_S, self._try_again)

    def _try_again(self) -> None:
        try:
            self._begin()
        except OSError:
            self._broken()
