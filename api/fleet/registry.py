"""The registered vehicles of this service: which UAV of a plan is which MAVLink system, and what is known of each."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from sqlalchemy import delete, insert, select

from skyfolio.api.common.errors import ConflictError, InvalidError, NotFoundError
from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.settings import Settings
from skyfolio.api.common.supervision import Supervisor
from skyfolio.api.common.surroundings import utc_s
from skyfolio.api.fleet.commander import Commander
from skyfolio.api.fleet.fleet_connection import FleetConnection
from skyfolio.api.fleet.fleet_ports import FleetPorts
from skyfolio.api.fleet.own_link import Heard, OwnLink
from skyfolio.api.fleet.rotor_fit import RotorFit, rotors_of
from skyfolio.api.fleet.vehicle_news import FleetNews
from skyfolio.api.fleet.vehicle_rights import VehicleRights
from skyfolio.api.fleet.vehicle_view import VehicleView, view_of
from skyfolio.api.store import Database, StoreError
from skyfolio.api.store.event_log import EventLog
from skyfolio.api.store.leases import Leases
from skyfolio.api.store.tables import vehicles as table
from skyfolio.mavlink_bridge import FleetLink, LinkState, VehiclesMissing
from skyfolio.mavlink_bridge.conditions import Change
from skyfolio.mavlink_bridge.mission_messages import GROUND
from skyfolio.planner.scenario import Wind

HEARD_WITHIN_S = 5.0
"""Wall seconds that a vehicle may take to be heard before an upload, or the watch of its heartbeats, goes on without
it."""
REGISTRY_EVERY_S = 1.0
"""Wall seconds between looks at what other services registered."""
PORT_FREE_WITHIN_S = 20.0
"""Wall seconds for which a restarted service waits until the guard of the last process lets go of its ports."""


class Fleet:
    """The registry, and what is known of each registered vehicle.

    healthy: returns whether vehicles may rely on us; our HEARTBEAT is only sent while it does. ports: what it reaches
    vehicles through. leases: which vehicles this service may send to, and until when; None where no other service
    shares the database.
    """

    def __init__(
        self,
        settings: Settings,
        clock: FleetClock,
        events: EventLog,
        database: Database,
        background: Supervisor,
        healthy: Callable[[], bool] = lambda: True,
        ports: FleetPorts | None = None,
        leases: Leases | None = None,
    ) -> None:
        self._settings, self._clock, self._events = settings, clock, events
        self._database = database
        self._simulated: set[str] = set()
        self._systems: dict[str, int] = {}
        self.rights = VehicleRights(leases)
        """Which vehicles are another service's."""
        self.news = FleetNews(self._systems, events, self.rights.is_of_another)
        """What the link reports of them."""
        ports = ports or FleetPorts()
        self.new_guard = ports.guard
        """Makes a guard of setpoint streams."""
        self._connection = FleetConnection(
            settings, clock, self.news, background, healthy, ports.link, self.rights.may_send
        )
        self.commander = Commander(lambda: self.link)
        """Through which every command to a vehicle goes."""
        self._finding: asyncio.Task[None] | None = None
        self._changing = asyncio.Lock()

    @property
    def link(self) -> FleetLink:
        """Return the open link. Raises ConflictError before any vehicle is registered."""
        return self._connection.link

    async def start(self) -> None:
        """Take over the registry of the last process, without its simulated vehicles: they ended with it."""
        await self._database.write(delete(table).where(table.c.simulated.is_(True)))
        await self.read_registry()
        if self._systems:
            self._finding = asyncio.create_task(self._find(), name="fleet-find")

    async def read_registry(self) -> None:
        """Follow the registry that other services change as well. Raises StoreError, ConnectionFailed."""
        async with self._changing:
            stored = {row.uav_id: row.system_id for row in await self._database.rows(select(table))}
            for uav_id in [uav_id for uav_id, system_id in self._systems.items() if stored.get(uav_id) != system_id]:
                self._forget(uav_id)
            for uav_id, system_id in stored.items():
                if uav_id not in self._systems:
                    await self._connection.open(patience_s=PORT_FREE_WITHIN_S)
                    self._systems[uav_id] = system_id
                    self.link.expect({system_id})

    async def follow_registry(self) -> None:
        """Read the registry again and again, and expect heartbeats of the vehicles that another service registered."""
        while True:
            await asyncio.sleep(REGISTRY_EVERY_S)
            before = set(self._systems)
            with suppress(StoreError):  # readiness reports a database that does not answer
                await self.read_registry()
            for uav_id in set(self._systems) - before:
                self.link.classifier.watch(self._systems[uav_id], self._clock.now())

    async def _find(self) -> None:
        """Wait until vehicles are heard: discovery takes wall time, silence counts fleet time."""
        with suppress(VehiclesMissing):
            await self.link.wait_for(set(self._systems.values()), timeout_s=HEARD_WITHIN_S)
        for system_id in self._systems.values():
            self.link.classifier.watch(system_id, self._clock.now())

    async def register(self, uav_id: str, system_id: int, *, simulated: bool = False) -> VehicleView:
        """Tie a UAV id to a MAVLink system id, and open the link.

        Raises ConflictError if either is taken, InvalidError for the system id of this ground station itself.
        """
        if system_id == GROUND[0]:
            raise InvalidError(
                f"system_id: {system_id} is this ground station's own on the link; give the vehicle another"
            )
        self._require_free(uav_id, system_id)
        await self._connection.open()
        async with self._changing:
            self._require_free(uav_id, system_id)  # others have registered while the link opened
            if uav_id not in self._systems:
                self._systems[uav_id] = system_id
                self.link.expect({system_id})
                self.link.classifier.watch(system_id, self._clock.now())
                row = {"uav_id": uav_id, "system_id": system_id, "simulated": simulated, "registered_at": utc_s()}
                await self._database.write((insert(table), row))
                self._events.add("vehicle_registered", uav_id=uav_id, system_id=system_id, simulated=simulated)
        if simulated:
            self._simulated.add(uav_id)
        return self.view(uav_id)

    def _require_free(self, uav_id: str, system_id: int) -> None:
        if self._systems.get(uav_id, system_id) != system_id:
            raise ConflictError(f"uav_id: {uav_id!r} is already system {self._systems[uav_id]}")
        uavs = {system: uav for uav, system in self._systems.items()}
        if uavs.get(system_id, uav_id) != uav_id:
            raise ConflictError(f"system_id: {system_id} is already {uavs[system_id]!r}")

    async def remove(self, uav_id: str) -> None:
        """Forget a vehicle, which the caller knows to fly in no operation. Raises NotFoundError."""
        if uav_id not in self._systems:
            raise NotFoundError(f"vehicle {uav_id!r} does not exist")
        async with self._changing:
            self._forget(uav_id)
            await self._database.write(delete(table).where(table.c.uav_id == uav_id))
            self._events.add("vehicle_removed", uav_id=uav_id)

    def _forget(self, uav_id: str) -> None:
        system_id = self._systems.pop(uav_id)
        self.link.classifier.unwatch(system_id)
        self.news.forget(system_id)
        self._simulated.discard(uav_id)

    def is_any_heard(self, system_ids: Iterable[int]) -> bool:
        """Return whether any of these vehicles is heard."""
        return not self.empty and any(self.link.is_heard(system_id) for system_id in system_ids)

    def is_simulated(self, uav_id: str) -> bool:
        """Return whether this service itself simulates the vehicle."""
        return uav_id in self._simulated

    @property
    def enforces_preflight(self) -> bool:
        """Return whether a blocker of the preflight audit ends an operation."""
        return self._settings.preflight == "enforce"

    @property
    def start_within_m(self) -> float:
        """Return how far from its first point a UAV may take off, in metres."""
        return self._settings.start_within_m

    @property
    def links(self) -> tuple[str, ...]:
        """Return the URLs of the link's endpoints, the preferred one first."""
        return self._connection.urls

    @property
    def signing_key_file(self) -> str | None:
        """Return the path of the key with which MAVLink is signed; None where it is not."""
        key = self._settings.signing_key_file
        return None if key is None else str(key)

    @property
    def empty(self) -> bool:
        """Return whether no vehicle is registered."""
        return not self._systems

    def system_of(self, uav_id: str) -> int:
        """Return the MAVLink system id of a UAV. Raises InvalidError if it is not registered."""
        try:
            return self._systems[uav_id]
        except KeyError:
            raise InvalidError(f"vehicles: {uav_id!r} is not registered with the fleet") from None

    def find(self, uav_id: str) -> VehicleView:
        """Return one vehicle as it was last heard. Raises NotFoundError."""
        if uav_id not in self._systems:
            raise NotFoundError(f"vehicle {uav_id!r} does not exist")
        return self.view(uav_id)

    def views(self) -> list[VehicleView]:
        """Return all vehicles as they were last heard, ordered by UAV id."""
        return [self.view(uav_id) for uav_id in sorted(self._systems)]

    def view(self, uav_id: str) -> VehicleView:
        """Return one vehicle as it was last heard. Raises InvalidError if it is not registered."""
        system_id = self.system_of(uav_id)
        change = self.news.changes.get(system_id)
        return view_of(
            self.link,
            uav_id,
            system_id,
            now_s=self._clock.now(),
            simulated=uav_id in self._simulated,
            condition_cause=None if change is None else change.cause,
        )

    def rotors_of(self, uav_id: str, wind: Wind) -> RotorFit:
        """Return rotors fitted to what the vehicle reported in flight. Raises NotFoundError, ConflictError."""
        return rotors_of(self.link, uav_id, self.find(uav_id).system_id, wind)

    @contextmanager
    def recorded(self, name: str) -> Iterator[None]:
        """Append all traffic to `NAME.tlog` meanwhile, if the settings name a folder for it.

        A log that cannot be written is reported by one event, `telemetry_log`; the flight goes on without it.
        """
        folder = self._settings.telemetry_log_dir

        def failed(reason: str) -> None:
            self.note("telemetry_log", operation_id=name, level="warning", error=reason)

        log = None if folder is None else self.link.record(folder / f"{name}.tlog", failed)
        try:
            yield
        finally:
            if log is not None:
                self.link.stop_recording(log)

    def condition(self, system_id: int) -> Change | None:
        """Return the newest change of a vehicle's condition and its cause; None if it has always been live."""
        return self.news.changes.get(system_id)

    def heard(self) -> dict[int, Heard]:
        """Return how each registered vehicle is heard, by system id; those that are not watched yet are left out."""
        monitor, now_s = self._connection.monitor, self._clock.now()
        watched = monitor.watched
        return {
            system_id: Heard(
                silent_for_s=monitor.silent_for_s(system_id, now_s), lost=monitor.state(system_id) is LinkState.LOST
            )
            for system_id in self._systems.values()
            if system_id in watched
        }

    def own_link(self) -> OwnLink:
        """Return a new judge of whether a flight's vehicles or our own link are silent, with this fleet's limits."""
        monitor = self._connection.monitor
        return OwnLink(stale_after_s=monitor.stale_after_s, lost_after_s=monitor.lost_after_s)

    @property
    def uav_ids(self) -> list[str]:
        """Return the ids of all registered vehicles, sorted."""
        return sorted(self._systems)

    def taken(self, system_id: int) -> str | None:
        """Return, in words, which human or failsafe flies a vehicle at this moment; None if we may command it."""
        return self.link.classifier.taken(system_id, self._clock.now())

    def height_amsl_m(self, system_id: int, altitude_m: float) -> float | None:
        """Convert an altitude above a vehicle's home to metres above sea level; None until its home is known."""
        home_amsl_m = self.home_amsl_m(system_id)
        return None if home_amsl_m is None else home_amsl_m + altitude_m

    def home_amsl_m(self, system_id: int) -> float | None:
        """Return how high a vehicle's home is, metres above sea level; None until it has reported it."""
        return self.link.vehicle(system_id).state.home_amsl_m if system_id in self.link.heard_systems else None

    def is_heard(self, system_id: int) -> bool:
        """Return whether the vehicle was heard, and its link is not lost."""
        return self.link.is_heard(system_id)

    def is_down(self, system_id: int) -> bool:
        """Return whether the vehicle last reported to be disarmed, and is not seen to be in the air."""
        telemetry = self.link.telemetry(system_id)
        return telemetry is not None and not telemetry.armed and not self.is_aloft(system_id)

    def was_flying(self, system_id: int, up_m: float, ago_s: float) -> None:
        """Take in that a vehicle was in the air, so high, when a service that has died last heard it."""
        self.link.classifier.was_flying(system_id, up_m, self._clock.now() - ago_s)

    def now_s(self) -> float:
        """Return the time in fleet seconds."""
        return self._clock.now()

    def is_aloft(self, system_id: int) -> bool:
        """Return whether the vehicle reports to be disarmed, and yet is not known to be on the ground."""
        return self.link.classifier.is_aloft(system_id, self._clock.now())

    def has_fallen(self, system_id: int) -> bool:
        """Return whether the vehicle reports to be disarmed, and has come down by falling."""
        return self.link.classifier.has_fallen(system_id, self._clock.now())

    def warning(self, system_id: int) -> str | None:
        """Return what the vehicle reports of a failsafe that changes nothing; None if it reports none."""
        return self.link.classifier.warning(system_id)

    def note(self, kind: str, **data: Any) -> None:
        """Add an event about a vehicle to the log."""
        self._events.add(kind, **data)

    async def close(self) -> None:
        """Close the link; the vehicles keep what they have on board."""
        if self._finding is not None:
            self._finding.cancel()
            with suppress(asyncio.CancelledError):
                await self._finding
        await self._connection.close()
