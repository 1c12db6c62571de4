"""Upload items and know what is on board: upload, read back, compare, try again, or restore the old ones.

An accepting MISSION_ACK is not proof (it may have been meant for another station, or come too early); a read-back that
compares equal is. ArduPilot writes into the mission it flies, so an upload that cannot be finished leaves parts of
both: then the mission that was there before is restored and proven the same way. Without I/O, like the protocol.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from math import inf
from typing import Any

from skyfolio.mavlink_bridge.autopilots import Autopilot
from skyfolio.mavlink_bridge.compare import mission_differences
from skyfolio.mavlink_bridge.items import MissionItem
from skyfolio.mavlink_bridge.mission_messages import SILENCE_S, Ended, Message, MissionType
from skyfolio.mavlink_bridge.mission_protocol import Download, Upload
from skyfolio.mavlink_bridge.profiles import profile_of
from skyfolio.mavlink_bridge.round_trip import RoundTrip

ATTEMPTS = 3
_PAUSE_S = 0.2
"""Seconds before the second attempt; doubled with each further one."""


class OnBoard(StrEnum):
    """What the vehicle is known to have on board."""

    NEW = "new"
    """The whole new mission, read back and equal."""
    OLD = "old"
    """The whole mission it had before, read back and equal."""
    UNKNOWN = "unknown"
    """Not proven: do not fly it."""


class VerifiedUpload:
    """One upload with its proof and its retries, with the same interface as the transfers it is made of.

    `old`: what is on board now, as far as known; None: unknown, then a failure is not repaired. `autopilot`: whose
    rules the read-back follows. `error` says what went wrong with the new items, None if they are on board.
    """

    def __init__(
        self,
        items: Sequence[MissionItem],
        system_id: int,
        *,
        autopilot: Autopilot,
        old: Sequence[MissionItem] | None = None,
        mission_type: MissionType = MissionType.MISSION,
        attempts: int = ATTEMPTS,
        silence_s: float = SILENCE_S,
        round_trip: RoundTrip | None = None,
    ) -> None:
        self.on_board: OnBoard | None = None
        self.error: str | None = "not tried"
        self.attempts = 0
        self.opaque_id = 0
        self._new, self._old = items, old
        self._system_id, self._type = system_id, mission_type
        self._profile = profile_of(autopilot)
        self._limit = attempts
        self._silence_s = silence_s
        self._tries = 0
        self._restoring = self._old_is_gone = False
        self._failure: str | None = None
        self._round_trip = round_trip or RoundTrip()
        self._transfer: Upload | Download | None = None
        self._resume_s = 0.0

    @property
    def ended(self) -> bool:
        """Return whether `on_board` has the result."""
        return self.on_board is not None

    @property
    def due_s(self) -> float:
        """Return when `tick` has something to do."""
        if self.ended:
            return inf
        return self._resume_s if self._transfer is None else self._transfer.due_s

    def start(self, now_s: float) -> list[Message]:
        """Begin the first attempt."""
        return self._upload(now_s)

    def handle(self, name: str, fields: dict[str, Any], now_s: float) -> list[Message]:
        """Take in one message of the vehicle."""
        if self._transfer is None:
            return []
        return self._go_on(self._transfer.handle(name, fields, now_s), now_s)

    def tick(self, now_s: float) -> list[Message]:
        """Let time pass."""
        if self.ended:
            return []
        if self._transfer is None:
            return self._try_again(now_s) if now_s >= self._resume_s else []
        return self._go_on(self._transfer.tick(now_s), now_s)

    def give_up(self) -> None:
        """Stop: the link is lost. What is on board is unknown unless it was proven."""
        if self.on_board is None:
            self.on_board = OnBoard.UNKNOWN
            self.error = self._failure or "given up: the link was declared lost"

    def _try_again(self, now_s: float) -> list[Message]:
        """Upload again, or only read an old mission that was kept whole: uploaded again it would start anew."""
        if self._restoring and self._profile.replaces_whole and not self._old_is_gone:
            self._tries += 1
            return self._read_back(now_s)
        return self._upload(now_s)

    def _upload(self, now_s: float) -> list[Message]:
        self._tries += 1
        self._failure = None
        if not self._restoring:
            self.attempts = self._tries
        self._transfer = Upload(self._wanted, self._system_id, **self._how)
        return self._transfer.start(now_s)

    @property
    def _how(self) -> dict[str, Any]:
        return {"mission_type": self._type, "round_trip": self._round_trip, "silence_s": self._silence_s}

    @property
    def _wanted(self) -> Sequence[MissionItem]:
        return (self._old or ()) if self._restoring else self._new

    def _go_on(self, messages: list[Message], now_s: float) -> list[Message]:
        """Continue after each step with what follows from the end of the current transfer, if it has ended."""
        transfer = self._transfer
        if transfer is None or transfer.ended is None:
            return messages
        if isinstance(transfer, Download):
            return messages + self._proved(transfer, transfer.ended, now_s)
        return messages + self._uploaded(transfer, transfer.ended, now_s)

    def _uploaded(self, upload: Upload, ended: Ended, now_s: float) -> list[Message]:
        if ended.error is None:
            self.opaque_id = ended.opaque_id
            return self._read_back(now_s)
        if ended.perhaps_done:
            return self._read_back(now_s)
        self._failure = ended.error
        ends = upload.cancel_others() if ended.busy else [upload.cancel()]
        return [*ends, *self._failed(now_s, again=ended.passing)]

    def _read_back(self, now_s: float) -> list[Message]:
        self._transfer = Download(self._system_id, window=self._profile.read_window, **self._how)
        return self._transfer.start(now_s)

    def _proved(self, download: Download, ended: Ended, now_s: float) -> list[Message]:
        if ended.error is not None:
            self._failure = ended.error
            return self._failed(now_s, again=True)
        differences = mission_differences(
            self._wanted, download.items, autopilot=self._profile.autopilot, mission_type=self._type
        )
        if differences:
            self._old_is_gone = self._restoring
            self._failure = f"read-back differs: {'; '.join(differences[:3])}"
            return self._failed(now_s, again=True)
        self.opaque_id = ended.opaque_id or self.opaque_id
        self.on_board = OnBoard.OLD if self._restoring else OnBoard.NEW
        if not self._restoring:
            self.error = None
        return []

    def _failed(self, now_s: float, *, again: bool) -> list[Message]:
        """Try again after a pause; then restore the old mission; then report that nothing is known."""
        if not self._restoring:
            self.error = self._failure
        if again and self._tries < self._limit:
            self._pause(now_s)
        elif self._restoring or self._old is None:
            self.on_board = OnBoard.UNKNOWN
        else:
            self._restoring, self._tries = True, 0
            if not again:  # refused at once: most likely the old mission was never touched
                return self._read_back(now_s)
            self._pause(now_s)
        return []

    def _pause(self, now_s: float) -> None:
        self._transfer = None
        self._resume_s = now_s + _PAUSE_S * 2 ** max(self._tries - 1, 0)
