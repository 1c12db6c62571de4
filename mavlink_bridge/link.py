"""The link to the whole fleet: one MAVSDK object, one pool of threads for its blocking calls, one heartbeat monitor."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Collection, Coroutine, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from mavsdk import ComponentType, Configuration, ForwardingOption, Mavsdk

from mavlink_bridge import flight
from mavlink_bridge.autopilots import Autopilot, FlightMode
from mavlink_bridge.classifier import Change, Classifier
from mavlink_bridge.errors import ConnectionFailed, LinkClosed, VehiclesMissing
from mavlink_bridge.framing import Frame
from mavlink_bridge.geodesy import geodetic_to_east_north
from mavlink_bridge.heartbeat import AUTOPILOT, HeartbeatMonitor, LinkEvent, LinkState
from mavlink_bridge.hub import Hub, LinkOptions
from mavlink_bridge.items import MAX_ITEMS, Mission, MissionItem
from mavlink_bridge.mavsdk_log import to_python_logging
from mavlink_bridge.mission_protocol import MissionType
from mavlink_bridge.models import DEFAULTS, model_from_parameters
from mavlink_bridge.pace import VehicleModel
from mavlink_bridge.preflight import Facts, Needs, parameter_names
from mavlink_bridge.results import CommandResult, SwapResult, UploadResult
from mavlink_bridge.telemetry import Telemetry
from mavlink_bridge.tlog import TelemetryLog
from mavlink_bridge.transfer import ATTEMPTS, read_parameters, upload_items, upload_verified
from mavlink_bridge.vehicle import Clock, Vehicle
from planner.plans import Plan

Outcome = TypeVar("Outcome")
Request = TypeVar("Request")
Event = TypeVar("Event")

POLL_S = 0.05
"""Wall seconds between looks at the monitor: detection is late by at most this, times the speed-up, in fleet time."""
STALL_S = 0.2
"""When the event loop itself was stuck for longer, what arrived meanwhile is taken in before anyone is suspected."""
DISCOVERY_S = 0.1
MAX_THREADS = 64
"""Blocking calls at once: one a vehicle, and threads that wait cost next to nothing."""


class FleetLink:
    """All vehicles behind one or more connections.

        async with FleetLink(clock=clock, monitor=HeartbeatMonitor()) as link:
            await link.connect("udpin://127.0.0.1:14540")
            await link.wait_for({1, 2, 3}, timeout_s=10)
            await link.upload(missions)

    `clock` tells fleet seconds and is read from MAVSDK's threads too. Time-outs named `timeout_s` are wall seconds.
    Methods that address vehicles ask all of them at once and return one result for each; none stops the others.
    A system id nobody has heard on the link gets a result that says so.
    """

    def __init__(self, *, clock: Clock, monitor: HeartbeatMonitor, options: LinkOptions | None = None) -> None:
        self.monitor = monitor
        self.classifier = Classifier(links=monitor)
        self.models: dict[int, VehicleModel] = {}
        """What `prepare` made of each vehicle's own parameters."""
        self.parameters: dict[int, dict[str, float]] = {}
        self._options = options or LinkOptions()
        self._hub: Hub | None = None
        self._clock = clock
        self._mavsdk: Mavsdk | None = None
        self._closed = False
        self._pool = ThreadPoolExecutor(MAX_THREADS, thread_name_prefix="mavsdk")
        self._vehicles: dict[int, Vehicle] = {}
        self._awaited: set[int] = set()
        self._listeners: list[asyncio.Queue[LinkEvent | None]] = []
        self._change_listeners: list[asyncio.Queue[Change | None]] = []
        self._tasks: set[asyncio.Task[None]] = set()

    # -- life ---------------------------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        self._begin()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """End all waiting, let running MAVSDK calls time out, and free the ports. Ends every `events` iterator."""
        self._closed = True
        mavsdk, self._mavsdk = self._mavsdk, None
        if self._hub is not None:
            self._hub.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for queue in self._listeners:
            queue.put_nowait(None)
        for listener in self._change_listeners:
            listener.put_nowait(None)
        if mavsdk is not None:
            await asyncio.to_thread(self._pool.shutdown)
            await asyncio.to_thread(mavsdk.destroy)
        self._vehicles.clear()

    async def connect(self, url: str) -> None:
        """Open a further link (see `endpoints`), such as `udpin://127.0.0.1:14540`; raises ConnectionFailed.

        A vehicle heard on several is spoken to on the first that works. Without `async with`, the first success begins
        the link and `close` ends it.
        """
        entered = self._mavsdk is not None
        try:
            await self._begin().connect(url)
        except ConnectionFailed:
            if not entered:
                await self.close()
            raise

    async def wait_for(self, system_ids: Collection[int], timeout_s: float) -> None:
        """Wait until the autopilot of each was heard, and watch its heartbeats from then on.

        Raises VehiclesMissing naming who never answered within `timeout_s` wall seconds, and who did.
        """
        self._open()
        self._awaited |= set(system_ids)
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
        """System ids whose autopilot has sent a heartbeat since the link was opened."""
        return frozenset(system_id for system_id, vehicle in self._vehicles.items() if vehicle.heard)

    def telemetry(self, system_id: int) -> Telemetry | None:
        """Latest snapshot of one autopilot (component 1), however old: see `heard_at_s`. None before the first."""
        vehicle = self._vehicles.get(system_id)
        return None if vehicle is None else vehicle.state.snapshot()

    def events(self) -> AsyncGenerator[LinkEvent, None]:
        """Changes of link state from this call on, until the link closes. Each caller gets all of them."""
        self._open()
        queue: asyncio.Queue[LinkEvent | None] = asyncio.Queue()
        self._listeners.append(queue)
        return _drain(queue, self._listeners)

    def changes(self) -> AsyncGenerator[Change, None]:
        """Changes of condition from this call on, until the link closes. Each caller gets all of them."""
        self._open()
        queue: asyncio.Queue[Change | None] = asyncio.Queue()
        self._change_listeners.append(queue)
        return _drain(queue, self._change_listeners)

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

    def facts(
        self, system_id: int, plan: Plan, uav_id: str, *, items: int, stream: bool = False
    ) -> tuple[Facts, Needs]:
        """What the preflight audit compares: the vehicle as it was heard, and what the plan needs of it.

        Raises KeyError if it was never heard.
        """
        vehicle, scenario = self._vehicles[system_id], plan.scenario
        uav, said, home = scenario.uav(uav_id), vehicle.state.snapshot(), vehicle.state.home_deg
        facts = Facts(
            autopilot=self.autopilot(system_id),
            parameters=self.parameters.get(system_id, {}),
            model=self.model(system_id),
            at_m=None if said is None else geodetic_to_east_north(scenario.origin, said.lat_deg, said.lon_deg),
            home_m=None if home is None else geodetic_to_east_north(scenario.origin, *home),
            gps_fix=vehicle.state.gps_fix,
            satellites=vehicle.state.satellites,
            battery=vehicle.state.battery,
        )
        needs = Needs(
            path_m=list(plan.trajectories_m[uav_id]),
            slot_s=scenario.slot_duration_s,
            altitude_m=scenario.altitude_of(uav),
            max_speed_mps=uav.max_speed_mps,
            items=items,
            max_items=MAX_ITEMS,
            stream=stream,
            lost_after_s=self.monitor.lost_after_s,
        )
        return facts, needs

    def record(self, path: Path) -> TelemetryLog:
        """Write all traffic to a .tlog until `stop_recording`."""
        log = TelemetryLog(path)
        self._begin().record(log)
        return log

    def stop_recording(self, log: TelemetryLog) -> None:
        """End a log that `record` began."""
        if self._hub is not None:
            self._hub.stop_recording(log)

    # -- telling ------------------------------------------------------------------------------------------------

    async def upload(self, missions: Mapping[int, Mission], *, attempts: int = ATTEMPTS) -> dict[int, UploadResult]:
        """Give each vehicle its mission, read it back, compare; up to `attempts` times each."""
        return await self._each(
            missions,
            lambda vehicle, mission: upload_verified(
                vehicle, mission, attempts=attempts, given_up=self._given_up(vehicle)
            ),
            UploadResult,
        )

    async def prepare(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        """Ask each for its telemetry streams and read the parameters its model and the preflight audit need."""
        return await self._command(dict.fromkeys(system_ids), lambda vehicle, _: self._prepare(vehicle))

    async def upload_fence(
        self, items: Mapping[int, Sequence[MissionItem]], *, mission_type: MissionType = MissionType.FENCE
    ) -> dict[int, UploadResult]:
        """Give each vehicle a geofence (or rally points), read it back, compare. No items: clear."""
        return await self._each(
            items,
            lambda vehicle, wanted: upload_items(vehicle, wanted, mission_type, given_up=self._given_up(vehicle)),
            UploadResult,
        )

    async def launch(self, altitudes_m: Mapping[int, float], *, timeout_s: float) -> dict[int, CommandResult]:
        """Arm, take off, and wait within `timeout_s` until each is at its altitude (metres above its own home)."""
        return await self._command(altitudes_m, lambda vehicle, up_m: flight.launch(vehicle, up_m, timeout_s))

    async def go_to(
        self, places: Mapping[int, tuple[float, float, float]], *, timeout_s: float
    ) -> dict[int, CommandResult]:
        """Fly each straight to its (latitude, longitude in degrees, metres above home) and hover there.

        For gathering at the slot-0 points before `start`. Nothing checks that the straight lines keep apart.
        """
        return await self._command(places, lambda vehicle, place: flight.go_to(vehicle, *place, timeout_s))

    async def start(self, system_ids: Iterable[int], *, item: int | None = None) -> dict[int, CommandResult]:
        """Fly the missions on board, all together: every vehicle has its item set before the first one starts.

        They begin with `item`, or with what a vehicle flies that hovers at its slot-0 point (`Mission.start_item`).
        """

        def first(vehicle: Vehicle) -> int:
            return vehicle.start_item if item is None else item

        ids = list(system_ids)
        ready = await self._command(dict.fromkeys(ids), lambda vehicle, _: flight.set_current(vehicle, first(vehicle)))
        able = [system_id for system_id in ids if ready[system_id].ok]
        return ready | await self._command(
            dict.fromkeys(able), lambda vehicle, _: flight.start(vehicle, first(vehicle))
        )

    async def swap(self, missions: Mapping[int, Mission]) -> dict[int, SwapResult]:
        """Replace missions in flight. Each result is `ok` (verified and flying it) or says why not and if it holds."""
        return await self._each(
            missions,
            lambda vehicle, mission: flight.swap(vehicle, mission, self._given_up(vehicle)),
            lambda **fields: SwapResult(upload=UploadResult(**fields), **fields),
        )

    async def hold(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        """Stop and hover."""
        return await self._command(dict.fromkeys(system_ids), lambda vehicle, _: flight.hold(vehicle))

    async def return_home(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        """Return to where they took off, each by its own autopilot's way; returns when they are on it."""
        return await self._command(dict.fromkeys(system_ids), lambda vehicle, _: flight.return_home(vehicle))

    async def land(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        """Land where they are; returns when they descend."""
        return await self._command(dict.fromkeys(system_ids), lambda vehicle, _: flight.land(vehicle))

    # -- inside -------------------------------------------------------------------------------------------------

    def _begin(self) -> Hub:
        """MAVSDK behind the hub, made on first use; a closed link stays closed."""
        if self._mavsdk is None and not self._closed:
            to_python_logging()
            loop = asyncio.get_running_loop()
            mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
            mavsdk.add_any_connection_with_handle_and_forwarding("raw://", ForwardingOption.OFF)
            self._hub = Hub(self._options, to_mavsdk=mavsdk.pass_received_raw_bytes, on_heard=self._frame_heard)
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
                    pool=self._pool,
                    loop=asyncio.get_running_loop(),
                    on_message=self._message,
                )
                vehicle.announce = partial(self._announce, system_id)

    def _announce(self, system_id: int, mode: FlightMode) -> None:
        self.classifier.expect(system_id, frozenset({mode}), self._clock.now())

    def _frame_heard(self, frame: Frame) -> None:
        """Whatever component 1 sends shows that autopilot and link are alive."""
        self.classifier.alive(frame.system_id, frame.component_id, self._clock.now())

    def _message(self, vehicle: Vehicle, name: str, fields: dict[str, Any], heard_s: float) -> None:
        if name == "HEARTBEAT" and vehicle.system_id in self._awaited:
            self.classifier.watch(vehicle.system_id, heard_s)
        self.classifier.hear(vehicle.system_id, AUTOPILOT, name, fields, heard_s)

    async def _prepare(self, vehicle: Vehicle) -> None:
        await flight.ask_for_streams(vehicle)
        values = await read_parameters(vehicle, parameter_names(vehicle.autopilot))
        self.parameters[vehicle.system_id] = values
        self.models[vehicle.system_id] = model_from_parameters(vehicle.autopilot, values)

    async def _watch(self) -> None:
        """Ask the monitor, forever; after a stall of our own, first take in what arrived meanwhile."""
        loop = asyncio.get_running_loop()
        while True:
            asked = loop.time()
            await asyncio.sleep(POLL_S)
            if loop.time() - asked > POLL_S + STALL_S:
                continue
            changes = self.classifier.poll(self._clock.now())
            for event in self.classifier.link_events:
                for queue in self._listeners:
                    queue.put_nowait(event)
            for change in changes:
                for listener in self._change_listeners:
                    listener.put_nowait(change)

    def _given_up(self, vehicle: Vehicle) -> Callable[[], bool]:
        system_id, monitor = vehicle.system_id, self.monitor
        return lambda: system_id in monitor.watched and monitor.state(system_id) is LinkState.LOST

    async def _command(
        self, requests: Mapping[int, Request], act: Callable[[Vehicle, Request], Awaitable[None]]
    ) -> dict[int, CommandResult]:
        return await self._each(
            requests, lambda vehicle, request: flight.command(vehicle, act(vehicle, request)), CommandResult
        )

    async def _each(
        self,
        requests: Mapping[int, Request],
        act: Callable[[Vehicle, Request], Awaitable[Outcome]],
        refuse: Callable[..., Outcome],
    ) -> dict[int, Outcome]:
        """One result for each system id, all at once; `refuse(system_id=, seconds=, error=)` for who is not here."""
        self._open()

        async def one(system_id: int, request: Request) -> Outcome:
            vehicle = self._vehicles.get(system_id)
            if vehicle is None or not vehicle.heard:
                return refuse(
                    system_id=system_id, seconds=0.0, error=f"system {system_id} was never heard on this link"
                )
            return await act(vehicle, request)

        outcomes = await asyncio.gather(*(one(*request) for request in requests.items()))
        return dict(zip(requests, outcomes, strict=True))


async def _drain(
    queue: asyncio.Queue[Event | None], listeners: list[asyncio.Queue[Event | None]]
) -> AsyncGenerator[Event, None]:
    try:
        while (event := await queue.get()) is not None:
            yield event
    finally:
        listeners.remove(queue)
