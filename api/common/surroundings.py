"""What a service takes from the process that it runs in: time and chance.

A service reads the wall's clocks and the system's randomness, unless it is started within `surrounded`: then the
service, and every task that it begins, takes both from there. So a whole service can live in virtual time, and do the
same again from the same seed.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """monotonic_s, utc_s: return seconds. token: returns so many random bytes as hexadecimal digits."""

    monotonic_s: Callable[[], float] = time.monotonic
    utc_s: Callable[[], float] = time.time
    token: Callable[[int], str] = secrets.token_hex


_PROCESS = Surroundings()
_here: ContextVar[Surroundings] = ContextVar("surroundings", default=_PROCESS)


@contextmanager
def surrounded(surroundings: Surroundings) -> Iterator[None]:
    """Let what runs in this context, and the tasks that it begins, take time and chance from here."""
    before = _here.set(surroundings)
    try:
        yield
    finally:
        _here.reset(before)


def monotonic_s() -> float:
    """Return seconds that never run backwards."""
    return _here.get().monotonic_s()


def utc_s() -> float:
    """Return the UTC second."""
    return _here.get().utc_s()


def utc_now() -> datetime:
    """Return the UTC time."""
    return datetime.fromtimestamp(utc_s(), UTC)


def new_token(size: int) -> str:
    """Return `size` random bytes as hexadecimal digits."""
    return _here.get().token(size)
