"""sim.fleet, sim.station, sim.faults and sim.truth: virtual time without sockets, and real sockets on loopback."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import pytest

from skyfolio.sim import Fleet, Kill, Limits, Mode, Mute, ScaledClock, VehicleSpec, VirtualClock, grid_of, serve

if TYPE_CHECKING:
    from tests.sim.conftest import GroundStation, Items, Listener

HOME = (47.397742, 8.545594)
Listen = Callable[[], "Listener"]


def a_fleet(count: int = 3, **options: Any) -> Fleet:
    return Fleet(grid_of(count, *HOME), clock=VirtualClock(), **options)


def launch(fleet: Fleet, up_m: float = 20.0) -> None:
    for vehicle in fleet.vehicles.values():
        vehicle.autopilot.arm()
        vehicle.autopilot.takeoff(up_m)
    fleet.step_to(fleet.now_s + 20.0)


def test_the_fleet_flies_in_virtual_time_without_sockets() -> None:
    fleet = a_fleet()
    launch(fleet)
    assert [round(vehicle.position[2]) for vehicle in fleet.vehicles.values()] == [20, 20, 20]
    assert {vehicle.mode for vehicle in fleet.vehicles.values()} == {Mode.HOLD}


def test_steps_are_fixed_however_time_is_cut() -> None:
    whole, pieces = a_fleet(), a_fleet()
    launch(whole)
    for vehicle in pieces.vehicles.values():
        vehicle.autopilot.arm()
        vehicle.autopilot.takeoff(20.0)
    for n in range(1, 2001):
        pieces.step_to(n * 0.01)
    assert whole.truth.rows() == pieces.truth.rows()


def test_truth_is_sampled_ten_times_a_second_for_each_vehicle() -> None:
    fleet = a_fleet()
    fleet.step_to(10.0)
    samples = fleet.truth.of(2)
    assert len(samples) == 100
    assert [samples[0].t_s, samples[-1].t_s] == pytest.approx([0.1, 10.0])
    assert (samples[0].mode, samples[0].armed, samples[0].alive, samples[0].transmitting) == ("HOLD", False, True, True)


def test_a_killed_vehicle_falls_crashes_and_is_dead() -> None:
    fleet = a_fleet()
    launch(fleet)
    fleet.inject(Kill(3))
    fleet.step_to(25.0)
    dead = fleet.vehicles[3]
    assert (dead.alive, dead.transmitting, dead.armed, dead.position[2]) == (False, False, False, 0.0)
    assert [event.system_id for event in fleet.truth.happened("killed")] == [3]
    (crash,) = fleet.truth.happened("crashed")
    assert crash.t_s - 20.0 == pytest.approx(2.0, abs=0.1)
    assert fleet.vehicles[1].alive


def test_a_muted_vehicle_flies_on_exactly_as_before(items: "Items", gcs: "GroundStation") -> None:
    tracks = []
    for fault in (None, Mute(1)):
        fleet = a_fleet(1)
        launch(fleet)
        items.seq = 0
        for message in (
            ("mission_count", 1, 1, 2, 0),
            ("mission_item_int", 1, 1, *items.speed(5.0, current=1.0)),
            ("mission_item_int", 1, 1, *items.waypoint(80.0, 0.0)),
        ):
            fleet.vehicles[1].autopilot.handle(gcs.message(*message))
        fleet.vehicles[1].autopilot.set_mode(Mode.MISSION)
        if fault is not None:
            fleet.inject(fault)
        fleet.step_to(60.0)
        tracks.append([(sample.lat_deg, sample.lon_deg, sample.mode) for sample in fleet.truth.of(1)])
        assert fleet.vehicles[1].alive
        assert fleet.vehicles[1].transmitting == (fault is None)
    assert tracks[0] == tracks[1]


def test_a_fault_can_be_scheduled_in_fleet_time() -> None:
    fleet = a_fleet()
    fleet.inject(Mute(2), at_s=5.0)
    fleet.step_to(4.9)
    assert not fleet.truth.happened("muted")
    fleet.step_to(5.1)
    assert not fleet.vehicles[2].transmitting
    assert fleet.truth.happened("muted")[0].t_s == pytest.approx(5.0)


def test_a_fault_for_an_unknown_vehicle_is_refused() -> None:
    with pytest.raises(ValueError, match="no vehicle 9"):
        a_fleet().inject(Kill(9))


def test_truth_keeps_accepted_missions_and_changing_ids(items: "Items", gcs: "GroundStation") -> None:
    fleet = a_fleet(1)
    for message in (("mission_count", 1, 1, 1, 0), ("mission_item_int", 1, 1, *items.waypoint(80.0, 0.0, current=1.0))):
        fleet.vehicles[1].autopilot.handle(gcs.message(*message))
    fleet.step_to(0.2)
    (event,) = fleet.truth.happened("mission_accepted", 1)
    assert [item.command for item in event.detail["items"]] == [16]
    assert fleet.truth.of(1)[-1].mission_id == event.detail["mission_id"] == fleet.vehicles[1].mission.mission_id


def test_a_fleet_that_cannot_be_is_refused() -> None:
    clock = VirtualClock()
    with pytest.raises(ValueError, match="at least one"):
        Fleet([], clock=clock)
    with pytest.raises(ValueError, match="system ids must differ"):
        Fleet([VehicleSpec(1, *HOME), VehicleSpec(1, *HOME)], clock=clock)
    with pytest.raises(ValueError, match="endpoint"):
        a_fleet(endpoint="tcp://127.0.0.1:1")


def test_limits_reach_every_vehicle() -> None:
    fleet = a_fleet(2, limits=Limits(climb_mps=1.0))
    launch(fleet, 50.0)
    assert all(vehicle.position[2] == pytest.approx(20.0, abs=0.5) for vehicle in fleet.vehicles.values())


@asynccontextmanager
async def heard_by(listen: Listen) -> AsyncIterator[tuple["Listener", str]]:
    transport, heard = await asyncio.get_running_loop().create_datagram_endpoint(listen, local_addr=("127.0.0.1", 0))
    heard.transport = transport
    try:
        yield heard, f"udpout://127.0.0.1:{transport.get_extra_info('sockname')[1]}"
    finally:
        transport.close()


async def until(condition: Callable[[], bool], within_s: float = 60.0) -> None:
    async with asyncio.timeout(within_s):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0)


async def settle() -> None:
    """Let the event loop read what lies in its sockets; on loopback nothing is under way longer than its `sendto`."""
    for _ in range(50):
        await asyncio.sleep(0)


async def test_each_vehicle_speaks_from_its_own_port(listener: Listen) -> None:
    async with heard_by(listener) as (gcs, endpoint):
        fleet = a_fleet(endpoint=endpoint)
        async with fleet:
            fleet.step_to(1.0)
            await until(lambda: len({message.get_srcSystem() for message, _ in gcs.heard}) == 3)
        ports = {(message.get_srcSystem(), address) for message, address in gcs.heard}
        assert len(ports) == len({address for _, address in ports}) == 3


async def test_after_a_kill_no_message_arrives_while_the_others_still_send(
    listener: Listen, gcs: "GroundStation"
) -> None:
    async with heard_by(listener) as (ears, endpoint):
        fleet = a_fleet(endpoint=endpoint)
        async with fleet:
            fleet.step_to(2.0)
            await until(lambda: any(message.get_srcSystem() == 3 for message, _ in ears.heard))
            (port_of_3,) = {address for message, address in ears.heard if message.get_srcSystem() == 3}
            fleet.inject(Kill(3))
            await settle()
            ears.heard.clear()
            assert ears.transport is not None
            ears.transport.sendto(gcs.frame("command_long", 3, 1, 512, 0, 0.0, *[0.0] * 6), port_of_3)
            fleet.step_to(120.0)
            await settle()
        speakers = {message.get_srcSystem() for message, _ in ears.heard}
        assert speakers == {1, 2}


async def test_a_muted_vehicle_receives_nothing(listener: Listen, gcs: "GroundStation") -> None:
    async with heard_by(listener) as (ears, endpoint):
        fleet = a_fleet(1, endpoint=endpoint)
        async with fleet:
            fleet.step_to(1.0)
            await until(lambda: bool(ears.heard))
            address = ears.heard[0][1]
            fleet.inject(Mute(1))
            assert ears.transport is not None
            ears.transport.sendto(gcs.frame("command_long", 1, 1, 400, 0, 1.0, *[0.0] * 6), address)
            await settle()
        assert not fleet.vehicles[1].armed


async def test_a_command_over_the_socket_is_answered_to_its_sender(listener: Listen, gcs: "GroundStation") -> None:
    async with heard_by(listener) as (ears, endpoint), heard_by(listener) as (other, _):
        fleet = a_fleet(1, endpoint=endpoint)
        async with fleet:
            fleet.step_to(1.0)
            await until(lambda: bool(ears.heard))
            assert other.transport is not None
            frame = gcs.frame("command_long", 1, 1, 400, 0, 1.0, *[0.0] * 6)
            other.transport.sendto(frame, ears.heard[0][1])
            await until(lambda: any(message.get_type() == "COMMAND_ACK" for message, _ in other.heard))
            await settle()
        assert fleet.vehicles[1].armed
        assert not any(message.get_type() == "COMMAND_ACK" for message, _ in ears.heard)


async def test_serve_flies_for_a_while_and_closes(listener: Listen) -> None:
    async with heard_by(listener) as (ears, endpoint):
        fleet = Fleet(grid_of(2, *HOME), clock=ScaledClock(100.0), endpoint=endpoint)
        await serve(fleet, for_s=5.0)
        await settle()
        assert {message.get_srcSystem() for message, _ in ears.heard} == {1, 2}
        assert 5.0 <= fleet.now_s < 60.0


async def test_serve_ends_on_request(listener: Listen) -> None:
    async with heard_by(listener) as (_, endpoint):
        stop = asyncio.Event()
        fleet = Fleet(grid_of(1, *HOME), clock=ScaledClock(1.0), endpoint=endpoint)
        serving = asyncio.create_task(serve(fleet, until=stop))
        await settle()
        assert not serving.done()
        stop.set()
        async with asyncio.timeout(60):
            await serving


async def test_what_breaks_the_fleet_is_raised_by_serve(listener: Listen) -> None:
    class Broken:
        def now(self) -> float:
            if self.calls > 1:
                raise RuntimeError("no time left")
            self.calls += 1
            return 0.0

        calls = 0

    async with heard_by(listener) as (_, endpoint):
        fleet = Fleet(grid_of(1, *HOME), clock=Broken(), endpoint=endpoint)
        with pytest.raises(RuntimeError, match="no time left"):
            await serve(fleet)
