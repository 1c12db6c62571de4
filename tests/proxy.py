"""A small reverse proxy: what nginx does with `location /PREFIX/ { proxy_pass ...; }`, for tests without nginx."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from types import MappingProxyType

from tests.ports import free_port

NONE: Mapping[str, str] = MappingProxyType({})
HOP = (b"connection", b"x-forwarded-for", b"x-forwarded-host", b"x-forwarded-prefix", b"x-forwarded-proto")


class Proxy:
    """Forwards what comes below `prefix` to a service, one connection for each request.

    strips: whether the service is asked without the prefix. headers: added to each request. Host passes as it came.
    """

    def __init__(
        self, to_port: int, prefix: str = "", *, strips: bool = True, headers: Mapping[str, str] = NONE
    ) -> None:
        self.port = free_port(socket.SOCK_STREAM)
        self.url = f"http://127.0.0.1:{self.port}"
        self._to_port, self._prefix, self._strips = to_port, prefix.encode(), strips
        self._open: set[asyncio.Task[None]] = set()
        self._headers = [f"{name}: {value}".encode() for name, value in headers.items()]

    async def serve(self, ready: threading.Event, end: asyncio.Event) -> None:
        """Forward until told to end; then every connection is closed."""
        async with await asyncio.start_server(self._connected, "127.0.0.1", self.port):
            ready.set()
            await end.wait()
            for task in self._open:
                task.cancel()
            await asyncio.gather(*self._open, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._open.add(task)
        try:
            with suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._forward(reader, writer)
        finally:
            await _closed(writer)
            self._open.discard(task)

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = self._rewritten(await reader.readuntil(b"\r\n\r\n"))
        if head is None:
            writer.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            return
        back, forth = await asyncio.open_connection("127.0.0.1", self._to_port)
        try:
            forth.write(head)
            await asyncio.gather(_pipe(reader, forth), _pipe(back, writer))
        finally:
            await _closed(forth)

    def _rewritten(self, head: bytes) -> bytes | None:
        first, *lines = head.rstrip(b"\r\n").split(b"\r\n")
        method, target, version = first.split(b" ")
        if not target.startswith(self._prefix + b"/"):
            return None
        if self._strips:
            target = target.removeprefix(self._prefix)
        upgrade = any(line.lower().startswith(b"upgrade:") for line in lines)
        kept = [line for line in lines if line.split(b":")[0].lower() not in HOP]
        added = [b"Connection: " + (b"Upgrade" if upgrade else b"close"), *self._headers]
        return b"\r\n".join([b" ".join([method, target, version]), *kept, *added, b"", b""])


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(65_536):
            writer.write(data)
            await writer.drain()
        writer.close()


async def _closed(writer: asyncio.StreamWriter) -> None:
    """Close it, and wait until it is."""
    writer.close()
    with suppress(OSError):
        await writer.wait_closed()


@contextmanager
def running(proxy: Proxy) -> Iterator[Proxy]:
    """The proxy, in a thread of its own."""
    loop = asyncio.new_event_loop()
    ready, end = threading.Event(), asyncio.Event()
    thread = threading.Thread(target=loop.run_until_complete, args=(proxy.serve(ready, end),))
    thread.start()
    ready.wait(20)
    try:
        yield proxy
    finally:
        loop.call_soon_threadsafe(end.set)
        thread.join()
        loop.close()
