"""The listening half of the fleet link: the port (MAVSDK) behind the hub, the vehicles, and what happened to them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Callable, Collection, Coroutine, Sequence
from contextlib import suppress
from functools import partial
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode
from skyfolio.mavlink_bridge.broadcast import Broadcast
from skyfolio.mavlink_bridge.classifier import Classifier
from skyfolio.mavlink_bridge.conditions import Timing, VehicleChange, changes_by_vehicle
from skyfolio.mavlink_bridge.errors import ConnectionFailed, LinkClosed, VehiclesMissing
from skyfolio.mavlink_bridge.framing import Frame, is_foreign_heartbeat
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT, HeartbeatMonitor
from skyfolio.mavlink_bridge.hub import Hub, LinkOptions
from skyfolio.mavlink_bridge.message_port import MessagePort
from skyfolio.mavlink_bridge.mission_messages import GROUND
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.pauses import PauseWatch
from skyfolio.mavlink_bridge.ports import LinkPorts
from skyfolio.mavlink_bridge.power_log import PowerSample
from skyfolio.mavlink_bridge.profile import AutopilotProfile
from skyfolio.mavlink_bridge.profiles import unknown_autopilot
from skyfolio.mavlink_bridge.speeds import SpeedWatch
from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.mavlink_bridge.tlog import TelemetryLog
from skyfolio.mavlink_bridge.vehicle import Clock, Vehicle

log = logging.getLogger(__name__)

ANYBODY = frozenset(range(1, 255)) - {GROUND[0]}
"""The system ids a vehicle may have: `expect` them if it is not known beforehand which are there."""
DISCOVERY_S = 0.1
TRY_AGAIN_S = 0.1


class ListeningLink:
    """One port to all vehicles, one classifier; `FleetLink` adds commands.

    `clock` returns fleet seconds and is read from MAVSDK's threads too. Time-outs named `timeout_s` are wall seconds.
    ports: what the link is made of.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        monitor: HeartbeatMonitor,
        options: LinkOptions | None = None,
        timing: Timing | None = None,
        ports: LinkPorts | None = None,
    ) -> None:
        self.monitor = monitor
        self.classifier = Classifier(timing, links=monitor)
        self.models: dict[int, VehicleModel] = {}
        """The models that `prepare` made of each vehicle's own parameters."""
        self.parameters: dict[int, dict[str, float]] = {}
        self.speeds = SpeedWatch(lambda system_id: self.model(system_id).cruise_mps)
        """Restores the own speed of vehicles that leave our modes at a speed ordered by the service."""
        self._options, self._ports = options or LinkOptions(), ports or LinkPorts()
        self._hub: Hub | None = None
        self._clock = clock
        self._port: MessagePort | None = None
        self._closed = False
        self._vehicles: dict[int, Vehicle] = {}
        self._awaited: set[int] = set()
        self._changes: Broadcast[VehicleChange] = Broadcast()
        self._tasks: set[asyncio.Task[None]] = set()
        self._pauses = PauseWatch(clock.now, self.classifier.missed)

    async def __aenter__(self) -> Self:
        self._begin()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """End all waiting, let running MAVSDK calls time out, and free the ports. Ends every `changes` iterator."""
        self._closed = True
        await self.speeds.close()
        port, self._port = self._port, None
        if self._hub is not None:
            self._hub.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._changes.close()
        if port is not None:
            await port.close()
        self._vehicles.clear()

    async def connect(self, url: str, *, patience_s: float = 0.0) -> None:
        """Open a further link (see `endpoints`), such as `udpin://127.0.0.1:14540`. Raises ConnectionFailed.

        A vehicle heard on several links is commanded on the first that works. Without `async with`, the first success
        begins the link and `close` ends it. patience_s: wall seconds in which another process that still has the port
        may free it.
        """
        loop = asyncio.get_running_loop()
        entered, until = self._port is not None, loop.time() + patience_s
        while True:
            try:
                return await self._begin().connect(url)
            except ConnectionFailed:
                if loop.time() < until:
                    await asyncio.sleep(TRY_AGAIN_S)
                    continue
                if not entered:
                    await self.close()
                raise

    def expect(self, system_ids: Collection[int]) -> None:
        """Listen to these vehicles from now on: frames of others are dropped."""
        self._awaited |= set(system_ids)

    async def wait_for(self, system_ids: Collection[int], timeout_s: float) -> None:
        """Wait until the autopilot of each was heard, and watch its heartbeats from then on.

        Raises VehiclesMissing naming those that were not heard within `timeout_s` wall seconds, and those that were.
        """
        self._open()
        self.expect(system_ids)
        for system_id in self.heard_systems & self._awaited:
            self.classifier.watch(system_id, self._clock.now())
        try:
            async with asyncio.timeout(timeout_s):
                while not self.heard_systems >= set(system_ids):
                    await self._discover()
                    await asyncio.sleep(DISCOVERY_S)
        except TimeoutError:
            heard = self.heard_systems
            raise VehiclesMissing(set(system_ids) - heard, heard, timeout_s) from None

    @property
    def heard_systems(self) -> frozenset[int]:
        """Return the system ids of expected vehicles whose autopilot has sent a heartbeat on this link."""
        return frozenset(system_id for system_id, vehicle in self._vehicles.items() if vehicle.heard)

    def is_heard(self, system_id: int) -> bool:
        """Return whether the autopilot of an expected vehicle was heard, and its link is not lost."""
        vehicle = self._vehicles.get(system_id)
        return vehicle is not None and vehicle.heard and self.monitor.is_up(system_id)

    def telemetry(self, system_id: int) -> Telemetry | None:
        """Return the latest snapshot of one autopilot (component 1), however old: see `heard_at_s`.

        None before the first.
        """
        vehicle = self._vehicles.get(system_id)
        return None if vehicle is None else vehicle.state.snapshot()

    def power_samples(self, system_id: int) -> Sequence[PowerSample]:
        """Return what a vehicle has reported of its power and velocity in flight, oldest first."""
        vehicle = self._vehicles.get(system_id)
        return () if vehicle is None else tuple(vehicle.state.power.samples)

    def home_deg(self, system_id: int) -> tuple[float, float] | None:
        """Return latitude and longitude of the home it has reported, degrees; None before that."""
        vehicle = self._vehicles.get(system_id)
        return None if vehicle is None else vehicle.state.home_deg

    def changes(self) -> AsyncGenerator[VehicleChange, None]:
        """Return what changes of links and conditions from this call on, until the link closes.

        Each caller gets every change.
        """
        self._open()
        return self._changes.listen()

    def vehicle(self, system_id: int) -> Vehicle:
        """Return one vehicle, for `guidance`. Raises KeyError if it was never heard."""
        return self._vehicles[system_id]

    def autopilot(self, system_id: int) -> Autopilot:
        """Return which autopilot a vehicle has. Raises UnknownAutopilot, naming it, as `profile` does."""
        return self.profile(system_id).autopilot

    def profile(self, system_id: int) -> AutopilotProfile:
        """Return the profile of a vehicle's autopilot.

        Raises UnknownAutopilot for an autopilot that has none, and for a vehicle that was never heard.
        """
        vehicle = self._vehicles.get(system_id)
        if vehicle is None or vehicle.state.profile is None:
            raise unknown_autopilot(None if vehicle is None else vehicle.state.mav_autopilot)
        return vehicle.state.profile

    def is_ours(self, system_id: int) -> bool:
        """Return whether a vehicle was last seen in a mode in which the service may command it."""
        vehicle = self._vehicles.get(system_id)
        return vehicle is not None and vehicle.state.is_ours

    def model(self, system_id: int) -> VehicleModel:
        """Return how a vehicle flies: from its parameters if `prepare` has read them, else its autopilot's defaults.

        Raises UnknownAutopilot.
        """
        return self.models.get(system_id) or self.profile(system_id).default_model

    def record(self, path: Path, on_failure: Callable[[str], None] = lambda _reason: None) -> TelemetryLog:
        """Append all traffic to a .tlog until `stop_recording`; `on_failure` gets, on the loop, why it cannot."""
        loop = asyncio.get_running_loop()

        def failed(reason: str) -> None:
            with suppress(RuntimeError):  # the loop has ended: there is nobody to tell
                loop.call_soon_threadsafe(on_failure, reason)

        log = TelemetryLog(path, on_failure=failed)
        self._begin().record(log)
        return log

    def stop_recording(self, log: TelemetryLog) -> None:
        """End a log that `record` began."""
        if self._hub is not None:
            self._hub.stop_recording(log)

    def _begin(self) -> Hub:
        """Return the hub, with the port behind it; both are made on first use. Raises LinkClosed after `close`."""
        if self._port is None and not self._closed:
            self._hub = hub = Hub(
                self._options,
                to_mavsdk=lambda data: self._open().take_in(data),
                on_heard=self._frame_heard,
                is_wanted=self._awaited.__contains__,
                endpoint=self._ports.endpoint,
            )
            self._port = self._ports.messages(self._clock.now, hub.to_vehicles, self._look_around)
            self._spawn(self._pauses.run(self._look))
        self._open()
        assert self._hub is not None  # noqa: S101
        return self._hub

    def _open(self) -> MessagePort:
        if self._port is None:
            never = "the fleet link was not opened: connect it first"
            raise LinkClosed("the fleet link is closed" if self._closed else never)
        return self._port

    def _look_around(self) -> None:
        if self._port is not None:
            self._spawn(self._discover())

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _discover(self) -> None:
        port = self._open()
        for system_id in await port.systems():
            if system_id not in self._vehicles:
                loop = asyncio.get_running_loop()
                vehicle = Vehicle(system_id, port=port, loop=loop, on_message=self._message)
                self._vehicles[system_id] = vehicle
                vehicle.announce = partial(self._announce, system_id)

    def _announce(self, system_id: int, mode: FlightMode, going_on: bool) -> None:
        """Expect a mode while its command goes on, and for a while after."""
        self.classifier.expect(system_id, frozenset({mode}), self._clock.now(), inf if going_on else None)

    def _frame_heard(self, frame: Frame) -> None:
        """Take in a frame: all but a foreign HEARTBEAT shows that its sender and the link are alive."""
        self._pauses.note()
        if not is_foreign_heartbeat(frame):
            self.classifier.alive(frame.system_id, frame.component_id, self._clock.now())

    def _message(self, vehicle: Vehicle, name: str, fields: dict[str, Any], heard_s: float) -> None:
        self._pauses.note()
        if name == "HEARTBEAT" and vehicle.heard and vehicle.system_id in self._awaited:
            self.classifier.watch(vehicle.system_id, heard_s)
        self.classifier.hear(vehicle.system_id, AUTOPILOT, name, fields, heard_s)
        if name == "HEARTBEAT":
            self.speeds.look(vehicle)

    def _look(self) -> None:
        """Send everybody who listens what has changed, once for each vehicle."""
        conditions = self.classifier.poll(self._clock.now())
        for change in changes_by_vehicle(self.classifier.link_events, conditions):
            self._changes.send(change)
