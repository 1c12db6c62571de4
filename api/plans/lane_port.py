"""What the service needs of a lane of solves, and of the link to a cluster where jobs may be solved.

`solver.Lane` is the lane with worker processes, `dask_link.DaskLink` the link to a Dask scheduler.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from skyfolio.api.plans.job_board import Progress
from skyfolio.api.plans.jobs import Job, Solved


class SolveLane(Protocol):
    """Runs jobs beside the event loop, at most so many at a time; a reserved job has a token."""

    @property
    def answers(self) -> bool:
        """Return whether it shows that it can solve; a lane that was never needed does."""

    @property
    def warm(self) -> bool:
        """Return whether a job can begin at once."""

    @property
    def busy(self) -> int:
        """Return how many jobs wait or run."""

    def reserve(self) -> int:
        """Return a token for one job. Raises BusyError when the queue is full."""
        ...

    def stop(self, token: int) -> None:
        """Ask the job with this token to return the best plan it has."""
        ...

    def running(self, token: int) -> bool:
        """Return whether the job has begun."""
        ...

    def progress(self, token: int) -> Progress | None:
        """Return what the job has reached, None before its first iteration."""
        ...

    async def best(self, token: int, plan_id: str) -> str | None:
        """Return the best feasible plan of the job so far, as JSON; None while there is none or for another plan."""
        ...

    async def solve(self, job: Job, token: int | None = None) -> Solved:
        """Run the job. Raises SolveError."""
        ...

    async def tend(self) -> None:
        """Replace what does not answer."""
        ...

    def begin(self) -> None:
        """Start to become warm, without waiting for it."""
        ...

    async def warm_up(self) -> None:
        """Wait until it is warm."""
        ...

    def close(self) -> None:
        """End it, and what runs."""
        ...


class ClusterLink(Protocol):
    """The connection to a cluster. `tell` receives each change of it, and `trouble` says why it is not up."""

    tell: Callable[..., Any]
    trouble: str

    @property
    def up(self) -> bool:
        """Return whether jobs can be sent."""

    async def keep(self) -> None:
        """Connect, and connect again whenever the connection is lost, for ever."""
