"""The result of a request to one vehicle: failure is a value that says why."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.mavlink_bridge.items import Mission, MissionItem
from skyfolio.mavlink_bridge.verified import OnBoard


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The result of one request. `seconds` is wall time; `error` is None if it was done."""

    system_id: int
    seconds: float
    error: str | None = None

    @property
    def ok(self) -> bool:
        """Return whether it was done, and seen to be done."""
        return self.error is None


@dataclass(frozen=True, kw_only=True)
class UploadResult(Outcome):
    """The result of an upload. `verified`: it was read back and compared equal. `mission_id`: its checksum, or 0.

    `on_board`: the whole new mission, the whole old one (read back too), or unknown.
    """

    verified: bool = False
    on_board: OnBoard = OnBoard.UNKNOWN
    attempts: int = 0
    mission_id: int = 0


@dataclass(frozen=True, kw_only=True)
class ReadResult(Outcome):
    """The result of a read. `items`: what is on board of one mission type; empty after an error."""

    items: tuple[MissionItem, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Recognised(Outcome):
    """The result of a recognition. `mission`: which of the possible ones is on board, read back and equal, or None."""

    mission: Mission | None = None


@dataclass(frozen=True, kw_only=True)
class CommandResult(Outcome):
    """The result of launch, go to, start, hold or land."""


@dataclass(frozen=True, kw_only=True)
class SwapResult(Outcome):
    """The result of a swap. `ok`: verified and flown. Else it flies the mission from before, or holds.

    `went_on`: it flies the mission from before, proven to be on board whole. `held`: it was seen to hold.
    """

    upload: UploadResult
    held: bool = False
    went_on: bool = False
