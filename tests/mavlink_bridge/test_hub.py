"""Links: failover, several peers on one port, TCP, serial, the forward port, the log, and our own heartbeat."""

from __future__ import annotations

import asyncio
import os
import pty
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.mavlink_bridge import ConnectionFailed, LinkOptions, Signing, compile_mission
from skyfolio.mavlink_bridge.framing import Frame, Framer
from skyfolio.mavlink_bridge.hub import Hub
from skyfolio.mavlink_bridge.routing import FRESH_S, STEADY_S, Routes
from skyfolio.mavlink_bridge.serial_line import SerialLine
from skyfolio.mavlink_bridge.tlog import TelemetryLog
from skyfolio.planner.plans import Plan

Open = Callable[..., Any]


def beat(system_id: int = 1, seq: int = 0, component: int = 1) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=system_id, srcComponent=component)
    mav.seq = seq
    return bytes(dialect.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3).pack(mav))


def command_to(system_id: int) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=245, srcComponent=190)
    return bytes(dialect.MAVLink_command_long_message(system_id, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(mav))


def frame(data: bytes) -> Frame:
    (only,) = Framer().feed(data)
    return only


# -- routes, in virtual time ------------------------------------------------------------------------------------------


def test_the_first_link_that_works_is_used_and_gone_back_to_once_it_is_steady() -> None:
    routes = Routes()
    routes.add("radio")
    routes.add("cell")
    used = []
    for tenth in range(300):
        now = tenth / 10
        if tenth % 10 == 0:
            if not 5 <= now < 15:  # the radio is away for ten seconds
                routes.heard("radio", frame(beat(seq=tenth % 256)), now)
            routes.heard("cell", frame(beat(seq=tenth % 256)), now)
        used.append(routes.links_of(1, now)[0])
    changes = [tenth / 10 for tenth in range(1, 300) if used[tenth] != used[tenth - 1]]
    assert used[0] == used[-1] == "radio"
    assert len(changes) == 2
    assert 4.0 < changes[0] <= 4.0 + FRESH_S + 0.2
    assert changes[1] == pytest.approx(15.0 + STEADY_S, abs=0.2)


def test_the_copy_that_came_on_another_link_is_not_new_and_a_repetition_on_the_same_is() -> None:
    routes = Routes()
    assert routes.heard("radio", frame(beat()), 0.0)
    assert routes.heard("radio", frame(beat()), 0.1)
    routes.heard("cell", frame(beat(seq=9)), 0.1)
    assert routes.heard("radio", frame(beat(seq=1)), 0.2)
    assert not routes.heard("cell", frame(beat(seq=1)), 0.25)


def test_a_vehicle_nobody_heard_is_looked_for_on_all_links() -> None:
    routes = Routes()
    routes.add("radio")
    routes.add("cell")
    assert routes.links_of(7, 0.0) == ["radio", "cell"]


def test_noise_between_frames_is_skipped_and_damaged_frames_are_counted() -> None:
    damaged = bytearray(beat(seq=3))
    damaged[12] ^= 0xFF
    framer = Framer()
    stream = b"\x00\xfe\x01" + beat() + bytes(damaged) + b"noise" + beat(seq=1)
    frames = [found for at in range(0, len(stream), 7) for found in framer.feed(stream[at : at + 7])]
    assert [found.seq for found in frames] == [0, 1]
    assert framer.damaged >= 1


# -- the hub with sockets ---------------------------------------------------------------------------------------------


class World:
    """A hub and what comes out of it."""

    def __init__(self, options: LinkOptions | None = None) -> None:
        self.heard: list[bytes] = []
        self.hub = Hub(options or LinkOptions(), to_mavsdk=self.heard.append, on_heard=lambda _frame: None)

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(60):
            while not condition():  # noqa: ASYNC110
                await asyncio.sleep(0.01)


class Peer(asyncio.DatagramProtocol):
    """A vehicle or a ground station on a UDP socket."""

    def __init__(self) -> None:
        self.got: list[bytes] = []
        self.transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        del addr
        self.got.append(data)


async def peer(to: int | None = None, at: int = 0) -> Peer:
    loop = asyncio.get_running_loop()
    if to is not None:
        _, made = await loop.create_datagram_endpoint(Peer, remote_addr=("127.0.0.1", to))
    else:
        _, made = await loop.create_datagram_endpoint(Peer, local_addr=("127.0.0.1", at))
    return made


async def test_eight_vehicles_on_one_port_each_get_what_is_for_them(free_port: int) -> None:
    world = World()
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    peers = {n: await peer(to=free_port) for n in range(1, 9)}
    for n, one in peers.items():
        one.transport.sendto(beat(n))
    await world.until(lambda: len(world.heard) == 8)
    for n in peers:
        world.hub.to_vehicles(command_to(n))
    world.hub.to_vehicles(beat(245, component=190))
    await world.until(lambda: all(len(one.got) == 2 for one in peers.values()))
    assert all(one.got[0] == command_to(n) for n, one in peers.items())
    world.hub.close()
    for one in peers.values():
        one.transport.close()


async def test_nobody_takes_over_the_id_of_a_vehicle_that_is_heard(free_port: int) -> None:
    world = World()
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    genuine, thief = await peer(to=free_port), await peer(to=free_port)
    genuine.transport.sendto(beat())
    await world.until(lambda: len(world.heard) == 1)
    thief.transport.sendto(beat(seq=1))
    thief.transport.sendto(beat(2))
    await world.until(lambda: len(world.heard) == 2)
    world.hub.to_vehicles(command_to(1))
    await world.until(lambda: len(genuine.got) == 1)
    assert thief.got == []
    world.hub.close()
    genuine.transport.close()
    thief.transport.close()


async def test_nothing_leaves_for_a_vehicle_that_is_another_services_or_after_our_time_is_up(free_port: int) -> None:
    ours = {0, 1}
    world = World(LinkOptions(may_send=lambda system_id: system_id in ours))
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    peers = {n: await peer(to=free_port) for n in (1, 2)}
    for n, one in peers.items():
        one.transport.sendto(beat(n))
    await world.until(lambda: len(world.heard) == 2)
    for data in (command_to(2), beat(245, component=190), command_to(1)):
        world.hub.to_vehicles(data)
    await world.until(lambda: len(peers[1].got) == 2)
    assert peers[1].got == [beat(245, component=190), command_to(1)]
    world.hub.to_vehicles(command_to(1))  # on its way when the time is up
    ours.clear()
    world.hub.to_vehicles(beat(245, seq=1, component=190))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    ours |= {0, 2}
    world.hub.to_vehicles(command_to(2))
    await world.until(lambda: len(peers[2].got) == 1)
    assert peers[2].got == [command_to(2)]
    assert len(peers[1].got) == 2
    world.hub.close()
    for one in peers.values():
        one.transport.close()


async def test_our_heartbeat_is_only_sent_while_we_are_healthy(free_port: int) -> None:
    healthy = True
    world = World(LinkOptions(healthy=lambda: healthy))
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    vehicle = await peer(to=free_port)
    vehicle.transport.sendto(beat())
    await world.until(lambda: len(world.heard) == 1)
    world.hub.to_vehicles(beat(245, 1, 190))
    await world.until(lambda: len(vehicle.got) == 1)
    healthy = False
    world.hub.to_vehicles(beat(245, 2, 190))
    world.hub.to_vehicles(command_to(1))
    await world.until(lambda: len(vehicle.got) == 2)
    assert vehicle.got[1] == command_to(1)  # commands go on, the dead man's switch does not
    world.hub.close()
    vehicle.transport.close()


async def test_a_ground_station_watches_the_fleet_and_cannot_command_it_unless_it_may(free_port: int) -> None:
    watcher = await peer()
    port = watcher.transport.get_extra_info("sockname")[1]
    world = World(LinkOptions(forward=f"udpout://127.0.0.1:{port}"))
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    vehicle = await peer(to=free_port)
    vehicle.transport.sendto(beat() + beat(1, 1))
    await world.until(lambda: b"".join(watcher.got) == beat() + beat(1, 1))
    world.hub.close()
    vehicle.transport.close()
    watcher.transport.close()


async def test_a_watcher_that_may_command_reaches_the_vehicle(free_port: int) -> None:
    got: list[tuple[bytes, Any]] = []

    class Station(Peer):
        def datagram_received(self, data: bytes, addr: Any) -> None:
            got.append((data, addr))

    loop = asyncio.get_running_loop()
    station, _ = await loop.create_datagram_endpoint(Station, local_addr=("127.0.0.1", 0))
    port = station.get_extra_info("sockname")[1]
    world = World(LinkOptions(forward=f"udpout://127.0.0.1:{port}", forward_commands=True))
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    vehicle = await peer(to=free_port)
    vehicle.transport.sendto(beat())
    await world.until(lambda: bool(got))
    station.sendto(command_to(1), got[0][1])
    await world.until(lambda: vehicle.got == [command_to(1)])
    world.hub.close()
    vehicle.transport.close()
    station.close()


async def test_a_tcp_link_comes_back_after_it_broke() -> None:
    connections: list[asyncio.StreamWriter] = []

    async def serve(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(writer)
        writer.write(beat(seq=len(connections)))

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    world = World()
    await world.hub.connect(f"tcpout://127.0.0.1:{port}")
    await world.until(lambda: len(world.heard) == 1)
    connections[0].close()
    await world.until(lambda: len(world.heard) == 2)
    world.hub.close()
    connections[1].close()
    server.close()
    await asyncio.sleep(0)


async def test_a_serial_line_carries_frames_both_ways() -> None:
    radio, device = pty.openpty()
    tty.setraw(radio)
    tty.setraw(device)
    world = World()
    await world.hub.connect(f"serial://{os.ttyname(device)}:57600")
    os.write(radio, beat()[:5])
    os.write(radio, beat()[5:])
    await world.until(lambda: world.heard == [beat()])
    world.hub.to_vehicles(command_to(1))
    await asyncio.sleep(0.05)
    assert os.read(radio, 1000) == command_to(1)
    world.hub.close()
    os.close(radio)
    os.close(device)


async def test_a_saturated_serial_line_takes_whole_frames_or_none_and_never_waits() -> None:
    radio, device = pty.openpty()
    tty.setraw(radio)
    tty.setraw(device)
    world = World()
    url = f"serial://{os.ttyname(device)}:57600"
    await world.hub.connect(url)
    line = world.hub._endpoints[url]
    assert isinstance(line, SerialLine)
    sent = 3_000
    for number in range(sent):  # nobody reads meanwhile: the line's own buffer is full after some
        line.send(command_to(number % 250 + 1), 1)
    assert line.dropped > 0
    os.set_blocking(radio, False)
    framer, frames = Framer(), list[Frame]()
    while len(frames) < sent - line.dropped:
        await asyncio.sleep(0)
        with suppress(BlockingIOError):
            frames += framer.feed(os.read(radio, 4096))
    assert framer.damaged == 0
    world.hub.close()
    os.close(radio)
    os.close(device)


async def test_strangers_are_not_heard_and_cost_nothing(free_port: int) -> None:
    heard: list[bytes] = []
    hub = Hub(LinkOptions(), to_mavsdk=heard.append, on_heard=lambda _frame: None, is_wanted={1}.__contains__)
    await hub.connect(f"udpin://127.0.0.1:{free_port}")
    stranger, ours = await peer(to=free_port), await peer(to=free_port)
    for system in range(2, 254):
        stranger.transport.sendto(beat(system))
    ours.transport.sendto(beat(1))
    async with asyncio.timeout(60):
        while not heard:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    assert heard == [beat(1)]
    assert set(hub._senders._claims) == {(1, 1)}
    assert set(hub._routes._ways) == {1}
    hub.close()
    stranger.transport.close()
    ours.transport.close()


async def test_with_signing_an_unsigned_forger_claims_no_id(free_port: int) -> None:
    key = Signing(b"k" * 32)
    world = World(LinkOptions(signing=Signing(b"k" * 32)))
    await world.hub.connect(f"udpin://127.0.0.1:{free_port}")
    forger, genuine = await peer(to=free_port), await peer(to=free_port)
    forger.transport.sendto(beat())
    await asyncio.sleep(0.05)
    genuine.transport.sendto(key.sign(beat(seq=1)))
    await world.until(lambda: world.heard == [beat(seq=1)])
    world.hub.to_vehicles(command_to(1))
    await world.until(lambda: len(genuine.got) == 1)
    assert forger.got == []
    world.hub.close()
    forger.transport.close()
    genuine.transport.close()


@pytest.mark.parametrize(
    "url", ["", "udpin://", "udpin://1.2.3.4", "udpin://h:99999", "serial:///dev/none:57600", "tcpout://127.0.0.1:1"]
)
async def test_a_url_that_cannot_be_opened_is_named_with_the_rule(url: str) -> None:
    world = World()
    with pytest.raises(ConnectionFailed, match="cannot open"):
        await world.hub.connect(url)
    world.hub.close()


async def test_pymavlink_reads_the_log_of_an_upload(airfield: Open, line_and_hover: Plan, tmp_path: Path) -> None:
    file = tmp_path / "op-1.tlog"
    async with airfield(line_and_hover) as field:
        log = field.link.record(file)
        await field.link.upload({1: compile_mission(line_and_hover, "uav-1")})
        field.link.stop_recording(log)
    assert log.wait(10)
    reader = mavutil.mavlink_connection(str(file))
    read = []
    while (message := reader.recv_match()) is not None:
        read.append((message.get_type(), message.get_srcSystem()))
    assert ("MISSION_COUNT", 245) in read
    assert read.count(("MISSION_ITEM_INT", 245)) >= 10
    assert ("MISSION_ACK", 1) in read
    assert isinstance(log, TelemetryLog)
    reader.close()


@pytest.mark.e2e
async def test_a_vehicle_on_two_links_is_commanded_on_while_the_first_is_cut(
    airfield: Open, relay_to: Callable[[int], Any], line_and_hover: Plan, free_port: int
) -> None:
    async with (
        relay_to(free_port) as relay,
        airfield(line_and_hover, endpoint=f"udpout://127.0.0.1:{relay.port}", port=free_port, speedup=1.0) as field,
    ):
        vehicle = field.fleet.vehicles[1]
        port = vehicle.link.port if hasattr(vehicle.link, "port") else None
        direct = port or vehicle.link._transport.get_extra_info("sockname")[1]
        await field.link.connect(f"udpout://127.0.0.1:{direct}")
        await asyncio.sleep(1.5)
        relay.to_ground = relay.to_vehicle = lambda _datagram: []
        await asyncio.sleep(FRESH_S + 0.5)
        assert field.link._hub.links_of(1) == [f"udpout://127.0.0.1:{direct}"]
        (result,) = (await field.link.upload({1: compile_mission(line_and_hover, "uav-1")})).values()
        assert result.verified, result.error
