"""The autopilots the bridge knows, one row each, and how one is looked up."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from skyfolio.mavlink_bridge.ardupilot import ARDUCOPTER
from skyfolio.mavlink_bridge.autopilots import Autopilot, MavAutopilot
from skyfolio.mavlink_bridge.errors import UnknownAutopilot
from skyfolio.mavlink_bridge.profile import AutopilotProfile
from skyfolio.mavlink_bridge.px4 import PX4

_ROWS = (
    PX4,
    ARDUCOPTER,
)

PROFILES: Mapping[Autopilot, AutopilotProfile] = MappingProxyType({profile.autopilot: profile for profile in _ROWS})
_BY_HEARTBEAT = {profile.mav_autopilot: profile for profile in _ROWS}
KNOWN = " or ".join(profile.title for profile in _ROWS)
"""The known autopilots, for texts."""


def profile_of(autopilot: Autopilot) -> AutopilotProfile:
    """Return the profile of an autopilot. Raises UnknownAutopilot for a name that has none."""
    try:
        return PROFILES[autopilot]
    except KeyError:
        raise UnknownAutopilot(f"'{autopilot}'", KNOWN) from None


def profile_in_heartbeat(mav_autopilot: int) -> AutopilotProfile | None:
    """Return the profile of the autopilot that HEARTBEAT.autopilot (MAV_AUTOPILOT) names, None for an unknown one."""
    return _BY_HEARTBEAT.get(MavAutopilot(mav_autopilot))


def unknown_autopilot(mav_autopilot: int | None) -> UnknownAutopilot:
    """Return the error that names an autopilot without a profile by its MAV_AUTOPILOT (None: not heard yet)."""
    if mav_autopilot is None:
        return UnknownAutopilot("not heard yet", KNOWN)
    return UnknownAutopilot(f"{MavAutopilot(mav_autopilot).name} (MAV_AUTOPILOT {mav_autopilot})", KNOWN)
