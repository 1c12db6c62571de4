"""What an autopilot reports in words (STATUSTEXT), and which of it explains a failsafe. Pure."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_KEPT = 32
_WARNING = 4
"""MAV_SEVERITY_WARNING: ArduPilot announces its failsafes with it; what is graver has a lower number."""
_NAMED = re.compile(r"failsafe|breach", re.IGNORECASE)
"""Words of a failsafe itself, at any severity."""
_REASON = re.compile(
    r"batter|fence|\blost\b|\bloss\b|fail|ekf|gps|glitch|crash|motor|thrust|vibration|emergency|terminat", re.IGNORECASE
)
"""Words of what causes one, if they are sent as a warning or graver."""
_OTHERWISE = re.compile(r"clear|regain|recover|^(?:pre)?arm:|\bok\b", re.IGNORECASE)
"""Words of something that is over, or that only prevents arming."""


@dataclass(slots=True)
class _Text:
    words: str
    severity: int
    at_s: float
    id: int
    chunk: int

    @property
    def names_failsafe(self) -> bool:
        return bool(_NAMED.search(self.words)) and not _OTHERWISE.search(self.words)

    @property
    def explains(self) -> bool:
        """Return whether it names a failsafe or a reason for one."""
        warns = self.severity <= _WARNING and bool(_REASON.search(self.words)) and not _OTHERWISE.search(self.words)
        return self.names_failsafe or warns


class StatusTexts:
    """The latest texts of one autopilot, joined from their chunks of 50 characters; seconds of one clock."""

    def __init__(self) -> None:
        self._texts: deque[_Text] = deque(maxlen=_KEPT)

    def hear(self, fields: Mapping[str, Any], now_s: float) -> None:
        """Take in a STATUSTEXT. PX4 ends its texts with a tab."""
        words = str(fields["text"]).rstrip("\0")
        identity, chunk = int(fields.get("id", 0)), int(fields.get("chunk_seq", 0))
        begun = (text for text in reversed(self._texts) if (text.id, text.chunk + 1) == (identity, chunk))
        last = next(begun, None) if identity and chunk else None
        if last is not None:
            last.words, last.chunk = last.words + words, chunk
        else:
            self._texts.append(_Text(words, int(fields["severity"]), now_s, identity, chunk))

    def about(self, at_s: float, before_s: float, after_s: float) -> list[str]:
        """Return the texts that explain a failsafe of that time: the latest reason and the latest that names it.

        at_s: when it began; before_s, after_s: how long before and after that a text counts. In order of time.
        """
        near = [text for text in self._texts if at_s - before_s <= text.at_s <= at_s + after_s and text.explains]
        latest = {text.names_failsafe: text for text in near}
        return [text.words.strip() for text in near if text is latest[text.names_failsafe]]

    def latest_failsafe(self, now_s: float, within_s: float) -> str | None:
        """Return the latest text of the last `within_s` that names a failsafe."""
        named = [text for text in self._texts if text.names_failsafe and now_s - text.at_s <= within_s]
        return named[-1].words.strip() if named else None

    def since(self, from_s: float) -> list[str]:
        """Return the different texts since then that warn, or worse; the oldest first."""
        texts = [text.words.strip() for text in self._texts if text.at_s >= from_s and text.severity <= _WARNING]
        return list(dict.fromkeys(words for words in texts if words))
