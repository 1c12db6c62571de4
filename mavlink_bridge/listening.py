"""The listening half of the fleet link: MAVSDK behind the hub, who is there, what they say, what happened to them."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncGenerator, Callable, Collection, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from mavsdk import ComponentType, Configuration, ForwardingOption, Mavsdk

from skyfolio.mavlink_bridge.autopilots import Autopilot, FlightMode
from skyfolio.mavlink_bridge.classifier import Classifier
from skyfolio.mavlink_bridge.conditions import Timing, VehicleChange
from skyfolio.mavlink_bridge.errors import ConnectionFailed, LinkClosed, VehiclesMissing
from skyfolio.mavlink_bridge.framing import Frame, is_foreign_heartbeat
from skyfolio.mavlink_bridge.heartbeat import AUTOPILOT, HeartbeatMonitor, LinkEvent
from skyfolio.mavlink_bridge.hub import Hub, LinkOptions
from skyfolio.mavlink_bridge.mavsdk_log import to_python_logging
from skyfolio.mavlink_bridge.mission_messages import GROUND
from skyfolio.mavlink_bridge.models import DEFAULTS
from skyfolio.mavlink_bridge.pace import VehicleModel
from skyfolio.mavlink_bridge.speeds import SpeedWatch
from skyfolio.mavlink_bridge.telemetry import Telemetry
from skyfolio.mavlink_bridge.tlog import TelemetryLog
from skyfolio.mavlink_bridge.vehicle import Clock, Vehicle

log = logging.getLogger(__name__)
Outcome = TypeVar("Outcome")

ANYBODY = frozenset(range(1, 255)) - {GROUND[0]}
"""System ids a vehicle may have: `expect` them where nobody knows beforehand who is there."""
POLL_S = 0.05
"""Wall seconds between looks at the monitor: detection is late by at most this, times the speed-up, in fleet time."""
STALL_S = 0.2
"""A look that is later than this was kept by a pause of our own: what arrived meanwhile is taken in before anyone is
judged, and silence does not count the pause (`HeartbeatMonitor.missed`)."""
DISCOVERY_S = 0.1
TRY_AGAIN_S = 0.1
MAX_THREADS = 2
"""Blocking calls at once: MAVSDK is only asked which systems it has seen."""


class ListeningLink:
    """One MAVSDK object, one pool of threads for its blocking calls, one classifier; `FleetLink` adds commands.

    `clock` tells fleet seconds and is read from MAVSDK's threads too. Time-outs named `timeout_s` are wall seconds.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        monitor: HeartbeatMonitor,
        options: LinkOptions | None = None,
        timing: Timing | None = None,
    ) -> None:
        self.monitor = monitor
        self.classifier = Classifier(timing, links=monitor)
        self.models: dict[int, VehicleModel] = {}
        """What `prepare` made of each vehicle's own parameters."""
        self.parameters: dict[int, dict[str, float]] = {}
        self.speeds = SpeedWatch(lambda system_id: self.model(system_id).cruise_mps)
        """Gives back their own speed to vehicles that leave our modes at one of ours."""
        self._options = options or LinkOptions()
        self._hub: Hub | None = None
        self._clock = clock
        self._mavsdk: Mavsdk | None = None
        self._closed = False
        self._pool = ThreadPoolExecutor(MAX_THREADS, thread_name_prefix="mavsdk")
        self._vehicles: dict[int, Vehicle] = {}
        self._awaited: set[int] = set()
        self._listeners: list[asyncio.Queue[VehicleChange | None]] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._awake = (0.0, 0.0)
        """When the event loop was last seen to run: its own seconds, and fleet seconds."""

    # -- life ---------------------------------------------------------------------------------------------------

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
        mavsdk, self._mavsdk = self._mavsdk, None
        if self._hub is not None:
            self._hub.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for queue in self._listeners:
            queue.put_nowait(None)
        if mavsdk is not None:
            await asyncio.to_thread(self._pool.shutdown)
            await asyncio.to_thread(mavsdk.destroy)
        self._vehicles.clear()

    async def connect(self, url: str, *, patience_s: float = 0.0) -> None:
        """Open a further link (see `endpoints`), such as `udpin://127.0.0.1:14540`; raises ConnectionFailed.

        A vehicle heard on several is spoken to on the first that works. Without `async with`, the first success begins
        the link and `close` ends it. patience_s: wall seconds in which whoever still has the port may let go of it.
        """
        entered, until = self._mavsdk is not None, time.monotonic() + patience_s
        while True:
            try:
                return await self._begin().connect(url)
            except ConnectionFailed:
                if time.monotonic() < until:
                    await asyncio.sleep(TRY_AGAIN_S)
                    continue
                if not entered:
                    await self.close()
                raise

    def expect(self, system_ids: Collection[int]) -> None:
        """Listen to these vehicles from now on: what others send costs nothing and is not kept."""
        self._awaited |= set(system_ids)

    async def wait_for(self, system_ids: Collection[int], timeout_s: float) -> None:
        """Wait until the autopilot of each was heard, and watch its heartbeats from then on.

        Raises VehiclesMissing naming who never answered within `timeout_s` wall seconds, and who did.
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

    # -- hearing ------------------------------------------------------------------------------------------------

    @property
    def heard_systems(self) -> frozenset[int]:
        """System ids of expected vehicles whose autopilot has sent a heartbeat since the link was opened."""
        return frozenset(system_id for system_id, vehicle in self._vehicles.items() if vehicle.heard)

    def telemetry(self, system_id: int) -> Telemetry | None:
        """Latest snapshot of one autopilot (component 1), however old: see `heard_at_s`. None before the first."""
        vehicle = self._vehicles.get(system_id)
        return None if vehicle is None else vehicle.state.snapshot()

    def home_deg(self, system_id: int) -> tuple[float, float] | None:
        """Latitude and longitude of the home it told of, degrees; None before that."""
        vehicle = self._vehicles.get(system_id)
        return None if vehicle is None else vehicle.state.home_deg

    def changes(self) -> AsyncGenerator[VehicleChange, None]:
        """Iterate over what changes of links and conditions from this call on, until the link closes.

        Each caller gets every change.
        """
        self._open()
        queue: asyncio.Queue[VehicleChange | None] = asyncio.Queue()
        self._listeners.append(queue)
        return _drain(queue, self._listeners)

    def vehicle(self, system_id: int) -> Vehicle:
        """One vehicle, for `guidance`. Raises KeyError if it was never heard."""
        return self._vehicles[system_id]

    def autopilot(self, system_id: int) -> Autopilot:
        """Which autopilot a vehicle has; PX4 until it was heard."""
        vehicle = self._vehicles.get(system_id)
        return (vehicle.state.autopilot if vehicle is not None else None) or Autopilot.PX4

    def model(self, system_id: int) -> VehicleModel:
        """How a vehicle flies: from its parameters if `prepare` read them, else its autopilot's defaults."""
        return self.models.get(system_id) or DEFAULTS[self.autopilot(system_id)]

    def record(self, path: Path, on_failure: Callable[[str], None] = lambda _reason: None) -> TelemetryLog:
        """Append all traffic to a .tlog until `stop_recording`; why it cannot goes to `on_failure`, on the loop."""
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

    # -- inside -------------------------------------------------------------------------------------------------

    def _begin(self) -> Hub:
        """MAVSDK behind the hub, made on first use; a closed link stays closed."""
        if self._mavsdk is None and not self._closed:
            to_python_logging()
            loop = asyncio.get_running_loop()
            mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            mavsdk.add_any_connection_with_handle_and_forwarding("raw://", ForwardingOption.OFF)
            self._hub = Hub(
                self._options,
                to_mavsdk=mavsdk.pass_received_raw_bytes,
                on_heard=self._frame_heard,
                is_wanted=self._awaited.__contains__,
            )
            mavsdk.subscribe_raw_bytes_to_be_sent(self._hub.to_vehicles)
            mavsdk.subscribe_on_new_system(lambda _user_data: loop.call_soon_threadsafe(self._look_around))
            self._mavsdk = mavsdk
            self._spawn(self._watch())
        self._open()
        assert self._hub is not None  # noqa: S101
        return self._hub

    def _open(self) -> Mavsdk:
        if self._mavsdk is None:
            raise LinkClosed(
                "the fleet link is closed" if self._closed else "the fleet link was not opened: connect it first"
            )
        return self._mavsdk

    async def _call(self, blocking: Callable[..., Outcome], *arguments: Any) -> Outcome:
        return await asyncio.get_running_loop().run_in_executor(self._pool, blocking, *arguments)

    def _look_around(self) -> None:
        if self._mavsdk is not None:
            self._spawn(self._discover())

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _discover(self) -> None:
        systems = await self._call(self._open().get_systems)
        for system in systems:
            system_id = int(system.get_system_id())
            if system_id not in self._vehicles:
                vehicle = self._vehicles[system_id] = Vehicle(
                    system,
                    clock=self._clock,
                    loop=asyncio.get_running_loop(),
                    on_message=self._message,
                )
                vehicle.announce = partial(self._announce, system_id)

    def _announce(self, system_id: int, mode: FlightMode, going_on: bool) -> None:
        """A mode is expected while its command goes on, and for a while after."""
        self.classifier.expect(system_id, frozenset({mode}), self._clock.now(), inf if going_on else None)

    def _frame_heard(self, frame: Frame) -> None:
        """Whatever component 1 sends shows that autopilot and link are alive, unless it is no autopilot's HEARTBEAT."""
        self._note_pause()
        if not is_foreign_heartbeat(frame):
            self.classifier.alive(frame.system_id, frame.component_id, self._clock.now())

    def _message(self, vehicle: Vehicle, name: str, fields: dict[str, Any], heard_s: float) -> None:
        self._note_pause()
        if name == "HEARTBEAT" and vehicle.heard and vehicle.system_id in self._awaited:
            self.classifier.watch(vehicle.system_id, heard_s)
        self.classifier.hear(vehicle.system_id, AUTOPILOT, name, fields, heard_s)
        if name == "HEARTBEAT":
            self.speeds.look(vehicle)

    def _note_pause(self) -> None:
        """Tell the classifier if we could not listen until now, before it takes in what waited meanwhile."""
        woke_s, woke_at_s = self._awake
        self._awake = awake_s, now_s = asyncio.get_running_loop().time(), self._clock.now()
        late_s = awake_s - woke_s - POLL_S
        if late_s > STALL_S:
            self.classifier.missed(now_s, (now_s - woke_at_s) * late_s / (late_s + POLL_S))
            log.warning("did not listen for %.2f s: stopped, or the event loop was blocked", late_s)

    async def _watch(self) -> None:
        """Ask the monitor, forever; after a pause of our own, first take in what arrived meanwhile, once."""
        loop, looked = asyncio.get_running_loop(), True
        self._awake = loop.time(), self._clock.now()
        while True:
            asked_s = loop.time()
            await asyncio.sleep(POLL_S)
            self._note_pause()
            paused = loop.time() - asked_s > POLL_S + STALL_S
            looked = not (paused and looked)
            if looked:
                self._look()

    def _look(self) -> None:
        """Send everybody who listens what has changed, once for each vehicle."""
        conditions = {change.system_id: change for change in self.classifier.poll(self._clock.now())}
        links: dict[int, list[LinkEvent]] = {}
        for event in self.classifier.link_events:
            links.setdefault(event.system_id, []).append(event)
        for system_id in dict.fromkeys((*links, *conditions)):
            change = VehicleChange(
                system_id=system_id, link=tuple(links.get(system_id, ())), condition=conditions.get(system_id)
            )
            for queue in self._listeners:
                queue.put_nowait(change)


async def _drain(
    queue: asyncio.Queue[VehicleChange | None], listeners: list[asyncio.Queue[VehicleChange | None]]
) -> AsyncGenerator[VehicleChange, None]:
    try:
        while (change := await queue.get()) is not None:
            yield change
    finally:
        listeners.remove(queue)
