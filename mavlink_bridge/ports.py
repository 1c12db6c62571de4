"""What a link is made of: sockets and MAVSDK, unless it is given something else in their place."""

from __future__ import annotations

from dataclasses import dataclass

from skyfolio.mavlink_bridge.endpoints import endpoint_of
from skyfolio.mavlink_bridge.links import MakeEndpoint
from skyfolio.mavlink_bridge.mavsdk_port import MavsdkPort
from skyfolio.mavlink_bridge.message_port import OpenPort


@dataclass(frozen=True, kw_only=True)
class LinkPorts:
    """endpoint: makes the endpoint of a URL. messages: opens the port that speaks MAVLink."""

    endpoint: MakeEndpoint = endpoint_of
    messages: OpenPort = MavsdkPort
