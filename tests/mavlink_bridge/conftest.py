"""Small plans made by hand: what the bridge needs of a plan is its scenario and its trajectories."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import pytest

from skyfolio.api.lab.virtual.wire import MemoryEndpoint, MemoryMessages, Port
from skyfolio.mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, LinkOptions, east_north_to_geodetic
from skyfolio.mavlink_bridge.ports import LinkPorts
from skyfolio.planner.plans import Plan, Summary
from skyfolio.planner.scenario import Origin, Scenario, Uav, User
from skyfolio.sim import Fleet, ScaledClock, VehicleSpec
from skyfolio.sim.fleet import STEP_S
from tests.pacing import paced
from tests.ports import free_port
from tests.virtual_time import time_is_virtual

Path = Sequence[tuple[float, float]]
PlanOf = Callable[..., Plan]

ZURICH = Origin(lat_deg=47.397742, lon_deg=8.545594)


def plan_of(
    paths: dict[str, Path], *, slot_s: float = 5.0, altitude_m: float = 60.0, min_separation_m: float = 4.0
) -> Plan:
    """A plan that flies `paths` (uav id -> (n_slots, 2) metres east/north) and serves nobody in particular."""
    ids = list(paths)
    slots = len(paths[ids[0]])
    scenario = Scenario(
        origin=ZURICH,
        area_m=((-90_000.0, -90_000.0), (90_000.0, 90_000.0)),
        slots=slots,
        slot_duration_s=slot_s,
        altitude_m=altitude_m,
        min_separation_m=min_separation_m,
        uavs=tuple(Uav(id=uav, start_m=paths[uav][0], max_speed_mps=100.0) for uav in ids),
        users=(User(id="user-1", position_m=(0.0, 0.0)),),
    )
    return Plan(
        id="by-hand",
        method="by hand",
        scenario=scenario,
        trajectories_m={uav: list(path) for uav, path in paths.items()},
        association={"user-1": [ids[0]] * slots},
        bandwidth_hz={"user-1": [10_000.0] * slots},
        user_rates_bps={"user-1": [1.0] * slots},
        summary=Summary.steady(1.0),
    )


@pytest.fixture(name="plan_of", scope="session")
def _plan_of() -> PlanOf:
    return plan_of


@pytest.fixture
def line_and_hover() -> Plan:
    """uav-1: two legs straight east, two hovering slots, then north, then east again; 7 slots."""
    east_then_north = [(0.0, 0.0), (20.0, 0.0), (42.0, 0.0), (42.0, 0.0), (42.0, 0.0), (42.0, 15.0), (60.0, 15.0)]
    return plan_of({"uav-1": east_then_north})


Tamper = Callable[[bytes], list[bytes]]
"""What becomes of one datagram: passed on, dropped, or turned into others."""


class Relay:
    """A UDP wire between one vehicle and the ground that a test may cut, thin out or tamper with."""

    def __init__(self, ground_port: int) -> None:
        self.to_ground: Tamper = lambda datagram: [datagram]
        self.to_vehicle: Tamper = lambda datagram: [datagram]
        self.port = 0
        self._ground = ("127.0.0.1", ground_port)
        self._vehicle: tuple[str, int] | None = None
        self._transports: list[asyncio.DatagramTransport] = []

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        for receive in (self._from_vehicle, self._from_ground):
            transport, _ = await loop.create_datagram_endpoint(partial(_End, receive), local_addr=("127.0.0.1", 0))
            self._transports.append(transport)
        self.port = self._transports[0].get_extra_info("sockname")[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        for transport in self._transports:
            transport.close()
        await asyncio.sleep(0)

    def _from_vehicle(self, datagram: bytes, sender: tuple[str, int]) -> None:
        self._vehicle = sender
        for one in self.to_ground(datagram):
            self._transports[1].sendto(one, self._ground)

    def _from_ground(self, datagram: bytes, _sender: tuple[str, int]) -> None:
        if self._vehicle is not None:
            for one in self.to_vehicle(datagram):
                self._transports[0].sendto(one, self._vehicle)


class _End(asyncio.DatagramProtocol):
    def __init__(self, receive: Callable[[bytes, tuple[str, int]], None]) -> None:
        self._receive = receive

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._receive(data, addr)


@dataclass
class Airfield:
    """Simulated vehicles and a link that has found them, on one clock."""

    fleet: Fleet
    link: FleetLink
    clock: ScaledClock
    port: int

    async def fly_for(self, fleet_seconds: float) -> None:
        """Let fleet time pass."""
        await asyncio.sleep(fleet_seconds / self.clock.speedup)


def specs_at(plan: Plan, autopilot: Autopilot = Autopilot.PX4) -> list[VehicleSpec]:
    """Vehicles 1, 2, ... standing at the slot-0 points of the plan's UAVs, in order."""
    origin = plan.scenario.origin
    starts = [path[0] for path in plan.trajectories_m.values()]
    places = [east_north_to_geodetic(origin, *start) for start in starts]
    return [VehicleSpec(n, *place, autopilot=autopilot.value) for n, place in enumerate(places, start=1)]


OpenAirfield = Callable[..., AbstractAsyncContextManager[Airfield]]


@pytest.fixture
def airfield() -> OpenAirfield:
    """Opens `airfield(plan, speedup=..., endpoint=None, port=None)`: a vehicle for each UAV, found by the link.

    On sockets and with MAVSDK the running loop is paced meanwhile: what sleeps in it, and every time-out, waits with
    the fleet (`tests.pacing`). In virtual time (`tests.virtual_time`) the link is in memory, and needs no port.
    """

    @asynccontextmanager
    async def opened(
        plan: Plan, *, autopilot: Autopilot = Autopilot.PX4, wait_s: float = 10.0, **options: Any
    ) -> AsyncIterator[Airfield]:
        how = in_memory if time_is_virtual() else on_sockets
        async with how(plan, autopilot, **options) as field:
            await field.link.wait_for(set(field.fleet.vehicles), timeout_s=wait_s)
            if autopilot is Autopilot.ARDUPILOT:  # it streams no position unasked
                await field.link.prepare(field.fleet.vehicles)
            yield field

    return opened


@asynccontextmanager
async def on_sockets(
    plan: Plan,
    autopilot: Autopilot,
    *,
    speedup: float = 10.0,
    endpoint: str | None = None,
    port: int | None = None,
    options: LinkOptions | None = None,
    signing_key: bytes | None = None,
) -> AsyncIterator[Airfield]:
    port = port or free_port(socket.SOCK_DGRAM)
    with paced(speedup) as pace:
        clock = pace.fleet_clock()
        fleet = Fleet(
            specs_at(plan, autopilot),
            clock=clock,
            endpoint=endpoint or f"udpout://127.0.0.1:{port}",
            protocol_clock=pace,
            signing_key=signing_key,
        )
        async with fleet, FleetLink(clock=clock, monitor=HeartbeatMonitor(), options=options) as link:
            await link.connect(f"udpin://127.0.0.1:{port}")
            yield Airfield(fleet, link, clock, port)


@asynccontextmanager
async def in_memory(plan: Plan, autopilot: Autopilot, *, speedup: float = 10.0) -> AsyncIterator[Airfield]:
    loop = asyncio.get_running_loop()
    clock = ScaledClock(speedup, source=loop.time)
    fleet = Fleet(specs_at(plan, autopilot), clock=clock, protocol_clock=loop.time)
    port = Port(fleet)
    ports = LinkPorts(
        endpoint=lambda url, on_frames: MemoryEndpoint(port, url, on_frames, alive=lambda: True),
        messages=MemoryMessages,
    )
    stepping = loop.create_task(step(fleet, clock))
    try:
        async with FleetLink(clock=clock, monitor=HeartbeatMonitor(), ports=ports) as link:
            await link.connect("udpin://in-memory:1")
            yield Airfield(fleet, link, clock, 0)
    finally:
        stepping.cancel()
        await asyncio.gather(stepping, return_exceptions=True)


async def step(fleet: Fleet, clock: ScaledClock) -> None:
    """Let the fleet live, until cancelled."""
    while True:
        await asyncio.sleep(STEP_S / clock.speedup)
        fleet.step_to(clock.now())


@pytest.fixture
def relay_to() -> Callable[[int], Relay]:
    return Relay


@pytest.fixture
def trio() -> Plan:
    """Three UAVs side by side, 40 m apart, flying north with legs of 10 and 12 m in turn; 20 slots."""
    return plan_of({f"uav-{n}": [(40.0 * n, 11.0 * slot + slot % 2) for slot in range(20)] for n in (1, 2, 3)})
