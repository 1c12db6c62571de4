"""What an autopilot reports of the mission that it flies. Pure, used by `evidence`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skyfolio.mavlink_bridge.profile import UNKNOWN_TOTAL
from skyfolio.mavlink_bridge.reboot import MissionReport
from skyfolio.mavlink_bridge.speaker import Speaker


class ToldMission:
    """The latest MISSION_CURRENT (42), and what MISSION_ITEM_REACHED (46) says sooner; times are fleet seconds.

    Either may be lost, and a mission that ends by itself in a return must not be taken for a human's order.
    """

    def __init__(self, speaker: Speaker) -> None:
        self.report: MissionReport | None = None
        self.told_s = float("-inf")
        """When MISSION_CURRENT was received last."""
        self._speaker = speaker

    def hear_current(self, fields: Mapping[str, Any], now_s: float) -> None:
        """Take in a MISSION_CURRENT."""
        total = int(fields.get("total", UNKNOWN_TOTAL))
        state, identity = int(fields.get("mission_state", 0)), int(fields.get("mission_id", 0))
        self.report, self.told_s = MissionReport(int(fields["seq"]), total, state, identity), now_s

    def hear_reached(self, fields: Mapping[str, Any]) -> None:
        """Take in a MISSION_ITEM_REACHED: the item after that one is flown, until MISSION_CURRENT says otherwise."""
        if self.report is not None:
            self.report = self.report._replace(seq=max(self.report.seq, int(fields["seq"]) + 1))

    @property
    def is_finished(self) -> bool:
        """Return whether it has come to its last item."""
        return self.report is not None and self.report.is_finished(self._items)

    def may_have_finished(self, since_s: float) -> bool:
        """Return whether it was about to come to its last item, and no MISSION_CURRENT has come since then."""
        return self.report is not None and self.told_s < since_s and self.report.is_about_to_finish(self._items)

    @property
    def _items(self) -> int | None:
        return None if self.report is None else self._speaker.items_on_board(self.report.total)
