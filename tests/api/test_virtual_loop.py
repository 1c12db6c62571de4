"""The event loop of virtual time: in order, at once, and with cancelled timers forgotten."""

from __future__ import annotations

import asyncio

import pytest

from skyfolio.api.lab.virtual.loop import DeadlockError, run


def test_time_jumps_to_the_next_timer() -> None:
    async def work() -> float:
        await asyncio.sleep(1000.0)
        return asyncio.get_running_loop().time()

    at_s, _ = run(work())
    assert at_s == pytest.approx(1000.0, abs=1e-3)


def test_timers_run_in_their_order_however_many_are_cancelled() -> None:
    ran: list[int] = []

    async def work() -> None:
        loop = asyncio.get_running_loop()
        timers = [loop.call_later(1.0 + number, ran.append, number) for number in range(300)]
        for number, timer in enumerate(timers):
            if number % 10:
                timer.cancel()
        await asyncio.sleep(500.0)

    run(work())
    assert ran == list(range(0, 300, 10))


def test_a_wait_for_nothing_is_found() -> None:
    async def work() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(DeadlockError):
        run(work())
