"""How a flight is to be guided, as the client asks for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skyfolio.mavlink_bridge import OnEnd
from skyfolio.mavlink_bridge.guidance import FallBack

Mode = Literal["mission", "stream"]
"""What UAVs follow: the missions on board, or setpoints that the service sends."""


@dataclass(frozen=True)
class GuidanceOptions:
    """The options of one flight.

    fall_back: what UAVs do when a stream of setpoints ends. at_end: what they do after the last slot. force_stream:
    stream even to vehicles that would not hold when setpoints end.
    """

    mode: Mode = "mission"
    fall_back: FallBack = FallBack.MISSION
    at_end: OnEnd = OnEnd.LAND
    force_stream: bool = False
