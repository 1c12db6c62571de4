"""Who may send for a vehicle: each system and component is tied to the address it is heard from. Pure.

Only frames that passed every other check are judged here, so that no id can be claimed by a frame that would be
dropped. A claim moves to another address of the same link only when the old one has been silent for longer than it
takes to declare a loss: forged heartbeats of a dead vehicle come too late to hide that it is dead.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from enum import StrEnum

from skyfolio.mavlink_bridge.framing import Frame

TOLD_AGAIN_S = 60.0
"""A second sender that goes on is reported again after so long."""


class SenderKind(StrEnum):
    """What was noticed about the senders of a vehicle's frames."""

    MOVED = "link_moved"
    """It is heard from another address now; the old one had been silent."""
    CONTESTED = "two_senders"
    """A second address sends with its id at the same time; its frames are dropped."""
    SECOND_LINK = "second_link"
    """It is heard on a second link; unsigned, that need not be the same aircraft."""


@dataclass(frozen=True, kw_only=True)
class SenderNotice:
    """One thing noticed; addresses in words. `signed`: the frame that caused it carried a valid signature."""

    kind: SenderKind
    system_id: int
    component_id: int
    before: str
    now: str
    signed: bool


@dataclass(slots=True)
class _Claim:
    """Where a component is heard from on one link, and when it was last."""

    source: Hashable
    heard_s: float
    rival: Hashable = None
    told_s: float = field(default=float("-inf"))


class Senders:
    """Claims of all components on all links. Times are seconds of one steady clock.

    moves_after_s: how long the old address must have been silent before a claim moves.
    """

    def __init__(self, *, moves_after_s: float) -> None:
        self.moves_after_s = moves_after_s
        self._claims: dict[tuple[int, int], dict[str, _Claim]] = {}
        self._notices: list[SenderNotice] = []

    def accepts(self, url: str, frame: Frame, now_s: float) -> bool:
        """Return whether the frame comes from where its sender is known to be; an unknown sender is from now on."""
        links = self._claims.setdefault((frame.system_id, frame.component_id), {})
        claim = links.get(url)
        if claim is None:
            if links:
                self._notice(SenderKind.SECOND_LINK, frame, next(iter(links)), url)
            links[url] = _Claim(frame.source, now_s)
            return True
        if claim.source == frame.source:
            claim.heard_s = now_s
            return True
        if now_s - claim.heard_s <= self.moves_after_s:
            self._contest(claim, frame, now_s)
            return False
        self._notice(SenderKind.MOVED, frame, _words(claim.source), _words(frame.source))
        links[url] = _Claim(frame.source, now_s)
        return True

    def notices(self) -> list[SenderNotice]:
        """Return what was noticed since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _contest(self, claim: _Claim, frame: Frame, now_s: float) -> None:
        if claim.rival != frame.source or now_s - claim.told_s >= TOLD_AGAIN_S:
            claim.rival, claim.told_s = frame.source, now_s
            self._notice(SenderKind.CONTESTED, frame, _words(claim.source), _words(frame.source))

    def _notice(self, kind: SenderKind, frame: Frame, before: str, now: str) -> None:
        self._notices.append(
            SenderNotice(
                kind=kind,
                system_id=frame.system_id,
                component_id=frame.component_id,
                before=before,
                now=now,
                signed=frame.signed,
            )
        )


def _words(source: Hashable) -> str:
    """Return an address as HOST:PORT."""
    return ":".join(map(str, source[:2])) if isinstance(source, tuple) else str(source)
