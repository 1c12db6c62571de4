"""Tests that live in virtual time: `@in_virtual_time` runs a coroutine on a loop that jumps to the next timer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any

from skyfolio.api.lab.virtual.loop import VirtualLoop, run

Test = Callable[..., Coroutine[Any, Any, None]]


def in_virtual_time(test: Test) -> Callable[..., None]:
    """The same test, on a loop of its own in virtual time: nothing that it waits for takes time."""

    @wraps(test)
    def made(*args: Any, **kwargs: Any) -> None:
        run(test(*args, **kwargs))

    return made


def time_is_virtual() -> bool:
    """Whether the running loop jumps instead of waiting."""
    return isinstance(asyncio.get_running_loop(), VirtualLoop)
