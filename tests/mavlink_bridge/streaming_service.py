"""A process that streams setpoints until it is killed: python streaming_service.py URL PX4|ARDUPILOT.

uav-1 shall go on from its mission then, so a guard is told of it; uav-2 shall hold.
"""

from __future__ import annotations

import asyncio
import sys
import time

from skyfolio.mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, compile_mission, east_north_to_geodetic
from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.mavlink_bridge.guard import Guard, Orders
from skyfolio.mavlink_bridge.guidance import FallBack, Stream, Streamed
from skyfolio.mavlink_bridge.stream import Streamer
from tests.mavlink_bridge.conftest import Path, plan_of

SLOTS = 40
PATHS: dict[str, Path] = {f"uav-{number}": [(30.0 * number, 20.0 * slot) for slot in range(SLOTS)] for number in (1, 2)}
PLAN = plan_of(PATHS, altitude_m=8.0)
SLOT_S = PLAN.scenario.slot_duration_s


class WallClock:
    def now(self) -> float:
        return time.monotonic()


async def main(url: str, autopilot: Autopilot) -> None:
    guard = Guard()
    async with FleetLink(clock=WallClock(), monitor=HeartbeatMonitor()) as link:
        await link.connect(url)
        await link.wait_for({1, 2}, timeout_s=20)
        await link.prepare({1, 2})
        missions = {
            number: compile_mission(PLAN, f"uav-{number}", autopilot=autopilot, model=link.model(number))
            for number in (1, 2)
        }
        await link.upload(missions)
        await link.launch({1: 8.0, 2: 8.0}, timeout_s=60)
        await guard.start()
        streamed = {
            number: Streamed(vehicle=link.vehicle(number), streamer=_streamer(number), mission=mission)
            for number, mission in missions.items()
        }
        stream = Stream(streamed, scale=1.0, fall_back=FallBack.HOLD)
        await stream.begin()
        began = time.monotonic()
        items = tuple(missions[1].item_of_slot(slot) for slot in range(SLOTS))
        guard.orders(Orders(links=(url,), slot0_at=time.time(), scale=1.0, slot_s=SLOT_S, items={1: items}))
        await stream.run(lambda: time.monotonic() - began)


def _streamer(number: int) -> Streamer:
    origin, path = PLAN.scenario.origin, list(PATHS[f"uav-{number}"])
    return Streamer(
        number, path, SLOT_S, Altitudes((8.0,) * len(path)), lambda point: east_north_to_geodetic(origin, *point)
    )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], Autopilot(sys.argv[2])))
