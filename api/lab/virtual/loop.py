"""An event loop in virtual time: it jumps to the next timer instead of waiting for it, and never runs beside itself.

Tasks and futures are numbered in the order in which they are made, and hash by that number: what keeps them in sets
goes through them in the same order each time.
"""

from __future__ import annotations

import asyncio
from asyncio.base_events import BaseEventLoop
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from contextvars import Context, ContextVar, copy_context
from heapq import heapify, heappop, heappush
from typing import Any, TypeVar

Result = TypeVar("Result")

TURN_S = 1e-6
"""Virtual seconds that each turn takes: time passes for a loop that looks again and again, as it does on a wall."""


CLOCK_RESOLUTION_S = 1e-9
MANY_TIMERS, MOST_CANCELLED = 100, 0.5
"""With so many timers they are all gone through when more than this share of them was cancelled."""


class DeadlockError(RuntimeError):
    """Everybody waits for something that never comes."""


class Life:
    """What was begun in one context: the tasks that are still alive, by number."""

    def __init__(self) -> None:
        self.tasks: dict[int, NumberedTask] = {}
        self.over = False


life_here: ContextVar[Life | None] = ContextVar("life", default=None)
"""The life to which new tasks belong; they hand it on."""


class NumberedTask(asyncio.Task[Any]):
    """A task that hashes by the order of creation, and is known to the life it belongs to."""

    def __init__(
        self, coroutine: Coroutine[Any, Any, Any], *, loop: VirtualLoop, name: str | None, context: Context | None
    ) -> None:
        self.number = loop.next_number()  # before the task is made: that already puts it into a set
        self._life = life_here.get() if context is None else context.get(life_here)
        super().__init__(coroutine, loop=loop, name=name or f"task-{self.number}", context=context)
        if self._life is not None:
            self._life.tasks[self.number] = self
            self.add_done_callback(self._leave)

    def __hash__(self) -> int:
        return self.number

    def _leave(self, _done: object) -> None:
        if self._life is not None:
            self._life.tasks.pop(self.number, None)


class NumberedFuture(asyncio.Future[Any]):
    """A future that hashes by a number, which it takes when it is first asked for it: few are ever put into a set."""

    number: int | None = None

    def __hash__(self) -> int:
        if self.number is None:
            loop = self.get_loop()
            assert isinstance(loop, VirtualLoop)  # noqa: S101
            self.number = loop.next_number()
        return self.number


class Turn(asyncio.Handle):
    """What is to be done in the next turn: an `asyncio.Handle` without the looks for debugging."""

    __slots__ = ()

    def __init__(
        self, callback: Callable[..., Any], args: Sequence[Any], loop: VirtualLoop, context: Context | None
    ) -> None:
        self._callback, self._args, self._loop = callback, args, loop
        self._context = copy_context() if context is None else context
        self._cancelled, self._repr, self._source_traceback = False, None, None


class Timer(asyncio.TimerHandle):
    """What is to be done at some second: an `asyncio.TimerHandle` without the looks for debugging."""

    __slots__ = ()
    _when: float
    _loop: VirtualLoop
    _scheduled: bool

    def __init__(
        self, when: float, callback: Callable[..., Any], args: Sequence[Any], loop: VirtualLoop, context: Context | None
    ) -> None:
        self._callback, self._args, self._loop = callback, args, loop
        self._context = copy_context() if context is None else context
        self._cancelled, self._repr, self._source_traceback = False, None, None
        self._when, self._scheduled = when, True

    def __lt__(self, other: Timer) -> bool:  # type: ignore[override]
        return self._when < other._when

    def cancel(self) -> None:
        """Forget it; if it still waits, the loop drops it later."""
        if not self._cancelled:
            self._cancelled = True
            self._callback, self._args = _nothing, ()
            if self._scheduled:
                self._loop._timer_cancelled_count += 1


class VirtualLoop(BaseEventLoop):
    """For what waits for timers and other tasks, and for nothing outside; `time` counts seconds from 0.

    Work for another thread is done at once. DeadlockError when nothing is left to wait for.
    """

    _ready: deque[Any]
    _scheduled: list[Any]
    _stopping: bool
    _timer_cancelled_count: int

    def __init__(self) -> None:
        super().__init__()
        self._now_s = 0.0
        self._number = 0
        self.set_task_factory(_numbered)

    def next_number(self) -> int:
        """Return the number of the next task or future."""
        self._number += 1
        return self._number

    def time(self) -> float:
        """Return virtual seconds."""
        return self._now_s

    def create_future(self) -> asyncio.Future[Any]:
        """Return a new future."""
        return NumberedFuture(loop=self)

    def call_soon(  # type: ignore[override]
        self, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> Turn:
        """Do something in the next turn."""
        turn = Turn(callback, args, self, context)
        self._ready.append(turn)
        return turn

    def call_later(  # type: ignore[override]
        self, delay: float, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> Timer:
        """Do something after so many virtual seconds."""
        timer = Timer(self._now_s + delay, callback, args, self, context)
        heappush(self._scheduled, timer)
        return timer

    def call_at(  # type: ignore[override]
        self, when: float, callback: Callable[..., Any], *args: Any, context: Context | None = None
    ) -> Timer:
        """Do something at a virtual second."""
        timer = Timer(when, callback, args, self, context)
        heappush(self._scheduled, timer)
        return timer

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Result], *args: Any
    ) -> asyncio.Future[Result]:
        """Do it now; the result is there in the next turn."""
        del executor
        done: asyncio.Future[Result] = self.create_future()
        try:
            result = func(*args)
        except Exception as error:  # noqa: BLE001 - handed on, as an executor does
            self.call_soon(_fail, done, error)
        else:
            self.call_soon(_end, done, result)
        return done

    def _run_once(self) -> None:
        """Let time pass until something is due, and run what is due: what `BaseEventLoop` does, with no selector."""
        self._forget_cancelled()
        scheduled, ready = self._scheduled, self._ready
        wait_s = 0.0
        if not ready and not self._stopping:
            if not scheduled:
                raise DeadlockError("everybody waits for something that never comes")
            wait_s = max(scheduled[0]._when - self._now_s, 0.0)
        self._now_s += wait_s + TURN_S
        end_s = self._now_s + CLOCK_RESOLUTION_S
        while scheduled and scheduled[0]._when < end_s:
            handle = heappop(scheduled)
            handle._scheduled = False
            ready.append(handle)
        for _ in range(len(ready)):
            handle = ready.popleft()
            if not handle._cancelled:
                try:
                    handle._context.run(handle._callback, *handle._args)
                except (SystemExit, KeyboardInterrupt):
                    raise
                except BaseException as error:  # noqa: BLE001 - reported, as every loop does
                    self.call_exception_handler(
                        {"message": f"Exception in {handle!r}", "exception": error, "handle": handle}
                    )

    def _forget_cancelled(self) -> None:
        """Drop the timers that were cancelled: all of them when they are many, else those that are next."""
        scheduled = self._scheduled
        if len(scheduled) > MANY_TIMERS and self._timer_cancelled_count > MOST_CANCELLED * len(scheduled):
            alive = []
            for handle in scheduled:
                if handle._cancelled:
                    handle._scheduled = False
                else:
                    alive.append(handle)
            heapify(alive)
            self._scheduled, self._timer_cancelled_count = alive, 0
            return
        while scheduled and scheduled[0]._cancelled:
            self._timer_cancelled_count -= 1
            heappop(scheduled)._scheduled = False

    def _write_to_self(self) -> None:
        """Do nothing: no other thread wakes this loop."""


def _nothing() -> None:
    """Do nothing: what a cancelled timer would do."""


def _numbered(
    loop: asyncio.AbstractEventLoop, coroutine: Any, *, name: str | None = None, context: Context | None = None
) -> NumberedTask:
    assert isinstance(loop, VirtualLoop)  # noqa: S101
    return NumberedTask(coroutine, loop=loop, name=name, context=context)


def _end(done: asyncio.Future[Result], result: Result) -> None:
    if not done.done():
        done.set_result(result)


def _fail(done: asyncio.Future[Any], error: Exception) -> None:
    if not done.done():
        done.set_exception(error)


def run(work: Coroutine[Any, Any, Result]) -> tuple[Result, float]:
    """Do some work in virtual time; return its result, and the virtual seconds that it took."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        result = runner.run(work)
        return result, runner.get_loop().time()
