"""A whole service in virtual time: the same seed gives the same, a kill leaves nothing behind, nothing takes time."""

from __future__ import annotations

import asyncio
import hashlib
import os
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from skyfolio import sim
from skyfolio.api.common.idempotency import fresh
from skyfolio.api.flights.operation_views import ENDED, OperationView, State
from skyfolio.api.lab.virtual.ground import Ground
from skyfolio.api.lab.virtual.loop import DeadlockError, VirtualLoop, run
from skyfolio.api.lab.virtual.wire import MemoryEndpoint, Port
from skyfolio.mavlink_bridge import ConnectionFailed
from skyfolio.planner import EXAMPLES

ROOT = Path(__file__).resolve().parents[2]
MINIMAL = EXAMPLES["minimal"]().with_changes(altitude_m=10.0)
THREE = EXAMPLES["paper"]().with_changes(altitude_m=10.0, slots=12)


async def flown(ground: Ground, policy: str = "auto") -> str:
    """The operation that flies a plan for this ground's scenario, once slot 0 has begun."""
    service = await ground.start()
    await ground.register()
    record = await ground.ask(service.plans.submit(ground.scenario, fresh("plan")))
    await ground.ask(service.plans.wait(record, 60.0))
    operation = await ground.ask(service.operations.start(record.id, policy, fresh("operation")))  # type: ignore[arg-type]
    await until(ground, operation.id, lambda view: view.state == State.FLYING)
    return operation.id


async def until(
    ground: Ground, operation_id: str, is_so: Callable[[OperationView], object], limit_s: float = 400.0
) -> OperationView:
    """The operation once it is so."""
    assert ground.service is not None
    until_s = ground.now_s + limit_s
    while True:
        view = await ground.ask(ground.service.operations.view(operation_id))
        if is_so(view):
            return view
        assert ground.now_s < until_s, f"not so after {limit_s:g} s: {view.state} {view.error}"
        await asyncio.sleep(0.1)


def on_ground(work: Callable[[Ground], Awaitable[object]], *, seed: int = 3, **options: object) -> None:
    async def carry_out() -> None:
        async with Ground(THREE, seed=seed, **options) as ground:  # type: ignore[arg-type]
            await work(ground)
        assert ground.alive_tasks == []

    run(carry_out())


def ended(view: OperationView) -> bool:
    return view.state in ENDED


def test_a_lost_uav_is_replaced_by_a_new_plan_for_the_others() -> None:
    async def fly(ground: Ground) -> None:
        operation_id = await flown(ground)
        ground.fleet.inject(sim.Kill(3))
        view = await until(ground, operation_id, ended)
        assert (view.state, view.lost) == (State.COMPLETED, ["uav-3"])
        assert [report.outcome for report in view.recoveries] == ["flying"]

    on_ground(fly)


def test_a_killed_service_writes_and_sends_nothing_more_and_the_next_one_goes_on() -> None:
    async def fly(ground: Ground) -> None:
        operation_id = await flown(ground)
        await asyncio.sleep(12.0)
        ground.kill()
        stored, received = len(ground.stored_events()), len(ground.fleet.truth.messages)
        await asyncio.sleep(3.0)
        assert (len(ground.stored_events()), len(ground.fleet.truth.messages)) == (stored, received)
        assert ground.alive_tasks == []
        await ground.start()
        view = await until(ground, operation_id, ended)
        assert (view.state, view.error) == (State.COMPLETED, None)
        assert [event.id for event in ground.stored_events()] == list(range(1, len(ground.stored_events()) + 1))

    on_ground(fly)


def test_a_port_has_one_holder_until_that_closes_it_or_dies() -> None:
    async def hold(ground: Ground) -> None:
        dead: set[str] = set()

        def end(port: Port, url: str) -> MemoryEndpoint:
            return MemoryEndpoint(port, url, lambda _end, _frames: None, alive=lambda: url not in dead)

        port = Port(ground.fleet)
        first = end(port, "first")
        await first.open()
        with pytest.raises(ConnectionFailed, match="second"):
            await end(port, "second").open()
        first.close()
        await end(port, "third").open()
        with pytest.raises(ConnectionFailed, match="fourth"):
            await end(port, "fourth").open()
        await end(Port(ground.fleet, place=1), "elsewhere").open()
        dead.add("third")
        await end(port, "fifth").open()

    on_ground(hold)


def test_while_the_disk_is_full_a_flight_goes_on_and_its_events_are_stored_later() -> None:
    async def fly(ground: Ground) -> None:
        operation_id = await flown(ground)
        ground.disk.refuses = "database or disk is full"
        ground.fleet.inject(sim.Kill(2))
        await asyncio.sleep(20.0)
        stored = len(ground.stored_events())
        ground.disk.refuses = None
        view = await until(ground, operation_id, ended)
        assert [report.outcome for report in view.recoveries] == ["flying"]
        assert len(ground.stored_events()) > stored + 5

    on_ground(fly)


def test_both_autopilots_are_flown() -> None:
    async def fly(ground: Ground) -> None:
        assert (await until(ground, await flown(ground), ended)).state == State.COMPLETED

    on_ground(fly, specs=Ground.specs_of(THREE, ("ardupilot", "px4")))


LOG = """
import hashlib, sys
from tests.api.test_virtual_ground import event_log
print(hashlib.sha256(event_log(int(sys.argv[1])).encode()).hexdigest())
"""


def event_log(seed: int) -> str:
    """The event log of a flight with a loss and a killed service."""
    lines: list[str] = []

    async def carry_out() -> None:
        async with Ground(MINIMAL, seed=seed, weather=sim.Weather(gust_mps=1.0, gps_m=0.5)) as ground:
            operation_id = await flown(ground)
            ground.fleet.impair(down=sim.Impairments(loss=0.1))
            await asyncio.sleep(4.0)
            ground.fleet.inject(sim.Kill(2))
            await asyncio.sleep(5.0)
            ground.kill()
            await asyncio.sleep(1.0)
            await ground.start()
            await until(ground, operation_id, ended)
            lines.extend(event.model_dump_json() for event in ground.stored_events())

    run(carry_out())
    return "\n".join(lines)


def test_the_same_seed_gives_the_same_event_log_in_any_process_and_another_seed_another() -> None:
    here = event_log(1)
    assert here == event_log(1)
    environment = {**os.environ, "PYTHONHASHSEED": "1"}  # here it is random
    there = subprocess.run(
        [sys.executable, "-c", LOG, "1"], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert there.stdout.splitlines()[-1] == hashlib.sha256(here.encode()).hexdigest()
    assert event_log(2) != here


def test_nobody_waits_for_ever_in_virtual_time() -> None:
    async def wait() -> None:
        await asyncio.get_running_loop().create_future()

    with asyncio.Runner(loop_factory=VirtualLoop) as runner, pytest.raises(DeadlockError):
        runner.run(wait())
