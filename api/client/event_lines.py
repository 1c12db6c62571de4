"""Lines of the stream of events (SSE), read as events."""

from __future__ import annotations

from collections.abc import Iterator

from skyfolio.api.store.event_log import PROVISIONAL, Event


class EventLines:
    """Takes one line after the other; what is provisional comes again with its number, and is left out."""

    def __init__(self) -> None:
        self._kind = ""

    def take(self, line: str) -> Iterator[Event]:
        """Yield the event that a line completes, if it does."""
        if line.startswith("event: "):
            self._kind = line.removeprefix("event: ")
        elif line.startswith("data: ") and self._kind != PROVISIONAL:
            yield Event.model_validate_json(line.removeprefix("data: "))
