"""`skyfolio bench service`: the service as a process of its own, measured from outside.

Four figures: plans end to end, requests a second, event streams, and from a declared loss to new missions on all
survivors. Nothing is taken from the service's own clocks but the last, which is what it has written into its journal.
A fifth is measured from inside (`loop.py`): how long what a large fleet asks for holds the event loop.
"""

from __future__ import annotations

import asyncio
import os
import platform
import socket
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import httpx2
from rich.table import Table

from skyfolio import sim
from skyfolio.api.fleet.simulated_fleet import specs_at_starts
from skyfolio.api.lab.bench.loop import loop_figures
from skyfolio.api.lab.bench.streams import streams_figures
from skyfolio.api.lab.demo.client import call, free_port, planned, service_process
from skyfolio.planner import EXAMPLES, Scenario, Uav, User

RATE_PER_S = 200
RATE_FOR_S = 10.0
WARM_UP = 20
CLIENTS = 32


def service_figures(runs: int, only: set[str] | None = None) -> dict[str, Any]:
    """Measure everything, or what `only` names: plans, rate, streams, recovery, loop.

    runs: plans measured end to end.
    """
    return asyncio.run(_figures(runs, only or {"plans", "rate", "streams", "recovery", "loop"}))


async def _figures(runs: int, topics: set[str]) -> dict[str, Any]:
    parts: dict[str, Callable[[], Awaitable[dict[str, Any]]]] = {
        "plans": lambda: _with_service(lambda client: _plans(client, runs)),
        "rate": rate_figures,
        "streams": streams_figures,
        "recovery": _recoveries,
        "loop": loop_figures,
    }
    cores = len(os.sched_getaffinity(0))
    os.environ.setdefault("SKYFOLIO_WORKERS", str(cores))  # of the services started here
    machine = {
        "cores": cores,
        "workers": int(os.environ["SKYFOLIO_WORKERS"]),
        "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(),
    }
    figures: dict[str, Any] = {"machine": machine}
    for name, measure in parts.items():
        if name in topics:
            figures[name] = await measure()
    return figures


async def _with_service(measure: Callable[[httpx2.AsyncClient], Awaitable[dict[str, Any]]]) -> dict[str, Any]:
    url = f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    with tempfile.TemporaryDirectory() as folder:
        async with service_process(1.0, url, Path(folder) / "service.log") as client:
            await _warm(client)
            return await measure(client)


async def _plans(client: httpx2.AsyncClient, runs: int) -> dict[str, Any]:
    """Measure milliseconds of `POST plans?wait_s=5` at the letter's size, one by one, and the solver's share."""
    body = EXAMPLES["paper"]().model_dump_json()
    figures = {}
    for name, params in (("as_it_is", {}), ("32_starts", {"starts": 32})):
        took_ms, solve_ms = [], []
        for number in range(WARM_UP + runs):
            began = time.perf_counter()
            answer = await _post_plan(client, body, **params)
            if number >= WARM_UP:
                took_ms.append((time.perf_counter() - began) * 1e3)
                solve_ms.append(answer.json()["solve_ms"])
        figures[name] = {"runs": runs, **_spread(took_ms, "ms"), "solve_p50_ms": median(solve_ms)}
    return figures


async def rate_figures(seconds: float = RATE_FOR_S) -> dict[str, Any]:
    """Submit small plans to a service of its own at a fixed rate for so long; every result is checked."""
    return await _with_service(lambda client: _rate(client, seconds))


async def _rate(client: httpx2.AsyncClient, for_s: float) -> dict[str, Any]:
    """Submit small plans at a fixed rate, whether or not earlier ones are done; every result is checked."""
    body = EXAMPLES["minimal"]().model_dump_json()
    for _ in range(WARM_UP):
        await _post_plan(client, body)
    total = int(RATE_PER_S * for_s)
    took_ms: list[float] = []
    errors: dict[str, int] = {}
    turns = asyncio.Semaphore(CLIENTS)
    began = time.perf_counter()

    async def one(number: int) -> None:
        due = began + number / RATE_PER_S
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
        async with turns:
            answer = await client.post("/v1/plans", params={"wait_s": 5}, content=body, headers=_JSON)
        if answer.status_code != 200:
            errors[str(answer.status_code)] = errors.get(str(answer.status_code), 0) + 1
        took_ms.append((time.perf_counter() - due) * 1e3)

    await asyncio.gather(*(one(number) for number in range(total)))
    seconds = time.perf_counter() - began
    lag = await _loop_lag(client)
    return {
        "asked_per_s": RATE_PER_S,
        "served_per_s": total / seconds,
        "errors": errors,
        **_spread(took_ms, "ms"),
        **lag,
    }


async def _loop_lag(client: httpx2.AsyncClient) -> dict[str, Any]:
    """Return how often the service's event loop was blocked for longer than 50 ms, out of how many samples."""
    buckets = {}
    for line in (await client.get("/metrics")).text.splitlines():
        if line.startswith("skyfolio_event_loop_lag_seconds_bucket"):
            edge = line.split('le="', 1)[1].split('"', 1)[0]
            buckets[edge] = float(line.rsplit(" ", 1)[1])
    return {"loop_over_50_ms": int(buckets["+Inf"] - buckets["0.05"]), "loop_looks": int(buckets["+Inf"])}


async def _recoveries() -> dict[str, Any]:
    """Measure wall seconds from the declared loss to the last survivor seen flying its new mission."""
    return {
        "3_uavs": await _recovery(EXAMPLES["paper"]().with_changes(altitude_m=15.0), runs=3),
        "50_uavs": await _recovery(grid_scenario(50), runs=1),
    }


async def _recovery(scenario: Scenario, runs: int) -> dict[str, Any]:
    seconds, outcomes, sources = [], [], []
    for _ in range(runs):
        report = await _one_loss(scenario)
        timings = report["timings_s"]
        seconds.append(sum(value for step, value in timings.items() if step not in {"proposed", "closed"}))
        outcomes.append(report["outcome"])
        sources.append(report["source"])
    return {"runs": runs, "p50_s": median(seconds), "max_s": max(seconds), "outcomes": outcomes, "sources": sources}


async def _one_loss(scenario: Scenario) -> dict[str, Any]:
    async with airborne(scenario) as (client, fleet, path):
        fleet.inject(sim.Kill(len(scenario.uavs)))
        operation = await _until(client, path, lambda operation: operation["recoveries"] or operation["error"])
        report: dict[str, Any] = operation["recoveries"][0]
        return report


@asynccontextmanager
async def airborne(scenario: Scenario) -> AsyncIterator[tuple[httpx2.AsyncClient, sim.Fleet, str]]:
    """Have a service of its own fly a plan of this scenario in real time; give client, fleet, path from slot 1 on."""
    endpoint = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    fleet = sim.Fleet(specs_at_starts(scenario), clock=sim.ScaledClock(1.0), endpoint=f"udpout://{endpoint}")
    async with AsyncExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        log = Path(folder) / "service.log"
        client = await stack.enter_async_context(service_process(1.0, f"udpin://{endpoint}", log))
        await _warm(client)
        await stack.enter_async_context(fleet)
        plan_id = await planned(client, scenario)
        for number, uav in enumerate(scenario.uav_ids, start=1):
            await call(client, "POST", "/v1/fleet/vehicles", json={"uav_id": uav, "system_id": number})
        path = f"/v1/operations/{(await call(client, 'POST', '/v1/operations', json={'plan_id': plan_id}))['id']}"
        await _until(client, path, lambda operation: operation["slot"] == 1 or operation["error"])
        yield client, fleet, path


async def _until(client: httpx2.AsyncClient, path: str, is_so: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    async with asyncio.timeout(180):
        while True:
            operation: dict[str, Any] = await call(client, "GET", path)
            if is_so(operation):
                return operation
            await asyncio.sleep(0.2)


def grid_scenario(uavs: int) -> Scenario:
    """Return a scenario of that many UAVs 60 m apart over two users each, twelve slots."""
    columns = 10
    starts = [(60.0 + 60 * (n % columns), 60.0 + 60 * (n // columns)) for n in range(uavs)]
    side = 120.0 + 60 * columns
    paper = EXAMPLES["paper"]()
    return paper.with_changes(
        area_m=((0.0, 0.0), (side, side)),
        slots=12,
        altitude_m=15.0,
        uavs=tuple(Uav(id=f"uav-{n + 1}", start_m=start) for n, start in enumerate(starts)),
        users=tuple(
            User(id=f"user-{n + 1}", position_m=(starts[n // 2][0] + (-9, 13)[n % 2], starts[n // 2][1] + 7))
            for n in range(2 * uavs)
        ),
    )


_JSON = {"content-type": "application/json"}


async def _warm(client: httpx2.AsyncClient) -> None:
    """Wait until every worker has compiled what it runs."""
    async with asyncio.timeout(300):
        while (await client.get("/ready")).status_code != 200:  # noqa: ASYNC110
            await asyncio.sleep(0.2)


async def _post_plan(client: httpx2.AsyncClient, body: str, **params: int) -> httpx2.Response:
    answer = await client.post("/v1/plans", params={"wait_s": 60, **params}, content=body, headers=_JSON)
    if answer.status_code != 200:
        raise RuntimeError(f"POST /v1/plans: {answer.status_code} {answer.text[:200]}")
    return answer


def _spread(values: list[float], unit: str) -> dict[str, float]:
    return {
        f"p50_{unit}": median(values),
        f"p99_{unit}": quantiles(values, n=100)[98] if len(values) > 1 else values[0],
        f"max_{unit}": max(values),
    }


def table(figures: dict[str, Any]) -> Table:
    """Return the figures as a table for a terminal."""
    shown = Table("what", "figure", title="service")
    for name, rows in figures.items():
        for key, value in rows.items():
            shown.add_row(f"{name}: {key}", f"{value:.3g}" if isinstance(value, float) else str(value))
    return shown
