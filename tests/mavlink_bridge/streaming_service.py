"""A process that streams setpoints until it is killed: python streaming_service.py URL PX4|ARDUPILOT."""

from __future__ import annotations

import asyncio
import sys
import time

from mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, compile_mission, east_north_to_geodetic
from mavlink_bridge.guidance import FallBack, Stream, Streamed
from mavlink_bridge.stream import Streamer
from tests.mavlink_bridge.conftest import plan_of

PATH = [(0.0, 20.0 * slot) for slot in range(40)]


class WallClock:
    def now(self) -> float:
        return time.monotonic()


async def main(url: str, autopilot: Autopilot) -> None:
    plan = plan_of({"uav-1": PATH}, altitude_m=8.0)
    async with FleetLink(clock=WallClock(), monitor=HeartbeatMonitor()) as link:
        await link.connect(url)
        await link.wait_for({1}, timeout_s=20)
        await link.prepare({1})
        mission = compile_mission(plan, "uav-1", autopilot=autopilot, model=link.model(1))
        await link.upload({1: mission})
        await link.launch({1: 8.0}, timeout_s=60)
        streamer = Streamer(1, PATH, 5.0, 8.0, lambda point: east_north_to_geodetic(plan.scenario.origin, *point))
        streamed = Streamed(vehicle=link.vehicle(1), streamer=streamer, mission=mission)
        stream = Stream({1: streamed}, scale=1.0, fall_back=FallBack.MISSION)
        await stream.begin()
        began = time.monotonic()
        await stream.run(lambda: time.monotonic() - began)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], Autopilot(sys.argv[2])))
