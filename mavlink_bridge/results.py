"""What came of asking one vehicle for something: failure is a value that says why."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.mavlink_bridge.items import Mission, MissionItem
from skyfolio.mavlink_bridge.verified import OnBoard


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """`seconds` is wall time; `error` is None when all went well."""

    system_id: int
    seconds: float
    error: str | None = None

    @property
    def ok(self) -> bool:
        """Whether it was done, and seen to be done."""
        return self.error is None


@dataclass(frozen=True, kw_only=True)
class UploadResult(Outcome):
    """`verified`: the mission was read back and compared equal. `mission_id`: its checksum, 0 if not told.

    `on_board`: the whole new mission, the whole old one (read back too), or unknown.
    """

    verified: bool = False
    on_board: OnBoard = OnBoard.UNKNOWN
    attempts: int = 0
    mission_id: int = 0


@dataclass(frozen=True, kw_only=True)
class ReadResult(Outcome):
    """`items`: what is on board of one mission type, as read; empty after an error."""

    items: tuple[MissionItem, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Recognised(Outcome):
    """`mission`: which of the missions it may have is on board, read back and equal; None: none of them."""

    mission: Mission | None = None


@dataclass(frozen=True, kw_only=True)
class CommandResult(Outcome):
    """Launch, go to, start, hold, land."""


@dataclass(frozen=True, kw_only=True)
class SwapResult(Outcome):
    """Either `ok`: verified and flying the new mission. Or not: then it flies the one from before, or holds.

    `went_on`: the mission from before goes on, proven to be on board whole. `held`: it was seen to hold.
    """

    upload: UploadResult
    held: bool = False
    went_on: bool = False
