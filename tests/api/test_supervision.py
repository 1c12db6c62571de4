"""Background tasks that fail are started again, and it is seen, in virtual time."""

import asyncio
from typing import Any

import pytest

from skyfolio.api.common.supervision import CALM_S, LONGEST_PAUSE_S, Supervisor
from tests.virtual_time import in_virtual_time


class Room:
    """A supervisor with a clock that its own sleeping moves, and what it told."""

    def __init__(self) -> None:
        self.now, self.pauses, self.told = 0.0, list[float](), list[dict[str, Any]]()
        self.supervisor = Supervisor(self._tell, clock=lambda: self.now, sleep=self._sleep)

    def _tell(self, kind: str, **data: Any) -> None:
        self.told.append({"kind": kind, **data})

    async def _sleep(self, seconds: float) -> None:
        self.pauses.append(seconds)
        self.now += seconds
        await asyncio.sleep(0)


async def test_a_task_that_fails_is_started_again_and_told() -> None:
    room, begun = Room(), 0

    async def work() -> None:
        nonlocal begun
        begun += 1
        if begun < 3:
            raise KeyError("user-1")

    await room.supervisor.start("telemetry", work)
    assert begun == 3
    assert [event["kind"] for event in room.told] == ["task_failed"] * 2
    assert room.told[0] == {
        "kind": "task_failed",
        "task": "telemetry",
        "error": "KeyError: 'user-1'",
        "again_in_s": 0.5,
    }


async def test_pauses_double_up_to_a_limit_and_begin_anew_after_a_calm_time() -> None:
    room, runs = Room(), 0

    async def work() -> None:
        nonlocal runs
        runs += 1
        if runs == 9:
            room.now += CALM_S
        if runs <= 10:
            raise OSError("gone")

    await room.supervisor.start("tidy", work)
    assert room.pauses[:4] == [0.5, 1.0, 2.0, 4.0]
    assert max(room.pauses) == LONGEST_PAUSE_S
    assert room.pauses[8] == 0.5


async def test_it_is_in_trouble_until_it_has_gone_on_for_a_while() -> None:
    room, failed = Room(), asyncio.Event()

    async def work() -> None:
        if not failed.is_set():
            failed.set()
            raise ValueError("no")
        await asyncio.Event().wait()

    room.supervisor.start("loop-watch", work)
    await failed.wait()
    await asyncio.sleep(0)
    assert room.supervisor.troubles == {"loop-watch": "ValueError: no"}
    room.now += 0.5 + CALM_S
    assert room.supervisor.troubles == {}
    await room.supervisor.close()


async def test_an_error_in_a_task_that_nobody_awaits_is_told_too() -> None:
    room, loop = Room(), asyncio.get_running_loop()
    room.supervisor.watch_loop(loop)

    async def work() -> None:
        raise RuntimeError("unseen")

    task = asyncio.create_task(work(), name="forgotten")
    await asyncio.wait([task])
    loop.call_exception_handler({"message": "never retrieved", "exception": task.exception(), "task": task})
    assert room.told == [
        {"kind": "task_failed", "task": "forgotten", "error": "RuntimeError: unseen", "again_in_s": None}
    ]
    assert "forgotten" in room.supervisor.troubles


async def test_a_cancelled_task_is_over() -> None:
    room = Room()
    task = room.supervisor.start("telemetry", asyncio.Event().wait)  # type: ignore[arg-type]
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert room.told == []


def test_an_error_found_after_the_service_has_ended_is_told_to_nobody() -> None:
    room, loop = Room(), asyncio.new_event_loop()
    room.supervisor.watch_loop(loop)
    loop.close()
    loop.call_exception_handler({"message": "never retrieved", "exception": RuntimeError("unseen")})
    assert room.told == []


@in_virtual_time
async def test_a_task_whose_library_swallows_a_cancellation_ends_all_the_same() -> None:
    room, swallowed = Room(), 0

    async def work() -> None:
        nonlocal swallowed
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            swallowed += 1
        await asyncio.Event().wait()

    task = room.supervisor.start("dask", work)
    await asyncio.sleep(0)
    await asyncio.wait_for(room.supervisor.close(), 60)
    assert swallowed == 1
    assert task.cancelled()
