"""The connection of the service to a Dask scheduler: made again when it is lost, and told about both ways."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any
from uuid import uuid4

import structlog

from skyfolio.api.common.dask_cluster import SchedulerError, joined_cluster
from skyfolio.api.common.planner_identity import OtherPlannerError, planner_identity
from skyfolio.api.plans.dask_work import best_of, run_remotely, stop_job
from skyfolio.api.plans.jobs import Job, Solved

log = structlog.get_logger()
PURPOSE = "solver: Dask"
LOOK_EVERY_S = 0.5
AGAIN_S = 5.0
"""Between two attempts to reach the scheduler."""
Told = Callable[[dict[str, Any]], None]


class DaskLink:
    """One client of a scheduler. `up` says whether jobs can be sent. `tell` receives each change of it."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.tell: Callable[..., Any] = lambda kind, **data: None  # noqa: ARG005
        self.trouble = "it was not reached yet"
        self._client: Any = None
        self._topic = f"skyfolio-{uuid4().hex}"
        self._followers: dict[str, Told] = {}

    @property
    def up(self) -> bool:
        """Return whether the scheduler answers, and has a worker."""
        return self._client is not None

    async def keep(self) -> None:
        """Connect, and connect again whenever the connection is lost, for ever."""
        while True:
            try:
                async with joined_cluster(self.address, PURPOSE) as client:
                    client.subscribe_topic(self._topic, self._note)
                    self._is_up(client)
                    self._is_down(await self._lost(client))
            except (SchedulerError, OSError) as error:
                self._is_down(str(error))
            await asyncio.sleep(AGAIN_S)

    async def solve(self, job: Job, name: str, priority: int, told: Told) -> Solved:
        """Run a job in the cluster. told: receives its events. Raises SchedulerError when it cannot be run there."""
        from distributed.client import FutureCancelledError  # noqa: PLC0415 - an extra

        if self._client is None:
            raise SchedulerError(f"solver: {self.trouble}")
        self._followers[name] = told
        arguments = (job, name, self._topic, planner_identity())
        future = self._client.submit(run_remotely, *arguments, key=f"solve-{name}", priority=priority, pure=False)
        try:
            solved: Solved = await future
        except FutureCancelledError as error:
            self._is_down("the scheduler went away")
            raise SchedulerError("solver: the scheduler went away") from error
        except OtherPlannerError as error:
            raise SchedulerError(f"solver: a worker cannot take part: {error}") from error
        finally:
            self._followers.pop(name, None)
            if self.up:
                future.release()
        return solved

    async def stop(self, name: str, worker: str) -> None:
        """Ask a job to return the best plan it has."""
        if self._client is not None:
            await self._client.run(stop_job, name, workers=[worker], on_error="ignore")

    async def best(self, name: str, worker: str) -> str | None:
        """Return the best plan so far of a job, as JSON; None while there is none."""
        if self._client is None:
            return None
        found: dict[str, str | None] = await self._client.run(best_of, name, workers=[worker], on_error="ignore")
        return found.get(worker)

    async def _lost(self, client: Any) -> str:
        """Wait until jobs can no longer be sent, and return why."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            if client.status != "running" or self._client is not client:
                return "the scheduler went away"
            try:
                if not await client.nthreads():
                    return "its last worker went away"
            except (OSError, AttributeError):  # lost while it was asked
                return "the scheduler went away"

    def _note(self, event: tuple[float, dict[str, Any]]) -> None:
        told = self._followers.get(event[1]["job"])
        if told is not None:
            told(event[1])

    def _is_up(self, client: Any) -> None:
        self._client, self.trouble = client, ""
        log.info("solves go to a Dask cluster", scheduler=self.address)
        self.tell("solver_moved", to=self.address, because="")

    def _is_down(self, because: str) -> None:
        if self._client is not None or self.trouble == "it was not reached yet":
            log.warning("solves go to local workers", scheduler=self.address, because=because)
            self.tell("solver_moved", to="local workers", because=because)
        self._client, self.trouble = None, because
