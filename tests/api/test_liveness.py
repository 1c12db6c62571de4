"""The dead man's switch: vehicles hear us only while the workers that replan in flight answer."""

import asyncio
import gc
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import psutil
import pytest
from fastapi.testclient import TestClient

from skyfolio.api.plans.jobs import Job
from skyfolio.api.plans.liveness import COLD_STUCK_S, SILENT_S, STUCK_S, WorkerHeartbeat, WorkerHeartbeats
from skyfolio.api.plans.solver import Lane, LaneName
from skyfolio.planner import EXAMPLES, Scenario, Uav, User
from tests.api.asking import events_of
from tests.api.flying import FleetThread, Flight, service

SCENARIO = EXAMPLES["minimal"]()


def pids(lane: Lane) -> list[int]:
    return list(lane._pool._processes)


async def until(condition: Callable[[], bool], limit_s: float = 90.0) -> None:
    async with asyncio.timeout(limit_s):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


@pytest.fixture
def lane() -> Iterator[Lane]:
    made = Lane(1, 8)
    yield made
    for pid in pids(made):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    made.close()


def large() -> Scenario:
    """Ten UAVs, a hundred and eighty users and two hundred slots: some tenths of a second of solving."""
    uavs = [Uav(id=f"uav-{n}", start_m=(50 + n % 5 * 200, 50 + n // 5 * 200), max_speed_mps=5) for n in range(10)]
    users = [User(id=f"user-{n}", position_m=(n * 37 % 1000, n * 91 % 1000)) for n in range(180)]
    return EXAMPLES["paper"]().with_changes(slots=200, area_m=((0, 0), (1000, 1000)), uavs=uavs, users=users)


async def test_a_worker_that_was_never_needed_is_not_missed_and_a_busy_one_answers(lane: Lane) -> None:
    assert lane.answers
    await lane.warm_up()
    worker = psutil.Process(*pids(lane))
    began_s = beaten_s = busy_s(worker)
    silent_s = worst_s = 0.0
    solving = asyncio.gather(*(lane.solve(Job(scenario=large().model_dump_json())) for _ in range(8)))
    while not solving.done():
        before_s, silent_s = silent_s, lane._heartbeats.silent_for_s()
        if silent_s < before_s:
            beaten_s = busy_s(worker)
        worst_s = max(worst_s, busy_s(worker) - beaten_s)
        await asyncio.sleep(0.01)
    assert busy_s(worker) - began_s > 1.0
    assert worst_s < 2.0, "of its own seconds on a core: a loaded machine gives it few"
    await until(lambda: lane.answers)


def busy_s(process: psutil.Process) -> float:
    """Seconds that a process has had a core."""
    spent = process.cpu_times()
    return float(spent.user + spent.system)


async def test_a_stopped_worker_does_not_answer_until_it_goes_on(lane: Lane) -> None:
    await lane.warm_up()
    (pid,) = pids(lane)
    os.kill(pid, signal.SIGSTOP)
    await until(lambda: not lane.answers)
    os.kill(pid, signal.SIGCONT)
    await until(lambda: lane.answers)


async def test_a_worker_that_stays_stuck_is_killed_and_replaced(lane: Lane, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyfolio.api.plans.liveness.STUCK_S", 1.0)
    await lane.warm_up()
    (pid,) = pids(lane)
    os.kill(pid, signal.SIGSTOP)
    await until(lambda: lane._heartbeats.silent_for_s() > 1.2)
    await lane.tend()
    await until(lane._heartbeats.gone)
    await lane.tend()
    assert lane.answers
    assert pids(lane) != [pid]


class Clock:
    """Monotonic time that a test moves."""

    def __init__(self) -> None:
        self.now = 1_000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def beats(monkeypatch: pytest.MonkeyPatch) -> tuple[WorkerHeartbeats, WorkerHeartbeat, Clock, list[int]]:
    """A worker's place among the beats, where time stands still, and whom the watch killed."""
    clock, killed = Clock(), list[int]()
    monkeypatch.setattr("skyfolio.api.plans.liveness.time", clock)
    monkeypatch.setattr(
        "skyfolio.api.plans.liveness.os.kill", lambda pid, number: killed.append(pid) if number else None
    )
    made = WorkerHeartbeats(multiprocessing.get_context("spawn"), 1)
    place = WorkerHeartbeat(*made.shared)
    place.beat()
    return made, place, clock, killed


def test_a_warm_worker_that_is_silent_does_not_answer_and_is_killed(
    beats: tuple[WorkerHeartbeats, WorkerHeartbeat, Clock, list[int]],
) -> None:
    watch, place, clock, killed = beats
    place.set_cold(False)
    clock.now += SILENT_S + 0.1
    assert not watch.answer()
    clock.now += STUCK_S
    watch.kill_stuck()
    assert killed == [os.getpid()]


def test_a_worker_that_compiles_is_given_time_and_is_not_killed(
    beats: tuple[WorkerHeartbeats, WorkerHeartbeat, Clock, list[int]],
) -> None:
    watch, place, clock, killed = beats
    place.set_cold(False)
    place.note_compiling(1)
    clock.now += STUCK_S + 1.0
    watch.kill_stuck()
    assert watch.answer()
    assert killed == []
    place.note_compiling(0)
    clock.now += STUCK_S + 1.0
    watch.kill_stuck()
    assert killed == [os.getpid()]


def test_a_worker_that_hangs_while_it_compiles_is_killed_later_each_time(
    beats: tuple[WorkerHeartbeats, WorkerHeartbeat, Clock, list[int]],
) -> None:
    watch, place, clock, killed = beats
    place.note_compiling(3)
    clock.now += COLD_STUCK_S + 1.0
    watch.kill_stuck(patience=2.0)
    assert killed == []
    assert not watch.answer()
    watch.kill_stuck(patience=1.0)
    assert killed == [os.getpid()]


async def test_workers_that_end_before_they_are_warm_are_watched_more_patiently_and_do_not_answer(lane: Lane) -> None:
    patient = []
    for _ in range(3):
        lane.begin()
        lane._renew(lane._pool)
        patient.append(lane._patience)
    assert patient == [2.0, 4.0, 8.0]
    answered = [lane.answers]
    await lane.warm_up()
    answered.append(lane.answers)
    assert answered == [False, True]
    assert lane._patience == 1.0


async def test_a_worker_has_all_kernels_before_its_first_job(lane: Lane) -> None:
    lane.begin()
    began = lane.answers, lane.warm
    solved = await lane.solve(Job(scenario=SCENARIO.model_dump_json()))
    assert solved.plan
    assert began == (True, False)  # it was given time to start
    assert lane.warm
    assert not lane._heartbeats.cold


def test_clients_what_ifs_and_health_leave_the_workers_of_flights_alone(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    lane = client.app.state.service.solver[LaneName.FLIGHT]  # type: ignore[attr-defined]
    jobs: list[str] = []
    monkeypatch.setattr(lane, "solve", lambda *_: jobs.append("solve"))
    monkeypatch.setattr(lane, "reserve", lambda: jobs.append("reserve"))
    made = client.post("/v1/plans", params={"wait_s": 60}, json=SCENARIO.model_dump(mode="json")).json()
    table = client.get(f"/v1/plans/{made['id']}/contingencies", params={"wait_s": 60})
    assert table.status_code == 200
    assert table.json()["complete"]
    assert client.get("/health").json()["status"] == "ok"
    assert jobs == []


async def test_a_worker_that_dies_after_its_request_was_cancelled_leaves_no_error_behind(lane: Lane) -> None:
    await lane.warm_up()
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: reported.append(context))
    solving = asyncio.create_task(lane.solve(Job(scenario=large().model_dump_json())))
    await until(lambda: lane.busy == 1)
    solving.cancel()
    await asyncio.wait([solving])
    del solving  # and with it the frames that still know of the job
    (pid,) = pids(lane)
    os.kill(pid, signal.SIGKILL)
    await until(lambda: not pids(lane) or pids(lane) != [pid] or lane._pool._broken)
    await asyncio.sleep(0.1)
    gc.collect()
    assert reported == []


async def test_an_end_waits_for_no_worker() -> None:
    lane = Lane(1, 8)
    await lane.warm_up()
    (pid,) = pids(lane)
    os.kill(pid, signal.SIGSTOP)  # it will not end by itself
    await asyncio.to_thread(lane.close)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


async def test_a_lane_that_is_closed_while_a_worker_starts_makes_no_other() -> None:
    lane = Lane(1, 8)
    starting = asyncio.create_task(lane.warm_up())
    await until(lambda: bool(pids(lane)))
    pool = lane._pool
    await asyncio.to_thread(lane.close)
    await starting
    assert lane._pool is pool


class Listener:
    """HEARTBEATs of the service that a simulated vehicle has heard."""

    def __init__(self, fleet: FleetThread) -> None:
        self._fleet = fleet

    def heard(self) -> int:
        return sum(one.name == "HEARTBEAT" for one in list(self._fleet.fleet.truth.messages) if one.direction == "in")


def wait(condition: Callable[[], bool], limit_s: float = 90.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "not so in time"
        time.sleep(0.05)


@contextmanager
def watched() -> Iterator[tuple[TestClient, Lane, Listener]]:
    with service(1.0) as (http, endpoint):
        fleet = FleetThread(SCENARIO, endpoint, 1.0)
        try:
            flown = Flight(http, fleet, SCENARIO)
            wait(lambda: http.get("/ready").status_code == 200)
            lane = flown.service.solver[LaneName.FLIGHT]
            assert isinstance(lane, Lane)
            yield http, lane, Listener(fleet)
        finally:
            fleet.stop()


def beats_again(listener: Listener) -> None:
    before = listener.heard()
    wait(lambda: listener.heard() > before)


def metric(http: TestClient, name: str) -> float:
    (line,) = [line for line in http.get("/metrics").text.splitlines() if line.startswith(name)]
    return float(line.rsplit(" ", 1)[1])


def switches(http: TestClient) -> list[Any]:
    return [event["data"]["sent"] for event in events_of(http) if event["kind"] == "gcs_heartbeat"]


@pytest.mark.e2e
def test_vehicles_hear_nothing_of_us_while_the_solver_is_stopped_or_dead_and_hear_us_again_unasked() -> None:
    with watched() as (http, lane, listener):
        beats_again(listener)
        (pid,) = pids(lane)
        os.kill(pid, signal.SIGSTOP)
        try:
            wait(lambda: not lane.answers)
            said = http.get("/ready")
            assert said.status_code == 503
            assert said.json()["checks"]["solver"] == "no answer from flight"
            assert said.json()["checks"]["heartbeat"] == "not sent to vehicles: no worker can replan"
            assert metric(http, 'skyfolio_solver_answers{lane="flight"}') == 0.0
            time.sleep(0.5)  # what was on its way
            before = listener.heard()
            time.sleep(3.0)
            assert listener.heard() == before
        finally:
            os.kill(pid, signal.SIGCONT)
        beats_again(listener)
        assert metric(http, 'skyfolio_solver_answers{lane="flight"}') == 1.0
        wait(lambda: switches(http)[-2:] == [False, True])
        assert http.get("/ready").status_code == 200
        os.kill(pid, signal.SIGKILL)
        wait(lambda: not lane.answers)
        wait(lambda: lane.answers)
        beats_again(listener)
        assert pids(lane) != [pid]
        assert http.get("/health").status_code == 200
