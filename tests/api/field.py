"""A field for tests of whole processes: one simulated fleet, one database, and services that come and go."""

import asyncio
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx2

from skyfolio import sim
from skyfolio.api.common.settings import Settings
from skyfolio.api.fleet.simulated_fleet import specs_at_starts
from skyfolio.api.lab.demo.client import planned
from skyfolio.planner import EXAMPLES
from tests.ports import free_port

SPEEDUP = 5.0
SCENARIO = EXAMPLES["paper"]().with_changes(slots=40, altitude_m=8.0)
ENDED = {"completed", "completed_partly", "failed", "aborted", "interrupted"}
POLL_S = 0.2
ROOT = Path(__file__).resolve().parents[2]
DYING = "from tests.api.dying_service import main; main()"
"""Not run as a file: workers would import all of it, the service with it, before they can solve."""


@dataclass(frozen=True)
class Case:
    """When the service dies: before or after the count-th entry of a step is stored."""

    step: str
    when: str = "after"
    count: int = 1

    def __str__(self) -> str:
        return f"{self.when} {self.step} {self.count}"


class Field:
    """One fleet, one database, and services that come and go."""

    def __init__(self, folder: Path, speedup: float = SPEEDUP) -> None:
        folder.mkdir(parents=True)
        self.endpoint = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        self.fleet = sim.Fleet(
            specs_at_starts(SCENARIO), clock=sim.ScaledClock(speedup), endpoint=f"udpout://{self.endpoint}"
        )
        for vehicle in self.fleet.vehicles.values():
            vehicle.autopilot.parameters["COM_OBL_RC_ACT"] = 5  # else no stream
        self.settings = Settings(
            port=free_port(socket.SOCK_STREAM),
            database_url=f"sqlite+aiosqlite:///{folder}/service.db",
            fleet_url=f"udpin://{self.endpoint}",
            time_scale=speedup,
            plan_ahead=False,
            heartbeat_stale_s=10.0,  # a machine at its limits is late by more than a sped-up fleet's seconds
            heartbeat_lost_s=20.0,
        )
        self.log = folder / "service.log"
        self.client = httpx2.AsyncClient(base_url=f"http://127.0.0.1:{self.settings.port}", timeout=150.0)

    async def __aenter__(self) -> Self:
        await self.fleet.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.client.aclose()
        await self.fleet.__aexit__(kind, error, trace)

    @asynccontextmanager
    async def service(self, dies: Case | None = None) -> AsyncIterator[asyncio.subprocess.Process]:
        """A service process that answers; it dies by itself in a case, and is ended otherwise."""
        dying = [dies.step, dies.when, str(dies.count)] if dies else ["never", "after", "1"]
        command = [sys.executable, "-c", DYING, self.settings.model_dump_json(), *dying]
        with self.log.open("ab") as sink:
            process = await asyncio.create_subprocess_exec(*command, stdout=sink, stderr=sink, cwd=ROOT)
            try:
                async with asyncio.timeout(150):
                    await self._ready(process)
                yield process
            finally:
                if process.returncode is None:
                    process.terminate()
                    await process.wait()

    async def _ready(self, process: asyncio.subprocess.Process) -> None:
        while process.returncode is None:
            with suppress(httpx2.TransportError):
                if (await self.client.get("/health")).status_code == 200:
                    return
            await asyncio.sleep(0.1)
        raise AssertionError(f"the service ended with {process.returncode}: {self.log.read_text()[-2000:]}")

    async def get(self, path: str, **params: Any) -> Any:
        answer = await self.client.get(path, params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def take_off(self, until: str = "flying", **order: Any) -> str:
        """Plan, register, fly as ordered; the operation's path once it is in that state."""
        plan_id = await self.planned_and_registered()
        started = await self.client.post("/v1/operations", json={"plan_id": plan_id, **order})
        assert started.status_code == 202, started.text
        await self.until(started.headers["Location"], until, "failed")
        return str(started.headers["Location"])

    async def planned_and_registered(self) -> str:
        """A plan's id; its UAVs are vehicles of the service."""
        plan_id = await planned(self.client, SCENARIO)
        for number, uav in enumerate(SCENARIO.uav_ids, start=1):
            body = {"uav_id": uav, "system_id": number}
            assert (await self.client.post("/v1/fleet/vehicles", json=body)).status_code == 201
        return plan_id

    async def until(self, path: str, *states: str) -> dict[str, Any]:
        """The operation once it is in one of these states."""
        async with asyncio.timeout(150):
            while True:
                operation: dict[str, Any] = await self.get(path)
                if operation["state"] in states:
                    return operation
                await asyncio.sleep(POLL_S)


async def died(process: asyncio.subprocess.Process) -> None:
    """Wait until the service has killed itself."""
    async with asyncio.timeout(150):
        assert await process.wait() == -signal.SIGKILL


async def events_of(field: Field) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    while True:
        page = await field.get("/v1/events/log", after=len(found), limit=500)
        found += page["items"]
        if page["next"] is None:
            return found
