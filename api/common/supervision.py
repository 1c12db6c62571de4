"""Supervised background tasks: a task that fails is reported, and started again after growing pauses."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import structlog

from skyfolio.api.common.surroundings import monotonic_s

log = structlog.get_logger()
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
AGAIN_S = 1.0
"""A task that is still there so long after it was cancelled is cancelled again."""
CALM_S = 10.0
"""A task that has run for so long since it failed is well again."""
Work = Callable[[], Awaitable[None]]
Tell = Callable[..., Any]
"""The signature of `EventLog.add`: a kind, and named data."""


class Supervisor:
    """Runs background work until `close`. `tell` receives each failure; `troubles` lists what is not well now."""

    def __init__(
        self,
        tell: Tell,
        *,
        clock: Callable[[], float] = monotonic_s,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._tell, self._clock, self._sleep = tell, clock, sleep
        self._tasks: set[asyncio.Task[None]] = set()
        self._failed: dict[str, tuple[float, str]] = {}

    @property
    def troubles(self) -> dict[str, str]:
        """Return the last error, by task name, of each task that failed and has not been well for CALM_S since."""
        now = self._clock()
        return {name: message for name, (well_at, message) in self._failed.items() if now < well_at}

    def start(self, name: str, work: Work) -> asyncio.Task[None]:
        """Run `work`, again whenever it fails; it is over when it returns, or when the task is cancelled."""
        task = asyncio.create_task(self._keep(name, work), name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def watch_loop(self, loop: asyncio.AbstractEventLoop) -> None:
        """Report also errors in tasks that are neither supervised nor awaited, which asyncio only logs."""
        loop.set_exception_handler(self._unseen)

    async def close(self) -> None:
        """Cancel all tasks, until they are over: a library may have swallowed a cancellation."""
        tasks = list(self._tasks)
        while left := [task for task in tasks if not task.done()]:
            for task in left:
                task.cancel()
            await asyncio.wait(left, timeout=AGAIN_S)
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
        message = f"{type(error).__name__}: {error}"[:200]
        self._failed[name] = (self._clock() + pause_s + CALM_S, message)
        self._tell("task_failed", task=name, error=message, again_in_s=pause_s)

    def _unseen(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error, task = context.get("exception"), context.get("task") or context.get("future")
        name = task.get_name() if isinstance(task, asyncio.Task) else "event loop"
        if error is None or loop.is_closed():  # the service has ended: there is nobody to tell
            loop.default_exception_handler(context)
            return
        log.error("unseen failure", task=name, message=context.get("message"), exc_info=error)
        message = f"{type(error).__name__}: {error}"[:200]
        self._failed[name] = (self._clock() + CALM_S, message)
        self._tell("task_failed", task=name, error=message, again_in_s=None)
