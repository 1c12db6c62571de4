"""An autopilot that restarts in the air, and the proof that it flies its mission on. Pure, used by `evidence`."""

from __future__ import annotations

from typing import NamedTuple

from skyfolio.mavlink_bridge.autopilots import FlightMode

_COMPLETE = 5
"""MISSION_STATE_COMPLETE of MISSION_CURRENT."""


class MissionReport(NamedTuple):
    """A MISSION_CURRENT (42): the current item, the number of items, MISSION_STATE, and the mission's checksum."""

    seq: int
    total: int
    state: int
    identity: int

    def is_finished(self, items: int | None) -> bool:
        """Return whether the vehicle has come to its last item, of `items` on board (None: not known)."""
        return self.state == _COMPLETE or (items is not None and self.seq >= items - 1)

    def is_about_to_finish(self, items: int | None) -> bool:
        """Return whether the next item is the last one; so is every item where their number is not known."""
        return items is None or self.seq >= items - 2

    @property
    def mission(self) -> tuple[int, int]:
        """Return what stays the same as long as the mission does: its number of items and its checksum."""
        return self.total, self.identity


class Reboot:
    """The latest restart of an autopilot; times are fleet seconds."""

    def __init__(self) -> None:
        self.count = 0
        self.at_s = float("-inf")
        self._was_flying = False
        self._mission: tuple[int, int] | None = None

    def note(self, count: int, now_s: float, *, was_flying: bool, mission: MissionReport | None) -> None:
        """Take in that it has restarted for the `count`-th time; what it flew before has to be proven anew."""
        self.count, self.at_s, self._was_flying = count, now_s, was_flying
        self._mission = None if mission is None else mission.mission

    def forget(self) -> None:
        """Begin a new flight: a restart in the one before does not count any more."""
        self.at_s = float("-inf")

    def flies_on(self, *, armed: bool, mode: FlightMode, mission: MissionReport | None, told_s: float) -> bool:
        """Return whether it has reported since that it is armed and flies the mission it flew before.

        told_s: when the older of its latest HEARTBEAT and MISSION_CURRENT was received.
        """
        if not self._was_flying or mission is None or self._mission is None:
            return False
        return told_s > self.at_s and mission.mission == self._mission and armed and mode is FlightMode.MISSION

    def may_prove(self, now_s: float, within_s: float) -> bool:
        """Return whether it was in the air when it restarted, at most `within_s` ago."""
        return self._was_flying and now_s - self.at_s < within_s
