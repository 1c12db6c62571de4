"""The service as a process of its own, and the REST calls that the drill makes."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx2

from skyfolio.planner import Scenario

START_LIMIT_S = 240.0
LOOK = {"wait_s": 60}
UNFINISHED = frozenset({"queued", "running"})


class DemoError(Exception):
    """The drill could not be flown; the message gives the reason."""


def free_port(kind: socket.SocketKind) -> int:
    """Return a loopback port that is free now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


@asynccontextmanager
async def service_process(
    time_scale: float, fleet_url: str, log: Path, settings: Mapping[str, str] = MappingProxyType({})
) -> AsyncIterator[httpx2.AsyncClient]:
    """Run `skyfolio serve` on loopback until it is ready; it logs to a file. Raises DemoError if it does not start.

    settings: further `SKYFOLIO_*` variables.
    """
    port = free_port(socket.SOCK_STREAM)
    command = ["serve", "--port", str(port), "--fleet-url", fleet_url, "--time-scale", str(time_scale)]
    command += ["--database-url", "temporary"]
    with log.open("wb") as sink:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "skyfolio", *command, stdout=sink, stderr=sink, env={**os.environ, **settings}
        )
        try:
            async with httpx2.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=70.0) as client:
                await _ready(client, process, log)
                yield client
        finally:
            if process.returncode is None:
                process.terminate()
                with suppress(TimeoutError):
                    await asyncio.wait_for(process.wait(), 10)
            if process.returncode is None:
                process.kill()
                await process.wait()


async def _ready(client: httpx2.AsyncClient, process: asyncio.subprocess.Process, log: Path) -> None:
    deadline = asyncio.get_running_loop().time() + START_LIMIT_S
    while asyncio.get_running_loop().time() < deadline:
        if process.returncode is not None:
            raise DemoError(f"the service ended with {process.returncode} before it was ready; see {log}")
        with suppress(httpx2.TransportError):
            if (await client.get("/health")).status_code == 200:
                return
        await asyncio.sleep(0.1)
    raise DemoError(f"the service was not ready within {START_LIMIT_S:g} s; see {log}")


async def call(client: httpx2.AsyncClient, method: str, path: str, **options: Any) -> Any:
    """Send one REST call and return the JSON. Raises DemoError with the problem's detail for an error status."""
    answer = await client.request(method, path, **options)
    if answer.status_code >= 400:
        detail = answer.json().get("detail", answer.text) if "json" in answer.headers["content-type"] else answer.text
        raise DemoError(f"{method} {path}: {answer.status_code} {detail}")
    return answer.json()


async def planned(client: httpx2.AsyncClient, scenario: Scenario) -> str:
    """Return the id of the plan that the service makes of a scenario, once it is there. Raises DemoError."""
    made = await call(client, "POST", "/v1/plans", params=LOOK, json=scenario.model_dump(mode="json"))
    while made["status"] in UNFINISHED:
        made = await call(client, "GET", f"/v1/plans/{made['id']}", params=LOOK)
    return str(made["id"])
