"""The drill: plan over REST, launch the simulated fleet, crash one UAV, follow what the service does."""

from __future__ import annotations

import asyncio
import socket
import time
from typing import Any

import httpx2
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from skyfolio import sim
from skyfolio.api.client import Client
from skyfolio.api.fleet.simulated_fleet import hills_of, specs_at_starts
from skyfolio.api.flights.base_stations import ASK_EVERY_S, BaseStations, Log, radio_truth
from skyfolio.api.flights.operation_views import ENDED as ENDED_STATES
from skyfolio.api.lab.demo import truth
from skyfolio.api.lab.demo.client import DemoError, call, free_port, planned, service_process
from skyfolio.api.lab.demo.orders import DemoConfig, Outcome
from skyfolio.api.lab.demo.page import result_table, write_page
from skyfolio.api.lab.demo.report import DemoReport
from skyfolio.api.lab.radio_client import RestPort
from skyfolio.planner import Plan, Scenario

POLL_S = 0.1
ENDED = {state.value for state in ENDED_STATES}


async def run_demo(config: DemoConfig, *, quiet: bool = False) -> DemoReport:
    """Fly the drill and judge it; writes `report.html` and `report.json` into `config.out`."""
    scenario = config.scenario
    _check(config, scenario)
    config.out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    endpoint = f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    fleet = sim.Fleet(
        specs_at_starts(scenario),
        clock=sim.ScaledClock(config.speedup),
        endpoint=f"udpout://{endpoint}",
        hills=hills_of(scenario),
    )
    console = Console(quiet=quiet, stderr=quiet)
    with _progress(console) as progress:
        drill = Drill(config, scenario, fleet, progress)
        log = config.out / "service.log"
        async with service_process(config.speedup, f"udpin://{endpoint}", log) as client, fleet:
            outcome = await drill.fly(client)
    report = truth.judge(config, scenario, fleet.truth, outcome, wall_s=time.monotonic() - began)
    (config.out / "report.json").write_text(report.model_dump_json(indent=2), encoding="utf-8")
    write_page(report, config.out / "report.html")
    console.print(result_table(report))
    console.print(f"report: {config.out / 'report.html'}, {config.out / 'report.json'}")
    return report


class Drill:
    """One drill in progress."""

    def __init__(self, config: DemoConfig, scenario: Scenario, fleet: sim.Fleet, progress: Progress) -> None:
        self._config, self._scenario, self._fleet = config, scenario, fleet
        self._progress = progress
        self._bar = progress.add_task("starting the service", total=scenario.slots)

    async def fly(self, client: httpx2.AsyncClient) -> Outcome:
        """Fly the drill, from the plan to the landing. Raises DemoError when the service refuses something."""
        self._say("planning")
        plan_id = await planned(client, self._scenario)
        for system_id, uav in enumerate(self._scenario.uavs, start=1):
            await call(client, "POST", "/v1/fleet/vehicles", json={"uav_id": uav.id, "system_id": system_id})
        order = {"plan_id": plan_id, "replanning": "auto" if self._config.replan else "off"}
        operation = await call(client, "POST", "/v1/operations", json=order)
        path = f"/v1/operations/{operation['id']}"
        with Client(str(client.base_url)) as rest:
            stations = self._stations(RestPort(rest, operation["id"]))
            serving = asyncio.create_task(self._serve(stations), name="base-stations")
            try:
                outcome = await self._flown(client, path, stations.log)
                await serving  # it ends with the operation
            finally:
                serving.cancel()
        return outcome

    async def _flown(self, client: httpx2.AsyncClient, path: str, log: Log) -> Outcome:
        operation = await self._until(client, path, {"flying"} | ENDED)
        slot0_s = await self._slot0(client, path)
        kill_at_s = slot0_s + (self._config.kill_slot - 1) * self._scenario.slot_duration_s
        system_id = 1 + self._scenario.uav_ids.index(self._config.kill)
        self._fleet.inject(sim.Kill(system_id), at_s=kill_at_s)
        operation = await self._until(client, path, ENDED)
        plans = [
            Plan.model_validate(await call(client, "GET", f"/v1/plans/{plan_id}")) for plan_id in operation["plan_ids"]
        ]
        return Outcome(operation, plans, slot0_s, kill_at_s, log.rates_bps)

    def _stations(self, port: RestPort) -> BaseStations:
        """Return the base stations of the fleet, which serve what the service allocates, and measure."""
        systems = {uav: number for number, uav in enumerate(self._scenario.uav_ids, start=1)}
        return BaseStations(self._fleet, radio_truth(self._fleet, self._scenario), port, systems, keep=True)

    async def _serve(self, stations: BaseStations) -> None:
        while await stations.step():  # noqa: ASYNC110 - it asks another process
            await asyncio.sleep(ASK_EVERY_S / self._config.speedup)

    async def _slot0(self, client: httpx2.AsyncClient, path: str) -> float:
        """Return when slot 0 began on the simulator's clock, from the quickest of a few round trips."""
        best = (float("inf"), 0.0)
        for _ in range(5):
            asked_s = self._fleet.clock.now()
            operation = await call(client, "GET", path)
            answered = self._fleet.clock.now()
            if operation["elapsed_s"] is None:
                raise DemoError(f"the operation is {operation['state']}: {operation['error']}")
            best = min(best, (answered - asked_s, (asked_s + answered) / 2 - operation["elapsed_s"]))
        return best[1]

    async def _until(self, client: httpx2.AsyncClient, path: str, states: set[str]) -> dict[str, Any]:
        while True:
            operation: dict[str, Any] = await call(client, "GET", path)
            self._show(operation)
            if operation["state"] in states:
                return operation
            await asyncio.sleep(POLL_S)

    def _show(self, operation: dict[str, Any]) -> None:
        words = [str(operation["state"])]
        if operation["slot"] is not None:
            words.append(f"slot {operation['slot'] + 1}/{self._scenario.slots}")
        words += [f"[red]{uav} lost[/]" for uav in operation["lost"]]
        words += [f"[green]replanned in {r['replan_ms']:.0f} ms[/]" for r in operation["recoveries"] if r["replan_ms"]]
        self._say(", ".join(words))
        done = (
            self._scenario.slots
            if operation["state"] in {"landing", "completed", "completed_partly"}
            else operation["slot"] or 0
        )
        self._progress.update(self._bar, completed=done)

    def _say(self, text: str) -> None:
        self._progress.update(self._bar, description=text)


def _check(config: DemoConfig, scenario: Scenario) -> None:
    if config.kill not in scenario.uav_ids:
        raise DemoError(f"kill: {config.kill!r} must be one of {', '.join(scenario.uav_ids)}")
    if not 2 <= config.kill_slot <= scenario.slots - 3:
        raise DemoError(f"kill_slot: {config.kill_slot} must lie in 2..{scenario.slots - 3}")


def _progress(console: Console) -> Progress:
    return Progress(
        SpinnerColumn(),
        BarColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=console,
        disable=console.quiet,
    )
