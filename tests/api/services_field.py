"""A field for tests of several services: a line to one PostgreSQL for each, and one fleet that all of them hear."""

import asyncio
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx2
from sqlalchemy.engine import make_url

from skyfolio import sim
from skyfolio.api.common.settings import Settings
from skyfolio.api.fleet.simulated_fleet import specs_at_starts
from skyfolio.api.lab.demo.client import planned
from skyfolio.planner import EXAMPLES
from skyfolio.sim.truth import LoggedMessage
from tests.lateness import Lateness, lateness
from tests.ports import free_port

SPEEDUP = 2.0
SCENARIO = EXAMPLES["paper"]().with_changes(altitude_m=8.0)
SLOTS = 16
ROOT = Path(__file__).resolve().parents[2]
SERVE = "from tests.api.dying_service import main; main()"
STARTS_WITHIN_S = 250.0


class Line:
    """A TCP proxy to the database, that can be made slow."""

    def __init__(self, host: str, port: int) -> None:
        self.port = free_port(socket.SOCK_STREAM)
        self.delay_s = 0.0
        self._to = (host, port)
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        self._server = await asyncio.start_server(self._connected, "127.0.0.1", self.port)

    async def close(self) -> None:
        assert self._server is not None
        self._server.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._open.add(task)
        writers = [writer]
        try:
            with suppress(OSError, asyncio.CancelledError):
                back, forth = await asyncio.open_connection(*self._to)
                writers.append(forth)
                await asyncio.gather(self._pipe(reader, forth), self._pipe(back, writer))
        finally:
            for one in writers:
                one.close()
            self._open.discard(task)

    async def _pipe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(65_536):
                if self.delay_s:
                    await asyncio.sleep(self.delay_s)
                writer.write(data)
                await writer.drain()
        writer.close()


class Service:
    """One service process: its settings, its line to the database, and a client."""

    def __init__(self, name: str, database_url: str, log: Path, **changes: Any) -> None:
        url = make_url(database_url)
        assert url.host is not None
        assert url.port is not None
        self.name, self.log = name, log
        self.line = Line(url.host, url.port)
        self.fleet_port = free_port(socket.SOCK_DGRAM)
        self.settings = Settings(
            port=free_port(socket.SOCK_STREAM),
            database_url=url.set(host="127.0.0.1", port=self.line.port).render_as_string(hide_password=False),
            several_services=True,
            service_name=name,
            fleet_url=f"udpin://127.0.0.1:{self.fleet_port}",
            time_scale=SPEEDUP,
            plan_ahead=False,
            warm_up=False,  # nothing is replanned
            plan_starts=1,
            solve_deadline_s=20.0,
            heartbeat_stale_s=10.0,
            heartbeat_lost_s=20.0,
            **changes,
        )
        self.client = httpx2.AsyncClient(base_url=f"http://127.0.0.1:{self.settings.port}", timeout=150.0)
        self.process: asyncio.subprocess.Process | None = None

    def signal(self, number: signal.Signals) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    async def get(self, path: str, **params: Any) -> Any:
        answer = await self.client.get(path, params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def events(self, kind: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        after: int | None = 0
        while after is not None:
            page = await self.get("/v1/events/log", after=after, limit=500)
            found, after = found + page["items"], page["next"]
        return [event for event in found if event["kind"] == kind]

    async def until(self, path: str, *states: str, owner: str | None = None) -> dict[str, Any]:
        """The operation once it is in one of these states, and belongs to `owner`."""
        async with asyncio.timeout(150):
            while True:
                operation: dict[str, Any] = await self.get(path)
                if operation["state"] in states and owner in (None, operation["owner"]):
                    return operation
                await asyncio.sleep(0.1)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[Self]:
        """The process, from when it answers until it is ended."""
        await self.line.open()
        command = [sys.executable, "-c", SERVE, self.settings.model_dump_json(), "never", "after", "1"]
        with self.log.open("ab") as sink:
            self.process = await asyncio.create_subprocess_exec(*command, stdout=sink, stderr=sink, cwd=ROOT)
            try:
                async with asyncio.timeout(STARTS_WITHIN_S):
                    await self._ready(self.process)
                yield self
            finally:
                if self.process.returncode is None:
                    self.process.send_signal(signal.SIGCONT)
                    self.process.terminate()
                    await self.process.wait()
                await self.client.aclose()
                await self.line.close()

    async def _ready(self, process: asyncio.subprocess.Process) -> None:
        while process.returncode is None:
            with suppress(httpx2.TransportError):
                if (await self.client.get("/health")).status_code == 200:
                    return
            await asyncio.sleep(0.1)
        raise AssertionError(f"the service ended with {process.returncode}: {self.log.read_text()[-3000:]}")


class SharedField:
    """Two services, `first` and `second`, and a fleet that sends to both; a flight has so many slots."""

    def __init__(self, folder: Path, database_url: str, slots: int = SLOTS, **changes: Any) -> None:
        self.scenario = SCENARIO.with_changes(slots=slots)
        self.first = Service("first", database_url, folder / "first.log", **changes)
        self.second = Service("second", database_url, folder / "second.log", **changes)
        ends = ",".join(f"udpout://127.0.0.1:{service.fleet_port}" for service in (self.first, self.second))
        self.fleet = sim.Fleet(specs_at_starts(self.scenario), clock=sim.ScaledClock(SPEEDUP), endpoint=ends)
        self._stack = AsyncExitStack()
        self._lateness = Lateness()

    async def __aenter__(self) -> Self:
        await self._stack.enter_async_context(self.fleet)
        self._lateness = await self._stack.enter_async_context(lateness())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stack.__aexit__(kind, error, trace)

    @property
    def late_s(self) -> float:
        """Wall seconds that this process has waited for the machine: what a service may be late through no fault of
        its own."""
        return self._lateness.late_s

    async def take_off(self) -> str:
        """Plan, register and fly at the first service; the operation's path once slot 0 has begun."""
        client = self.first.client
        async with asyncio.timeout(STARTS_WITHIN_S):
            plan_id = await planned(client, self.scenario)
        for number, uav in enumerate(self.scenario.uav_ids, start=1):
            answer = await client.post("/v1/fleet/vehicles", json={"uav_id": uav, "system_id": number})
            assert answer.status_code == 201, answer.text
        started = await client.post("/v1/operations", json={"plan_id": plan_id})
        assert started.status_code == 202, started.text
        path = str(started.headers["Location"])
        flying = await self.first.until(path, "flying", "failed")
        assert flying["state"] == "flying", flying["error"]
        assert (await self.second.until(path, "flying"))["owner"] == "first"
        return path

    def received(self, service: Service, since_s: float = 0.0, *, heartbeats: bool = True) -> list[LoggedMessage]:
        """Ground truth: what any vehicle received from a service from that fleet second on."""
        at = f"127.0.0.1:{service.fleet_port}"
        return [
            message
            for message in list(self.fleet.truth.messages)
            if message.direction == "in"
            and message.sender == at
            and message.t_s >= since_s
            and (heartbeats or message.name != "HEARTBEAT")
        ]

    def claimed_s(self) -> float:
        """The fleet second from which the first service flies the vehicles: that of its first upload."""
        return min(one.t_s for one in self.received(self.first) if one.name == "MISSION_COUNT")

    def now_s(self) -> float:
        """Fleet seconds now."""
        return self.fleet.now_s
