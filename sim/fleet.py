"""The fleet: all vehicles, stepped together on one clock, each with a link of its own."""

import asyncio
import random
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from types import TracebackType
from typing import Any, Self

from skyfolio.sim.clock import EPOCH_S, Clock
from skyfolio.sim.fault_schedule import Schedule
from skyfolio.sim.faults import Fault, describe
from skyfolio.sim.ground_crew import CrewAtWork, GroundCrew
from skyfolio.sim.impairments import Impairments
from skyfolio.sim.kinematics import Limits
from skyfolio.sim.knobs import LONGEST_S, check_number, check_whole
from skyfolio.sim.land import Hills
from skyfolio.sim.link import Address, MemoryLink, Radio, endpoints_of, open_link
from skyfolio.sim.signing import Signature
from skyfolio.sim.slots import GeoPoint, SlotGrid
from skyfolio.sim.specs import VehicleSpec
from skyfolio.sim.station import Vehicle
from skyfolio.sim.truth import SAMPLE_INTERVAL_S, Event, TruthLog
from skyfolio.sim.weather import Air, Weather
from skyfolio.sim.wire import Decoder, Encoder

DEFAULT_ENDPOINT = "udpout://127.0.0.1:14540"
STEP_S = 0.05
"""Fleet seconds in one step of the dynamics."""
WAKE_S = 0.01
"""Wall seconds between two readings of the clock."""
LAST_SLOT = 1_000_000
STRIDE_S = 1.0
"""Fleet seconds caught up at once, before other tasks of the event loop run."""

Station = Callable[[bytes, int], None]
"""Takes a datagram, and the system id of the vehicle that sent it."""


class Fleet:
    """Simulated vehicles that speak MAVLink 2 over UDP while the context is open.

    `async with fleet:` opens the sockets and flies on `clock`. Without it there are no sockets: `step_to` moves the
    whole fleet in virtual time as fast as it computes, `attach` puts ground stations beside it in memory, and the same
    seed gives the same log byte for byte. `seed` decides phases, weather and links. `protocol_clock` gives the seconds
    for time-outs and links: by default wall time with sockets, fleet time without. `signing_key` (32 bytes): sign, and
    refuse what is not signed. `hills`: the ground, where it is not level. `crew`: changes batteries; None: there is
    none. ValueError for no vehicles, duplicate ids, a
    bad endpoint or key.
    """

    def __init__(
        self,
        specs: Iterable[VehicleSpec],
        *,
        clock: Clock,
        endpoint: str = DEFAULT_ENDPOINT,
        limits: Limits | None = None,
        seed: int = 0,
        protocol_clock: Callable[[], float] | None = None,
        weather: Weather | None = None,
        signing_key: bytes | None = None,
        hills: Hills | None = None,
        crew: GroundCrew | None = None,
    ) -> None:
        vehicles = list(specs)
        if not vehicles:
            raise ValueError("a fleet needs at least one vehicle")
        ids = [spec.system_id for spec in vehicles]
        if len(set(ids)) != len(ids):
            raise ValueError(f"system ids must differ, got {sorted(ids)}")
        self.clock = clock
        self.truth = TruthLog()
        self.slots: SlotGrid | None = None
        self.now_s = self._start_s = clock.now()
        self._steps = 0
        self._endpoints = dict(zip(ids, endpoints_of(endpoint, len(vehicles)), strict=True))
        self._schedule = Schedule()
        self._flying: asyncio.Task[None] | None = None
        self._stations: dict[Address, Station] = {}
        self._protocol_clock = protocol_clock
        self._seed = seed
        self._signature = None if signing_key is None else Signature(signing_key, self._unix_time)
        self._hills = hills
        weather = weather or Weather()
        self._fronts = list(weather.fronts)
        spread = random.Random(seed)  # noqa: S311
        self.vehicles: dict[int, Vehicle] = {
            spec.system_id: self._vehicle(spec, limits, weather, spread.random()) for spec in vehicles
        }
        self.crew = None if crew is None else CrewAtWork(crew, self.vehicles.values(), seed=seed, emit=self._log)
        """The ground crew with its pads and packs, if there is one."""

    def _vehicle(self, spec: VehicleSpec, limits: Limits | None, weather: Weather, phase: float) -> Vehicle:
        name = f"{self._seed}/{spec.system_id}"
        return Vehicle(
            spec,
            limits=limits,
            radio=Radio(name, self._protocol_now, partial(Decoder, self._signature)),
            on_event=partial(self._log, spec.system_id),
            now_s=self.now_s,
            phase=phase,
            air=Air(weather, name),
            tap=self.truth,
            encoder=Encoder(spec.system_id, self._signature),
            hills=self._hills,
        )

    # -- what happens to it -------------------------------------------------------------------------------------

    def inject(self, fault: Fault, *, at_s: float | None = None, at_slot: int | None = None) -> None:
        """Let a fault happen now, once fleet time reaches `at_s`, or when slot `at_slot` begins (see `start_slots`).

        Like every method here it is called in the thread in which the fleet flies; from others by
        `call_soon_threadsafe`.
        ValueError for an unknown vehicle, for both a time and a slot, or for one that lies beyond eleven days.
        """
        if fault.system_id not in self.vehicles:
            raise ValueError(f"there is no vehicle {fault.system_id}; the fleet has {sorted(self.vehicles)}")
        if at_s is not None and at_slot is not None:
            raise ValueError("at_s and at_slot: a fault happens at one of them")
        if at_s is not None:
            check_number("at_s", at_s, -LONGEST_S, LONGEST_S)
        if at_slot is not None:
            check_whole("at_slot", at_slot, 0, LAST_SLOT)
        if at_s is None and at_slot is None:
            self._strike(fault)
        else:
            self._schedule.add(fault, at_s=at_s, at_slot=at_slot)

    def impair(self, *, up: Impairments | None = None, down: Impairments | None = None) -> None:
        """Impair every vehicle's link: `up` is to the vehicles, `down` from them; None leaves a direction."""
        for vehicle in self.vehicles.values():
            vehicle.radio.impair(up=up, down=down)

    def start_slots(
        self,
        duration_s: float,
        *,
        at_s: float | None = None,
        points: Mapping[int, Sequence[GeoPoint]] | None = None,
    ) -> SlotGrid:
        """Begin slot 0 at fleet time `at_s` (default: now); see `SlotGrid` for `duration_s` and `points`.

        Whenever a slot begins, each vehicle's distance from its point is logged (event "slot").
        """
        self.slots = SlotGrid(duration_s, self.now_s if at_s is None else at_s, points or {})
        self._schedule.grid = self.slots
        return self.slots

    def attach(self, station: Station, address: Address = ("gcs", 0)) -> Callable[[bytes, int], None]:
        """Connect a ground station to the fleet in memory, and return how it sends.

        `station(data, system_id)` is called with the datagrams of every vehicle; the function that is returned sends a
        datagram to one of them, `send(data, system_id)`. Each station needs an address of its own. RuntimeError while
        the fleet flies with sockets.
        """
        if self._flying is not None:
            raise RuntimeError("a fleet with sockets receives from ground stations there")
        self._stations[address] = station
        for system_id, vehicle in self.vehicles.items():
            if isinstance(vehicle.link, MemoryLink):
                vehicle.link.add(address)
            else:
                vehicle.link = MemoryLink(
                    address, vehicle.radio, vehicle.receive, system_id=system_id, stations=self._stations
                )
        return partial(self._from_station, address)

    def _from_station(self, address: Address, data: bytes, system_id: int) -> None:
        link = self.vehicles[system_id].link
        if link is not None and link.is_open:
            link.receive(data, address)

    # -- time ---------------------------------------------------------------------------------------------------

    def step_to(self, t_s: float) -> None:
        """Fly as many whole steps of `STEP_S` as fit before fleet time `t_s`."""
        while (after := self._start_s + (self._steps + 1) * STEP_S) <= t_s + 1e-9:
            for fault in self._schedule.due(self.now_s):
                self._strike(fault)
            self._steps += 1
            before, self.now_s = self.now_s, after
            if self._fronts:
                self._announce_fronts()
            for vehicle in self.vehicles.values():
                vehicle.step(after, STEP_S)
            if self.crew is not None:
                self.crew.step(after)
            if self._steps % round(SAMPLE_INTERVAL_S / STEP_S) == 0:
                for vehicle in self.vehicles.values():
                    self.truth.record(after, vehicle)
            self._judge_slots(before, after)

    async def wait(self) -> None:
        """Wait until the fleet's context is closed; raise the exception that broke it."""
        if self._flying is not None:
            await asyncio.wait([self._flying])
            if not self._flying.cancelled():
                self._flying.result()

    async def __aenter__(self) -> Self:
        self._close_links()
        try:
            for system_id, vehicle in self.vehicles.items():
                if vehicle.transmitting:
                    vehicle.link = await open_link(self._endpoints[system_id], vehicle.radio, vehicle.receive)
        except BaseException:
            self._close_links()
            raise
        self._flying = asyncio.create_task(self._fly(), name="sim-fleet")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        flying, self._flying = self._flying, None
        self._close_links()
        if flying is not None:
            flying.cancel()
            with suppress(asyncio.CancelledError):
                await flying

    async def _fly(self) -> None:
        while True:
            now_s = self.clock.now()
            self.step_to(min(now_s, self.now_s + STRIDE_S))
            for vehicle in self.vehicles.values():
                if vehicle.link is not None:
                    vehicle.link.pump()
            await asyncio.sleep(0.0 if now_s - self.now_s > STRIDE_S else WAKE_S)

    def _protocol_now(self) -> float:
        if self._protocol_clock is not None:
            return self._protocol_clock()
        return self.now_s if self._flying is None else time.monotonic()

    def _unix_time(self) -> float:
        return EPOCH_S + self.now_s if self._flying is None else time.time()

    def _strike(self, fault: Fault) -> None:
        knobs = describe(fault)
        del knobs["system_id"]
        self._log(fault.system_id, "fault", {"fault": knobs.pop("kind"), **knobs})
        vehicle = self.vehicles[fault.system_id]
        vehicle.wake()
        fault.strike(vehicle)

    def _judge_slots(self, before_s: float, after_s: float) -> None:
        grid = self.slots
        if grid is None or (slot := grid.slot_at(after_s)) == grid.slot_at(before_s) or slot < 0:
            return
        for system_id, vehicle in self.vehicles.items():
            error_m = grid.error_m(system_id, slot, *vehicle.position[:2])
            if error_m is not None:
                self._log(system_id, "slot", {"slot": slot, "error_m": round(error_m, 3)})

    def _announce_fronts(self) -> None:
        while self._fronts and self._fronts[0].at_s <= self.now_s:
            detail = asdict(self._fronts.pop(0))
            del detail["at_s"]
            self._log(0, "wind_front", detail)

    def _close_links(self) -> None:
        for vehicle in self.vehicles.values():
            if vehicle.link is not None:
                vehicle.link.close()
                vehicle.link = None

    def _log(self, system_id: int, kind: str, detail: dict[str, Any]) -> None:
        self.truth.add_event(Event(self.now_s, system_id, kind, detail))


async def serve(fleet: Fleet, *, until: asyncio.Event | None = None, for_s: float | None = None) -> None:
    """Fly a fleet until `until` is set, `for_s` fleet seconds have passed, or the caller is cancelled.

    With neither it flies on until cancelled. An exception that breaks the fleet is raised here.
    """
    async with fleet:
        ends: list[asyncio.Task[Any]] = [asyncio.create_task(fleet.wait())]
        if until is not None:
            ends.append(asyncio.create_task(until.wait()))
        if for_s is not None:
            ends.append(asyncio.create_task(_reach(fleet, fleet.now_s + for_s)))
        try:
            done, _ = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            for end in done:
                end.result()
        finally:
            for end in ends:
                end.cancel()


async def _reach(fleet: Fleet, t_s: float) -> None:
    while fleet.now_s < t_s:  # noqa: ASYNC110
        await asyncio.sleep(WAKE_S)
