"""Background tasks that are not let die unseen: each is started again, later each time, and all can see that it was."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

import structlog

log = structlog.get_logger()
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
CALM_S = 10.0
"""A task that has gone on for so long since it failed is well again."""
Work = Callable[[], Awaitable[None]]
Tell = Callable[..., Any]
"""As `EventLog.add`: a kind, and named data."""


class Supervisor:
    """Runs background work until `close`. `tell` hears of each failure; `troubles` says what is not well now."""

    def __init__(
        self,
        tell: Tell,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._tell, self._clock, self._sleep = tell, clock, sleep
        self._tasks: set[asyncio.Task[None]] = set()
        self._failed: dict[str, tuple[float, str]] = {}

    @property
    def troubles(self) -> dict[str, str]:
        """What failed and has not been well for CALM_S since: its last error by the name of the task."""
        now = self._clock()
        return {name: said for name, (well_at, said) in self._failed.items() if now < well_at}

    def start(self, name: str, work: Work) -> asyncio.Task[None]:
        """Do `work`, again when it fails; it is over when it returns, or when the task is cancelled."""
        task = asyncio.create_task(self._keep(name, work), name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def watch_loop(self, loop: asyncio.AbstractEventLoop) -> None:
        """Tell also of errors in tasks that nobody supervises or awaits, which asyncio only writes to its log."""
        loop.set_exception_handler(self._unseen)

    async def close(self) -> None:
        """End all."""
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep(self, name: str, work: Work) -> None:
        pause_s = FIRST_PAUSE_S
        while True:
            began_s = self._clock()
            try:
                await work()
            except Exception as error:
                if self._clock() - began_s >= CALM_S:
                    pause_s = FIRST_PAUSE_S
                log.exception("task failed", task=name, again_in_s=pause_s)
                self._note(name, error, pause_s)
            else:
                return
            await self._sleep(pause_s)
            pause_s = min(LONGEST_PAUSE_S, pause_s * 2.0)

    def _note(self, name: str, error: BaseException, pause_s: float) -> None:
        said = f"{type(error).__name__}: {error}"[:200]
        self._failed[name] = (self._clock() + pause_s + CALM_S, said)
        self._tell("task_failed", task=name, error=said, again_in_s=pause_s)

    def _unseen(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error, task = context.get("exception"), context.get("task") or context.get("future")
        name = task.get_name() if isinstance(task, asyncio.Task) else "event loop"
        if error is None:
            loop.default_exception_handler(context)
            return
        log.error("unseen failure", task=name, message=context.get("message"), exc_info=error)
        said = f"{type(error).__name__}: {error}"[:200]
        self._failed[name] = (self._clock() + CALM_S, said)
        self._tell("task_failed", task=name, error=said, again_in_s=None)
