"""Which of several links to a vehicle is used, and which frames are copies. Pure: each call carries the time."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from skyfolio.mavlink_bridge.framing import Frame

FRESH_S = 2.5
"""A link on which a vehicle was not heard for this long is not used for it: two heartbeats and a half."""
STEADY_S = 5.0
"""A better link is used again after it has worked for this long."""
_REMEMBERED = 256
_TWICE_WITHIN_S = 1.0


@dataclass(slots=True)
class _Way:
    heard_s: float
    steady_since_s: float


class Routes:
    """For each vehicle the link to send on: the first of `order` that works, without jumping back and forth."""

    def __init__(self) -> None:
        self._order: list[str] = []
        self._ways: dict[int, dict[str, _Way]] = {}
        self._used: dict[int, str] = {}
        self._seen: dict[int, OrderedDict[tuple[int, int, bytes], tuple[str, float]]] = {}

    def add(self, url: str) -> None:
        """Add a link; earlier ones are preferred."""
        self._order.append(url)

    def heard(self, url: str, frame: Frame, now_s: float) -> bool:
        """Take in a frame of a link, and return whether it is new, not the copy of one received on another link."""
        ways = self._ways.setdefault(frame.system_id, {})
        way = ways.get(url)
        if way is None or now_s - way.heard_s > FRESH_S:
            ways[url] = _Way(now_s, now_s)
        else:
            way.heard_s = now_s
        return len(ways) == 1 or self._is_new(url, frame, now_s)

    def links_of(self, system_id: int, now_s: float) -> list[str]:
        """Return where to send to a vehicle: one link, or all of them for an unheard vehicle and for everybody (0)."""
        ways = self._ways.get(system_id)
        if not ways:
            return list(self._order)
        used = self._used.get(system_id)
        working = [url for url in self._order if url in ways and now_s - ways[url].heard_s <= FRESH_S]
        if not working:
            return [used] if used is not None else list(ways)
        best = working[0]
        if used in working and used != best and now_s - ways[best].steady_since_s < STEADY_S:
            best = used
        self._used[system_id] = best
        return [best]

    @property
    def heard_systems(self) -> list[int]:
        """Return every system id that was heard on any link."""
        return list(self._ways)

    @property
    def unheard_links(self) -> list[str]:
        """Return the links on which no vehicle was ever heard."""
        return [url for url in self._order if not any(url in ways for ways in self._ways.values())]

    def silent_for_s(self, system_id: int, url: str, now_s: float) -> float | None:
        """Return the seconds since a vehicle was heard on a link, None if it never was."""
        way = self._ways.get(system_id, {}).get(url)
        return None if way is None else now_s - way.heard_s

    def _is_new(self, url: str, frame: Frame, now_s: float) -> bool:
        seen = self._seen.setdefault(frame.system_id, OrderedDict())
        key = (frame.component_id, frame.seq, frame.data[-8:])
        earlier = seen.get(key)
        if earlier is not None and earlier[0] != url and now_s - earlier[1] < _TWICE_WITHIN_S:
            return False
        seen[key] = (url, now_s)
        seen.move_to_end(key)
        while len(seen) > _REMEMBERED:
            seen.popitem(last=False)
        return True
