"""The bridge's flight tests with one autopilot, the first of those that somebody has running: see docs/sitl.md.

SITL_URL=tcpout://127.0.0.1:5760 make test-sitl
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from functools import partial
from math import hypot

import pytest

from skyfolio.api.fleet.trial_mission import ALTITUDE_M, SLOT_S, SQUARE, trial_plan
from skyfolio.mavlink_bridge import (
    FleetLink,
    FlightMode,
    HeartbeatMonitor,
    Mission,
    compile_mission,
    east_north_to_geodetic,
    geodetic_to_east_north,
    mission_differences,
)
from skyfolio.mavlink_bridge.altitudes import Altitudes
from skyfolio.mavlink_bridge.fence import fence_items
from skyfolio.mavlink_bridge.guidance import FallBack, Stream, Streamed
from skyfolio.mavlink_bridge.keeper import Keeper
from skyfolio.mavlink_bridge.keeping import Kept, keep
from skyfolio.mavlink_bridge.preflight import audit
from skyfolio.mavlink_bridge.slip import Slip
from skyfolio.mavlink_bridge.stream import Streamer
from skyfolio.planner import Origin, Plan
from tests.sitl.field import MARKS, SYSTEMS, URLS

SYSTEM = SYSTEMS[0] if SYSTEMS else 1
pytestmark = MARKS


class WallClock:
    """A real aircraft lives in real time."""

    def now(self) -> float:
        return time.monotonic()


@dataclass
class Ready:
    """The vehicle, heard and asked for its telemetry and parameters."""

    link: FleetLink
    origin: Origin

    def plan_of(self, path: Sequence[tuple[float, float]]) -> Plan:
        """A plan that begins where the vehicle stood when the test began."""
        return trial_plan(self.origin, {"uav-1": path})

    def compiled(self, path: Sequence[tuple[float, float]], *, airborne: bool = False) -> Mission:
        """The mission for this very vehicle."""
        link = self.link
        return compile_mission(
            self.plan_of(path), "uav-1", airborne=airborne, autopilot=link.autopilot(SYSTEM), model=link.model(SYSTEM)
        )

    def at_m(self) -> tuple[float, float]:
        """Where it is, metres east/north of where it stood."""
        said = self.link.telemetry(SYSTEM)
        assert said is not None
        assert said.place_deg is not None
        return geodetic_to_east_north(self.origin, *said.place_deg)

    async def climb(self) -> None:
        """Take off, and hover over the slot-0 point."""
        (launched,) = (await self.link.launch({SYSTEM: ALTITUDE_M}, timeout_s=120)).values()
        assert launched.ok, launched.error
        await asyncio.sleep(3.0)

    async def come_back(self) -> None:
        """Land and wait until it is disarmed."""
        await self.link.land({SYSTEM})
        async with asyncio.timeout(120):
            while (said := self.link.telemetry(SYSTEM)) is None or said.armed:  # noqa: ASYNC110
                await asyncio.sleep(0.5)


def _place(origin: Origin, point: tuple[float, float]) -> tuple[float, float]:
    return east_north_to_geodetic(origin, *point)


@pytest.fixture
async def ready() -> AsyncIterator[Ready]:
    async with FleetLink(clock=WallClock(), monitor=HeartbeatMonitor()) as link:
        await link.connect(URLS[0])
        await link.wait_for({SYSTEM}, timeout_s=60)
        (prepared,) = (await link.prepare({SYSTEM})).values()
        assert prepared.ok, prepared.error
        missing = await link.wait_for_facts({SYSTEM})
        said = link.telemetry(SYSTEM)
        assert said is not None
        assert said.place_deg is not None, missing
        one = Ready(link, Origin(lat_deg=said.place_deg[0], lon_deg=said.place_deg[1]))
        try:
            yield one
        finally:
            if (last := link.telemetry(SYSTEM)) is not None and last.armed:
                await one.come_back()


async def test_the_vehicle_tells_its_model_and_the_audit_reads_it(ready: Ready) -> None:
    model = ready.link.model(SYSTEM)
    assert 0.1 < model.acceleration_mps2 < 20
    findings = audit(*ready.link.facts(SYSTEM, ready.plan_of(SQUARE), "uav-1", items=20))
    for finding in findings:
        print(f"{finding.level:8} {finding.name}: {finding.found}, should be {finding.should} ({finding.why})")  # noqa: T201


async def test_a_mission_and_a_fence_are_on_board_and_proven(ready: Ready) -> None:
    mission = ready.compiled(SQUARE)
    (uploaded,) = (await ready.link.upload({SYSTEM: mission})).values()
    assert uploaded.verified, uploaded.error
    fence = fence_items(ready.plan_of(SQUARE).scenario)
    (fenced,) = (await ready.link.upload_fence({SYSTEM: fence})).values()
    assert fenced.verified, fenced.error
    (cleared,) = (await ready.link.upload_fence({SYSTEM: ()})).values()
    assert cleared.verified, cleared.error
    assert mission_differences(mission.items, mission.items) == ()


async def test_a_plan_is_flown_on_the_slot_clock_and_swapped_in_flight(ready: Ready) -> None:
    flown = ready.compiled(SQUARE)
    (uploaded,) = (await ready.link.upload({SYSTEM: flown})).values()
    assert uploaded.verified, uploaded.error
    await ready.climb()
    slips: list[Slip] = []
    keeper = Keeper(list(SQUARE), SLOT_S, flown, ready.link.model(SYSTEM))
    kept = Kept(vehicle=ready.link.vehicle(SYSTEM), keeper=keeper, origin=ready.origin)
    began = time.monotonic()
    (started,) = (await ready.link.start({SYSTEM})).values()
    assert started.ok, started.error
    keeping = asyncio.create_task(
        keep(
            {SYSTEM: kept},
            elapsed_s=lambda: time.monotonic() - began,
            now_s=time.monotonic,
            scale=1.0,
            on_slip=lambda _system, slip: slips.append(slip),
        )
    )
    await asyncio.sleep(5 * SLOT_S + 0.5)
    keeping.cancel()
    print([round(slip.distance_m, 1) for slip in slips])  # noqa: T201
    assert len(slips) == 5
    assert max(slip.distance_m for slip in slips) < 15.0
    home = [ready.at_m(), (10.0, 10.0), (0.0, 0.0)]
    (swapped,) = (await ready.link.swap({SYSTEM: ready.compiled(home, airborne=True)})).values()
    assert swapped.ok, swapped.error
    print(f"swapped in {swapped.seconds:.2f} s")  # noqa: T201
    await asyncio.sleep(3 * SLOT_S)
    assert hypot(*ready.at_m()) < 10.0


async def test_a_stream_is_followed_and_its_end_leaves_the_mission(ready: Ready) -> None:
    mission = ready.compiled(SQUARE)
    (uploaded,) = (await ready.link.upload({SYSTEM: mission})).values()
    assert uploaded.verified, uploaded.error
    await ready.climb()
    place = partial(_place, ready.origin)
    streamer = Streamer(SYSTEM, list(SQUARE), SLOT_S, Altitudes((ALTITUDE_M,) * len(SQUARE)), place)
    streamed = Streamed(vehicle=ready.link.vehicle(SYSTEM), streamer=streamer, mission=mission)
    stream = Stream({SYSTEM: streamed}, scale=1.0, fall_back=FallBack.MISSION)
    assert (await stream.begin())[SYSTEM] is None
    began = time.monotonic()
    running = asyncio.create_task(stream.run(lambda: time.monotonic() - began))
    distances = []
    for slot in range(1, 4):
        await asyncio.sleep(began + slot * SLOT_S - time.monotonic())
        east, north = ready.at_m()
        distances.append(hypot(east - SQUARE[slot][0], north - SQUARE[slot][1]))
    print([round(distance, 1) for distance in distances])  # noqa: T201
    assert max(distances) < 4.0
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert ready.link.vehicle(SYSTEM).state.mode is FlightMode.MISSION
