"""Which HEARTBEATs of a system come from its autopilot. Pure, used by `telemetry` and `evidence`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode, speaks_as_autopilot
from skyfolio.mavlink_bridge.profile import AutopilotProfile
from skyfolio.mavlink_bridge.profiles import profile_in_heartbeat

_SAME_FOR_S = 5.5
"""Fleet seconds of silence after which another autopilot may have taken over the system id."""


class Speaker:
    """Tells the HEARTBEATs of a system's autopilot from others of component 1: no autopilot changes in flight."""

    def __init__(self) -> None:
        self.profile: AutopilotProfile | None = None
        """The autopilot's profile; None until it was heard, and for an autopilot that has none."""
        self.mav_autopilot: int | None = None
        """MAV_AUTOPILOT of its latest HEARTBEAT; None until it was heard."""
        self._heard_s = float("-inf")

    @property
    def autopilot(self) -> Autopilot | None:
        """Return which autopilot it is; None until it was heard, and for one without a profile."""
        return None if self.profile is None else self.profile.autopilot

    def believes(self, fields: Mapping[str, Any], heard_s: float) -> bool:
        """Return whether this HEARTBEAT, received at `heard_s` fleet seconds, is the autopilot's own."""
        number = int(fields["autopilot"])
        if not speaks_as_autopilot(int(fields.get("type", 0)), number):
            return False
        profile = profile_in_heartbeat(number)
        if self.profile is not None and profile is not self.profile and heard_s - self._heard_s < _SAME_FOR_S:
            return False
        self.profile, self.mav_autopilot, self._heard_s = profile, number, heard_s
        return True

    def mode_of(self, custom_mode: int) -> FlightMode:
        """Return HEARTBEAT.custom_mode as a mode; OTHER for an autopilot whose numbers are not known."""
        return FlightMode.OTHER if self.profile is None else self.profile.read_mode(custom_mode)

    def items_on_board(self, total: int) -> int | None:
        """Return the length of the uploaded mission from MISSION_CURRENT.total; None if that cannot be known."""
        return None if self.profile is None else self.profile.items_on_board(total)
