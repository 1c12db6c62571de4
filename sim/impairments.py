"""What a radio link does to datagrams: loss and its bursts, delay, jitter, doubles, disorder, a narrow band, a cut.

Times are on the protocol clock, like the time-outs of the protocol: wall seconds where there are sockets. Every draw
comes from a seeded generator of the link and direction, so the same datagrams meet the same fate.
"""

import heapq
import math
import random
from dataclasses import dataclass
from typing import Generic, TypeVar

from skyfolio.sim.knobs import check_number

Payload = TypeVar("Payload")
QUEUE_S = 1.0
"""A datagram that would wait longer than this for a narrow band is dropped."""
_SHARES = ("loss", "duplication", "reordering")
LONGEST_DELAY_S = 3600.0
LONGEST_BURST = 1_000_000.0
SLOWEST_BPS = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Impairments:
    """One direction of one link.

    loss: share of datagrams lost (0-1); burst: mean number lost in a row (Gilbert-Elliott model; 1: independently).
    latency_s, jitter_s: each datagram takes latency_s plus a uniform draw from 0 to jitter_s; jitter alone never
    overtakes. duplication: share that comes twice. reordering: share held back by reordering_s, so that later ones
    overtake it. bandwidth_bps: bits per second, infinite by default. cut: nothing passes. ValueError names a field
    that is out of range.
    """

    loss: float = 0.0
    burst: float = 1.0
    latency_s: float = 0.0
    jitter_s: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0
    reordering_s: float = 0.05
    bandwidth_bps: float = math.inf
    cut: bool = False

    def __post_init__(self) -> None:
        for name in _SHARES:
            check_number(name, getattr(self, name), 0.0, 1.0)
        for name in ("latency_s", "jitter_s", "reordering_s"):
            check_number(name, getattr(self, name), 0.0, LONGEST_DELAY_S)
        check_number("burst", self.burst, 1.0, LONGEST_BURST)
        if self.bandwidth_bps != math.inf:
            check_number("bandwidth_bps", self.bandwidth_bps, SLOWEST_BPS, math.inf)
        if not isinstance(self.cut, bool):
            raise ValueError(f"cut must be yes or no, got {self.cut!r}")

    @property
    def are_none(self) -> bool:
        """Whether the link is perfect."""
        return self == PERFECT


PERFECT = Impairments()


class Channel(Generic[Payload]):
    """One direction: takes datagrams at one end, and delivers them at the other when they are due."""

    def __init__(self, seed: str, impairments: Impairments = PERFECT) -> None:
        self.impairments = impairments
        self.sent = self.lost = self.delivered = 0
        self._random = random.Random(seed)  # noqa: S311
        self._losing = False
        self._free_s = -math.inf
        self._last_due_s = -math.inf
        self._count = 0
        self._queue: list[tuple[float, int, Payload]] = []

    def push(self, payload: Payload, size: int, now_s: float) -> None:
        """Take a datagram of `size` bytes that is sent at `now_s`."""
        self.sent += 1
        if self.impairments.are_none and not self._queue:
            self._put(now_s, payload)
            return
        due_s = self._carried(size, now_s)
        if due_s is None:
            self.lost += 1
            return
        self._put(due_s, payload)
        if self._happens(self.impairments.duplication):
            self._put(due_s, payload)

    def pop(self, now_s: float) -> list[Payload]:
        """Return the datagrams that have arrived by now, in order of arrival."""
        arrived = []
        while self._queue and self._queue[0][0] <= now_s:
            arrived.append(heapq.heappop(self._queue)[2])
        self.delivered += len(arrived)
        return arrived

    def __bool__(self) -> bool:
        """Return whether any datagram is under way."""
        return bool(self._queue)

    def clear(self) -> None:
        """Drop the datagrams under way."""
        self._queue.clear()

    def _put(self, due_s: float, payload: Payload) -> None:
        self._count += 1
        heapq.heappush(self._queue, (due_s, self._count, payload))

    def _carried(self, size: int, now_s: float) -> float | None:
        """Return when a datagram arrives, or None if it does not."""
        rule = self.impairments
        if rule.cut or self._is_lost(rule):
            return None
        start_s = max(now_s, self._free_s)
        if rule.bandwidth_bps < math.inf:
            if start_s - now_s > QUEUE_S:
                return None
            start_s += size * 8.0 / rule.bandwidth_bps
            self._free_s = start_s
        due_s = start_s + rule.latency_s + (self._random.uniform(0.0, rule.jitter_s) if rule.jitter_s else 0.0)
        if self._happens(rule.reordering):
            return due_s + rule.reordering_s
        self._last_due_s = due_s = max(due_s, self._last_due_s)
        return due_s

    def _is_lost(self, rule: Impairments) -> bool:
        """Draw the next state of the Gilbert-Elliott chain: in its bad state everything is lost."""
        if rule.burst <= 1.0 or rule.loss in (0.0, 1.0):
            return self._happens(rule.loss)
        leave = 1.0 / rule.burst
        enter = min(1.0, leave * rule.loss / (1.0 - rule.loss))
        self._losing = not self._happens(leave) if self._losing else self._happens(enter)
        return self._losing

    def _happens(self, share: float) -> bool:
        return share > 0.0 and self._random.random() < share
