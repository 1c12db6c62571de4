"""The autopilots that somebody has running, a service that flies them, and another ground station beside it.

SITL_URL: where they are, as `--fleet-url` takes it: several by commas. SITL_SYSTEM_IDS: whom to fly (default: whoever
is heard). SITL_PIDS: processes of autopilots, by system id: `1=4711,2=4712`; needed to stop and kill them.
"""

from __future__ import annotations

import asyncio
import os
import queue
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.api.client import Client
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.flights.operation_views import ENDED, OperationView, State
from skyfolio.mavlink_bridge import Autopilot, FleetLink, HeartbeatMonitor, geodetic_to_east_north
from skyfolio.mavlink_bridge.listening import ANYBODY
from skyfolio.planner import Origin, Scenario
from skyfolio.planner.scenario import Uav, User
from tests.ports import free_port

URLS = tuple(url.strip() for url in os.environ.get("SITL_URL", "").split(",") if url.strip())
SYSTEMS = tuple(int(one) for one in os.environ.get("SITL_SYSTEM_IDS", "").split(",") if one.strip())
PIDS = {
    int(system): int(pid)
    for system, _, pid in (one.partition("=") for one in os.environ.get("SITL_PIDS", "").split(",") if one.strip())
}
MARKS = [
    pytest.mark.skipif(not URLS, reason="SITL_URL is not set: no autopilot to fly"),
    pytest.mark.timeout(900),
    pytest.mark.filterwarnings("default"),
]
SLOTS, SLOT_S, SPEED_MPS, ALTITUDE_M, AWAY_M = 12, 5.0, 4.0, 15.0, 35.0
HEARD_WITHIN_S, READY_WITHIN_S, MORE_WITHIN_S = 60.0, 300.0, 2.0
OTHER_STATION = 250
INJECT_FAILURE, FAILURE_OK, FAILURE_OFF = 420, 0.0, 1.0
"""MAV_CMD_INJECT_FAILURE and two FAILURE_TYPEs."""
INT_TYPES = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
"""MAV_PARAM_TYPE as PX4 packs them into the float of PARAM_SET."""


@dataclass(frozen=True)
class Standing:
    """One vehicle on the ground, or in the air."""

    system_id: int
    autopilot: Autopilot
    at_deg: tuple[float, float]
    armed: bool

    @property
    def uav(self) -> str:
        """Its id in plans."""
        return f"uav-{self.system_id}"


def survey() -> list[Standing]:
    """Who is there and where; each is waited for until it knows its place."""
    return asyncio.run(_survey())


async def _survey() -> list[Standing]:
    async with FleetLink(clock=FleetClock(), monitor=HeartbeatMonitor()) as link:
        for url in URLS:
            await link.connect(url)
        if SYSTEMS:
            await link.wait_for(SYSTEMS, timeout_s=HEARD_WITHIN_S)
        else:
            link.expect(ANYBODY)
        async with asyncio.timeout(HEARD_WITHIN_S):
            while len(link.heard_systems) < len(URLS):  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        await asyncio.sleep(MORE_WITHIN_S)
        systems = SYSTEMS or tuple(sorted(link.heard_systems))
        await link.prepare(systems)
        missing = {
            system: facts for system, facts in (await link.wait_for_facts(systems)).items() if "position" in facts
        }
        assert not missing, f"no position of {missing}"
        found = []
        for system in systems:
            said = link.telemetry(system)
            assert said is not None
            assert said.place_deg is not None, missing
            found.append(Standing(system, link.autopilot(system), said.place_deg, said.armed))
        return found


def scenario_of(vehicles: list[Standing]) -> Scenario:
    """A short flight that takes each vehicle some way from where it stands: users stand to the north of them."""
    origin = Origin(lat_deg=vehicles[0].at_deg[0], lon_deg=vehicles[0].at_deg[1])
    starts = [geodetic_to_east_north(origin, *one.at_deg) for one in vehicles]
    users = [(east + side, north + AWAY_M) for east, north in starts for side in (-8.0, 8.0)]
    points = [*starts, *users]
    return Scenario(
        origin=origin,
        area_m=(
            (min(east for east, _ in points) - 60.0, min(north for _, north in points) - 60.0),
            (max(east for east, _ in points) + 60.0, max(north for _, north in points) + 60.0),
        ),
        slots=SLOTS,
        slot_duration_s=SLOT_S,
        altitude_m=ALTITUDE_M,
        min_separation_m=3.0,
        uavs=tuple(
            Uav(id=one.uav, start_m=start, max_speed_mps=SPEED_MPS) for one, start in zip(vehicles, starts, strict=True)
        ),
        users=tuple(User(id=f"user-{n}", position_m=at) for n, at in enumerate(users, 1)),
    )


class Station:
    """Another ground station, which speaks to the fleet through the service's forward port, with an id of its own."""

    def __init__(self, port: int) -> None:
        self._link: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=OTHER_STATION)
        self._heard: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._over = threading.Event()
        self._listening = threading.Thread(target=self._listen)
        self._listening.start()

    def close(self) -> None:
        """Let go of the port."""
        self._over.set()
        self._listening.join()
        self._link.close()

    def _listen(self) -> None:
        """Take in everything at once: what waits in the socket would be old when it is asked for."""
        while not self._over.is_set():
            message = self._link.recv_match(blocking=True, timeout=0.2)
            if message is not None:
                self._heard.put(message)

    def forget(self) -> None:
        """What was heard until now answers nothing that is asked from now on."""
        while not self._heard.empty():
            self._heard.get()

    def hear(self, kind: str, system: int, within_s: float, is_so: Callable[[Any], bool] = lambda _: True) -> Any:
        """The next message of that kind from one autopilot, None if there is none in time."""
        until_s = time.monotonic() + within_s
        while (left_s := until_s - time.monotonic()) > 0:
            try:
                message = self._heard.get(timeout=left_s)
            except queue.Empty:
                return None
            sender = message.get_srcSystem(), message.get_srcComponent()
            if message.get_type() == kind and sender == (system, 1) and is_so(message):
                return message
        return None

    def command(self, system: int, number: int, *params: float) -> int | None:
        """The result (MAV_RESULT) of a command, None if there is no answer."""
        self.forget()
        for _ in range(3):
            self._link.mav.command_long_send(system, 1, number, 0, *params, *[0.0] * (7 - len(params)))
            answer = self.hear("COMMAND_ACK", system, 1.5, lambda ack: ack.command == number)
            if answer is not None:
                return int(answer.result)
        return None

    def mode(self, vehicle: Standing, px4: tuple[int, int], ardupilot: int) -> None:
        """Put it into a mode, as its pilot's station would."""
        main, sub = px4 if vehicle.autopilot is Autopilot.PX4 else (ardupilot, 0)
        assert self.command(vehicle.system_id, dialect.MAV_CMD_DO_SET_MODE, 1, main, sub) == 0

    def hold(self, vehicle: Standing) -> None:
        """HOLD on PX4, LOITER on ArduCopter."""
        self.mode(vehicle, (4, 3), 5)

    def return_home(self, vehicle: Standing) -> None:
        """RETURN, RTL."""
        self.mode(vehicle, (4, 5), 6)

    def land(self, vehicle: Standing) -> None:
        """LAND where it is."""
        self.mode(vehicle, (4, 6), 9)

    def parameter(self, system: int, name: str) -> Any:
        """The PARAM_VALUE of that name, None if the vehicle does not know it."""
        self.forget()
        for _ in range(3):
            self._link.mav.param_request_read_send(system, 1, name.encode(), -1)
            told = self.hear("PARAM_VALUE", system, 1.0, lambda value: value.param_id == name)
            if told is not None:
                return told
        return None

    def set_parameter(self, vehicle: Standing, name: str, value: float) -> float | None:
        """Set it; the raw value before, None if the vehicle does not know it."""
        before = self.parameter(vehicle.system_id, name)
        if before is None:
            return None
        packing = INT_TYPES.get(before.param_type) if vehicle.autopilot is Autopilot.PX4 else None
        raw = value if packing is None else struct.unpack("<f", struct.pack(packing, int(value)).ljust(4, b"\0"))[0]
        self.set_raw(vehicle, name, raw, before.param_type)
        return float(before.param_value)

    def set_raw(self, vehicle: Standing, name: str, raw: float, kind: int) -> None:
        """Set it as it is on the wire."""
        self.forget()
        for _ in range(3):
            self._link.mav.param_set_send(vehicle.system_id, 1, name.encode(), raw, kind)
            if self.hear("PARAM_VALUE", vehicle.system_id, 1.0, lambda told: told.param_id == name) is not None:
                return
        raise AssertionError(f"system {vehicle.system_id} does not take {name}")


@dataclass
class Field:
    """The fleet and the service that flies it; `start` and `kill` let the service come and go."""

    folder: Path
    vehicles: list[Standing]
    scenario: Scenario = field(init=False)
    process: subprocess.Popen[bytes] | None = None
    changed: list[tuple[Standing, str, float, int]] = field(default_factory=list)
    failed: list[tuple[Standing, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.scenario = scenario_of(self.vehicles)
        self._port, self._forward = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
        self.client = Client(f"http://127.0.0.1:{self._port}", timeout_s=150.0)
        self.station = Station(self._forward)

    def start(self) -> None:
        """A service on the same database as before, once it is ready."""
        environment = {
            **os.environ,
            "SKYFOLIO_FORWARD_URL": f"udpout://127.0.0.1:{self._forward}",
            "SKYFOLIO_FORWARD_COMMANDS": "true",
            "SKYFOLIO_TELEMETRY_LOG_DIR": str(self.folder),
        }
        command = [
            *(sys.executable, "-m", "skyfolio", "serve", "--no-ui", "--port", str(self._port)),
            *("--fleet-url", ",".join(URLS), "--database-url", f"sqlite+aiosqlite:///{self.folder}/service.db"),
        ]
        with (self.folder / "service.log").open("ab") as log:
            self.process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        until_s = time.monotonic() + READY_WITHIN_S
        while time.monotonic() < until_s:
            assert self.process.poll() is None, (self.folder / "service.log").read_text()[-2000:]
            with suppress(httpx2.TransportError):
                if httpx2.get(f"http://127.0.0.1:{self._port}/ready").status_code == 200:
                    return
            time.sleep(0.2)
        raise AssertionError("the service is not ready")

    def signal(self, number: signal.Signals) -> None:
        """Send the service a signal."""
        assert self.process is not None
        self.process.send_signal(number)

    def take_off(self, **order: Any) -> str:
        """Plan, register, fly; the operation's id once slot 0 has begun."""
        plan = self.client.plan(self.scenario)
        for one in self.vehicles:
            self.client.register(one.uav, one.system_id)
        operation = self.client.fly(plan.id, **order)
        self.until(operation.id, lambda view: view.state is State.FLYING, 240.0)
        return operation.id

    def until(self, operation_id: str, is_so: Callable[[OperationView], object], limit_s: float) -> OperationView:
        """The operation once it is so; fails when it ended before, or after wall seconds."""
        until_s = time.monotonic() + limit_s
        while time.monotonic() < until_s:
            view = self.client.operation(operation_id)
            if is_so(view):
                return view
            assert view.state not in ENDED, (view.state, view.error)
            time.sleep(0.1)
        raise AssertionError(f"not so after {limit_s:g} s: {view}")

    def at_slot(self, operation_id: str, slot: int) -> None:
        """Wait until that slot lasts."""
        self.until(operation_id, lambda view: view.slot is not None and view.slot >= slot, 300.0)

    def ended(self, operation_id: str) -> OperationView:
        """The operation once it is over."""
        return self.until(operation_id, lambda view: view.state in ENDED, 420.0)

    def events(self, kind: str) -> list[dict[str, Any]]:
        """What was told of that kind."""
        return [event.data for event in self.client.events(0, follow=False) if event.kind == kind]

    def figures(self) -> None:
        """Print how far from the plan every vehicle was when slots began: with `-s` for the record."""
        for one in self.vehicles:
            slips = [event["distance_m"] for event in self.events("slip") if event["uav_id"] == one.uav]
            if slips:
                print(f"{one.uav}: mean {sum(slips) / len(slips):.1f} m, worst {max(slips):.1f} m")  # noqa: T201

    def set(self, vehicle: Standing, name: str, value: float) -> bool:
        """Set a parameter until the test ends; whether the vehicle knows it."""
        told = self.station.parameter(vehicle.system_id, name)
        if told is None or self.station.set_parameter(vehicle, name, value) is None:
            return False
        self.changed.append((vehicle, name, float(told.param_value), int(told.param_type)))
        return True

    def fail(self, vehicle: Standing, unit: float) -> bool:
        """Let a part of a PX4 fail until the test ends (MAV_CMD_INJECT_FAILURE); whether it accepts that."""
        if not self.set(vehicle, "SYS_FAILURE_EN", 1):
            return False
        self.failed.append((vehicle, unit))
        return self.station.command(vehicle.system_id, INJECT_FAILURE, unit, FAILURE_OFF, 0) == 0

    def clear_up(self) -> None:
        """Parts and parameters as they were, everybody on the ground, no service."""
        try:
            for vehicle, unit in self.failed:
                self.station.command(vehicle.system_id, INJECT_FAILURE, unit, FAILURE_OK, 0)
            for vehicle, name, raw, kind in reversed(self.changed):
                self.station.set_raw(vehicle, name, raw, kind)
            for row in self.client.operations():
                if row.ended_at is None:
                    self.client.command(row.id, "abort", action="land")
            for one in self.vehicles:
                self.station.forget()
                beat = self.station.hear("HEARTBEAT", one.system_id, 3.0)
                if beat is not None and beat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED:
                    self.station.land(one)
                    self.station.hear("HEARTBEAT", one.system_id, 150.0, lambda beat: not beat.base_mode & 128)
        finally:
            self.station.close()
            self.client.close()
            if self.process is not None and self.process.poll() is None:
                self.process.terminate()
                self.process.wait(30)


@contextmanager
def field_of(folder: Path) -> Iterator[Field]:
    """The fleet as it stands now, and a service."""
    made = Field(folder, survey())
    try:
        made.start()
        yield made
        made.figures()
    finally:
        made.clear_up()
