"""A service whose solves run in a real Dask cluster, which is killed."""

import asyncio
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from fastapi.testclient import TestClient

from skyfolio.api.client import Client
from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.plans.dask_link import DaskLink
from skyfolio.api.plans.solver import LaneName
from skyfolio.planner import EXAMPLES, Disturbances, Losses, Plan, Trial, assess, plan
from tests.sweep.dask_processes import Cluster, dask_cluster

LONG = EXAMPLES["paper"]().with_changes(slots=400).model_dump(mode="json")
STARTS = {"starts": 64}


@contextmanager
def serving(cluster: Cluster) -> Iterator[TestClient]:
    """A service whose clients' solves go to the cluster, once they do."""
    settings = Settings(solver=f"dask+{cluster.address}", warm_up=False, solve_deadline_s=120)
    with TestClient(create_app(settings)) as http:
        eventually(lambda: moves(http), "the cluster is reached")
        yield http


def eventually(found: Callable[[], Any], what: str) -> Any:
    until = time.monotonic() + 120
    while not (value := found()):
        assert time.monotonic() < until, what
        time.sleep(0.1)
    return value


def moves(http: TestClient) -> list[str]:
    """Where solves have gone, in the words of the events."""
    text = http.get("/v1/events", params={"follow": "false"}, headers={"Last-Event-ID": "0"}).text
    return [line for line in text.splitlines() if '"solver_moved"' in line]


def own_workers_begun(http: TestClient) -> bool:
    """Whether the service has needed a worker of its own for clients."""
    app: Any = http.app
    return bool(app.state.service.solver[LaneName.REQUESTS]._heartbeats.begun)


@pytest.mark.e2e
def test_plans_and_assessments_are_made_in_the_cluster_shown_and_cancelled_and_flights_are_solved_here() -> None:
    with dask_cluster(1) as cluster, serving(cluster) as http:
        are_those_of_the_planner(http)
        is_cancelled_with_the_best_so_far(http)
        assert not own_workers_begun(http)
        assert http.get("/health").status_code == 200
        assert "cluster" not in http.get("/ready").json()["checks"]
        app: Any = http.app
        lanes = app.state.service.solver.lanes
        assert type(lanes[LaneName.FLIGHT]).__name__ == "Lane", "it never leaves the machine"
        assert lanes[LaneName.REQUESTS]._priority > lanes[LaneName.AHEAD]._priority


def are_those_of_the_planner(http: TestClient) -> None:
    """A plan and an assessment from the cluster are what the planner makes of them."""
    minimal = EXAMPLES["minimal"]()
    answer = http.post("/v1/plans", params={"starts": 4, "wait_s": 60}, json=minimal.model_dump(mode="json"))
    made = Plan.model_validate_json(answer.content)
    assert made.trajectories_m == plan(minimal, n_starts=4).trajectories_m
    trial = Trial(disturbances=Disturbances(draws=5), losses=Losses(at_once=1))
    assert Client(http=http).robustness(made.id, trial, deadline_s=60) == assess(made, trial)


def is_cancelled_with_the_best_so_far(http: TestClient) -> None:
    """A plan in the cluster shows its progress meanwhile."""
    location = http.post("/v1/plans", params=STARTS, json=LONG).headers["Location"]
    shown = eventually(lambda: (http.get(location).json() or {}).get("best"), "the best plan so far is shown")
    assert Plan.model_validate(shown).status == "running"
    assert http.get(location).json()["progress"]["iterations"] >= 1
    ended = http.post(f"{location}:cancel", params={"wait_s": 60}).json()
    assert ended["status"] == "cancelled"
    assert ended["summary"]["utility_bps"] >= shown["summary"]["utility_bps"]


@pytest.mark.e2e
def test_a_scheduler_that_comes_back_is_used_again_and_when_it_dies_in_mid_solve_a_local_worker_goes_on() -> None:
    with dask_cluster(1) as cluster, serving(cluster) as http:
        cluster.kill_scheduler()
        eventually(lambda: len(moves(http)) == 2, "it is gone")
        cluster.start_again()
        eventually(lambda: len(moves(http)) == 3, "it is there again")
        assert Client(http=http).plan(EXAMPLES["minimal"]()).status == "succeeded"
        assert not own_workers_begun(http)
        location = http.post("/v1/plans", params=STARTS, json=LONG).headers["Location"]
        eventually(lambda: (http.get(location).json() or {}).get("progress"), "it runs")
        cluster.kill_scheduler()
        eventually(lambda: len(moves(http)) == 4, "the event")
        assert '"to":"local workers"' in moves(http)[-1]
        assert "went away" in moves(http)[-1]
        ready = http.get("/ready").json()
        assert ready["checks"]["cluster"].startswith("ok: local workers solve instead; ")
        eventually(lambda: own_workers_begun(http), "a worker of its own has begun")
        eventually(lambda: (http.get(location).json() or {}).get("best"), "the plan goes on here")
        assert http.post(f"{location}:cancel", params={"wait_s": 60}).json()["status"] == "cancelled"
        assert Client(http=http).plan(EXAMPLES["minimal"]()).status == "succeeded"


@pytest.mark.e2e
async def test_links_end_at_once_while_they_say_goodbye_to_a_scheduler_that_died() -> None:
    with dask_cluster(1) as cluster:
        links = [Kept(cluster) for _ in range(4)]
        await asyncio.gather(*(link.is_up() for link in links))
        cluster.kill_scheduler()
        await asyncio.gather(
            *(link.ends_at_once(later_s) for link, later_s in zip(links, (0.0, 0.05, 0.3, 1.0), strict=True))
        )


class Kept:
    """A link to a cluster, and what it tells."""

    def __init__(self, cluster: Cluster) -> None:
        link = DaskLink(cluster.address)
        self._told = asyncio.Queue[str]()
        link.tell = lambda _, **data: self._told.put_nowait(data["because"])
        self._keeping = asyncio.create_task(link.keep())

    async def is_up(self) -> None:
        assert await asyncio.wait_for(self._told.get(), 60) == ""

    async def ends_at_once(self, later_s: float) -> None:
        """End it so long after its scheduler was found dead."""
        assert await asyncio.wait_for(self._told.get(), 60)
        await asyncio.sleep(later_s)
        self._keeping.cancel()
        assert (await asyncio.wait([self._keeping], timeout=4.0))[0]
        assert self._keeping.cancelled()
