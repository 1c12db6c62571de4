"""What a vehicle said in words (STATUSTEXT), put together and kept for a while. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

KEPT = 32
WARNING = 4
"""MAV_SEVERITY_WARNING; graver ones are lower numbers."""


@dataclass
class _Text:
    at_s: float
    severity: int
    words: str
    id: int


class Texts:
    """The last texts of one autopilot. A long one comes in chunks of 50 characters with one id (0: it is whole)."""

    def __init__(self) -> None:
        self._kept: deque[_Text] = deque(maxlen=KEPT)

    def hear(self, fields: Mapping[str, Any], now_s: float) -> None:
        """Take in one STATUSTEXT."""
        words, number = str(fields["text"]).rstrip("\0"), int(fields.get("id", 0))
        if number and int(fields.get("chunk_seq", 0)):
            for one in reversed(self._kept):
                if one.id == number:
                    one.words += words
                    return
        self._kept.append(_Text(now_s, int(fields["severity"]), words, number))

    def since(self, from_s: float) -> list[str]:
        """Different texts that warn, or worse, since then; the oldest first, trimmed."""
        said = [one.words.strip() for one in self._kept if one.at_s >= from_s and one.severity <= WARNING]
        return list(dict.fromkeys(words for words in said if words))
