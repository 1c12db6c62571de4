"""The link to the whole fleet: every command and question to vehicles, all of them at once."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TypeVar

import skyfolio.mavlink_bridge.departure as departure
import skyfolio.mavlink_bridge.flight as flight
from skyfolio.mavlink_bridge.altitudes import altitudes_of, climb_in_slot_m, over_ground
from skyfolio.mavlink_bridge.findings import START_WITHIN_M, Facts, Needs
from skyfolio.mavlink_bridge.heartbeat import LinkState
from skyfolio.mavlink_bridge.items import MAX_ITEMS, Mission, MissionItem
from skyfolio.mavlink_bridge.listening import ListeningLink
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.readiness import wait_for_facts
from skyfolio.mavlink_bridge.results import CommandResult, ReadResult, Recognised, SwapResult, UploadResult
from skyfolio.mavlink_bridge.transfer import (
    ATTEMPTS,
    read_items,
    read_parameters,
    recognise,
    upload_items,
    upload_verified,
)
from skyfolio.mavlink_bridge.vehicle import NotDone, Vehicle
from skyfolio.planner.energy.outlook import charge_needed
from skyfolio.planner.geodesy import geodetic_to_east_north
from skyfolio.planner.plans import Plan

SET_ITEM_TIMES = 2
"""No vehicle starts before all have their item, so on a link that loses a tenth each gets a second chance."""

_LOGGER = logging.getLogger(__name__)

OnWait = Callable[[int, tuple[str, ...]], None]
"""Called with the facts that are waited for from a system id."""
OnRefused = Callable[[int, str], None]
"""Called with the reason why a system id cannot be armed yet."""
Outcome = TypeVar("Outcome")
Request = TypeVar("Request")


class FleetLink(ListeningLink):
    """All vehicles behind one or more connections.

        async with FleetLink(clock=clock, monitor=HeartbeatMonitor()) as link:
            await link.connect("udpin://127.0.0.1:14540")
            await link.wait_for({1, 2, 3}, timeout_s=10)
            await link.upload(missions)

    `clock` returns fleet seconds and is read from MAVSDK's threads too. Time-outs named `timeout_s` are wall seconds.
    Methods that address vehicles ask all of them at once and return one result for each; none stops the others.
    A system id that was never heard on the link gets a result that says so.
    """

    # -- telling ------------------------------------------------------------------------------------------------

    async def upload(self, missions: Mapping[int, Mission], *, attempts: int = ATTEMPTS) -> dict[int, UploadResult]:
        """Upload a mission to each vehicle, read it back, compare; up to `attempts` times each."""
        return await self._each(
            missions,
            lambda vehicle, mission: upload_verified(
                vehicle, mission, attempts=attempts, given_up=self._given_up(vehicle)
            ),
            UploadResult,
        )

    async def recognise(self, missions: Mapping[int, Sequence[Mission]]) -> dict[int, Recognised]:
        """Return which of its possible missions is on board of each vehicle, proven by reading it back."""
        return await self._each(
            missions, lambda vehicle, known: recognise(vehicle, known, self._given_up(vehicle)), Recognised
        )

    async def prepare(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        """Request telemetry streams from each, and read the parameters that its model and the preflight audit need."""
        return await self._command(dict.fromkeys(system_ids), lambda vehicle, _: self._prepare(vehicle))

    async def ask_for_streams(self, system_ids: Iterable[int]) -> dict[int, CommandResult]:
        """Request telemetry streams from each."""
        return await self._command(dict.fromkeys(system_ids), lambda vehicle, _: flight.ask_for_streams(vehicle))

    async def wait_for_facts(
        self, system_ids: Iterable[int], on_wait: OnWait = lambda _system, _missing: None
    ) -> dict[int, tuple[str, ...]]:
        """Wait until each has reported what the preflight audit judges; return what each had not within its time.

        A vehicle that was never heard is not waited for.
        """
        here = {system_id: self._vehicles.get(system_id) for system_id in system_ids}
        heard = {system_id: vehicle for system_id, vehicle in here.items() if vehicle is not None and vehicle.heard}
        missing = await asyncio.gather(
            *(wait_for_facts(vehicle, partial(on_wait, system_id)) for system_id, vehicle in heard.items())
        )
        return dict(zip(heard, missing, strict=True))

    async def upload_fence(
        self, items: Mapping[int, Sequence[MissionItem]], *, mission_type: MissionType = MissionType.FENCE
    ) -> dict[int, UploadResult]:
        """Upload a geofence (or rally points) to each vehicle, read it back, compare. No items: clear."""
        return await self._each(
            items,
            lambda vehicle, wanted: upload_items(vehicle, wanted, mission_type, given_up=self._given_up(vehicle)),
            UploadResult,
        )

    async def arm(
        self, system_ids: Iterable[int], *, patience_s: float, on_refused: OnRefused = lambda _system, _why: None
    ) -> dict[int, CommandResult]:
        """Arm each where it stands, as soon as it can be armed; `on_refused` is called with why it cannot yet."""
        return await self._command(
            dict.fromkeys(system_ids),
            lambda vehicle, _: departure.arm(vehicle, patience_s, partial(on_refused, vehicle.system_id)),
        )

    async def read(self, system_ids: Iterable[int], mission_type: MissionType) -> dict[int, ReadResult]:
        """Read what each has on board of one mission type."""
        return await self._each(
            dict.fromkeys(system_ids),
            lambda vehicle, _: read_items(vehicle, mission_type, self._given_up(vehicle)),
            ReadResult,
        )

    async def launch(self, altitudes_m: Mapping[int, float], *, timeout_s: float) -> dict[int, CommandResult]:
        """Arm, take off, and wait within `timeout_s` until each is at its altitude (metres above its own home)."""
        return await self._command(altitudes_m, lambda vehicle, up_m: departure.launch(vehicle, up_m, timeout_s))

    async def go_to(
        self, places: Mapping[int, tuple[float, float, float]], *, timeout_s: float
    ) -> dict[int, CommandResult]:
        """Fly each straight to its (latitude, longitude in degrees, metres above home) and hover there.

        For gathering at the slot-0 points before `start`. Nothing checks that the straight lines keep apart.
        """
        return await self._command(places, lambda vehicle, place: departure.go_to(vehicle, *place, timeout_s))

    async def start(
        self, system_ids: Iterable[int], *, item: int | None = None, on_go: Callable[[], None] = lambda: None
    ) -> dict[int, CommandResult]:
        """Start the missions on board, all together: every vehicle has its item set before the first one starts.

        They begin with `item`, or with the item that a vehicle at its slot-0 point flies first (`Mission.start_item`).
        `on_go()` is called when the first one is commanded to start: setting items takes longer on a bad link.
        """

        def first(vehicle: Vehicle) -> int:
            return vehicle.start_item if item is None else item

        ids = list(system_ids)
        ready: dict[int, CommandResult] = {}
        for _ in range(SET_ITEM_TIMES):
            left = [system_id for system_id in ids if system_id not in ready or not ready[system_id].ok]
            ready |= await self._command(
                dict.fromkeys(left), lambda vehicle, _: flight.set_current(vehicle, first(vehicle))
            )
        able = [system_id for system_id in ids if ready[system_id].ok]
        on_go()
        return ready | await self._command(
            dict.fromkeys(able), lambda vehicle, _: departure.start(vehicle, first(vehicle))
        )

    async def swap(self, missions: Mapping[int, Mission]) -> dict[int, SwapResult]:
        """Replace missions in flight.

        Each result is `ok` (verified and flown), or says why not and whether it holds.
        """
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

    # -- before take-off ---------------------------------------------------------------------------------------------

    def facts(
        self,
        system_id: int,
        plan: Plan,
        uav_id: str,
        *,
        items: int,
        stream: bool = False,
        force_stream: bool = False,
        start_within_m: float = START_WITHIN_M,
    ) -> tuple[Facts, Needs]:
        """Return what the preflight audit compares: the vehicle as reported, and what the plan needs (see `Needs`).

        Raises KeyError if it was never heard, UnknownAutopilot if its autopilot has no profile.
        """
        vehicle, scenario = self._vehicles[system_id], plan.scenario
        uav, place, home = scenario.uav(uav_id), vehicle.state.place_deg, vehicle.state.home_deg
        facts = Facts(
            autopilot=self.autopilot(system_id),
            parameters=self.parameters.get(system_id, {}),
            model=self.model(system_id),
            mav_type=vehicle.state.mav_type,
            at_m=None if place is None else geodetic_to_east_north(scenario.origin, *place),
            home_m=None if home is None else geodetic_to_east_north(scenario.origin, *home),
            gps_fix=vehicle.state.gps_fix,
            satellites=vehicle.state.satellites,
            battery=vehicle.state.battery,
            battery_told=vehicle.state.battery_told,
            home_amsl_m=vehicle.state.home_amsl_m,
        )
        altitudes, home_amsl_m = altitudes_of(plan, uav_id), vehicle.state.home_amsl_m
        needs = Needs(
            path_m=list(plan.trajectories_m[uav_id]),
            slot_s=scenario.slot_duration_s,
            altitude_m=altitudes.highest_m - ((home_amsl_m or 0.0) if altitudes.amsl else 0.0),
            climb_m=climb_in_slot_m(plan, uav_id),
            ground=over_ground(plan, uav_id, facts.home_m),
            max_speed_mps=uav.max_speed_mps,
            items=items,
            max_items=MAX_ITEMS,
            stream=stream,
            force_stream=force_stream,
            start_within_m=start_within_m,
            lost_after_s=self.monitor.lost_after_s,
            battery_for_plan=charge_needed(plan, uav_id),
        )
        return facts, needs

    # -- inside ------------------------------------------------------------------------------------------------------

    async def _prepare(self, vehicle: Vehicle) -> None:
        await flight.ask_for_streams(vehicle)
        values = await read_parameters(vehicle, vehicle.profile.parameter_names())
        self.parameters[vehicle.system_id] = values
        self.models[vehicle.system_id] = vehicle.profile.model_of(values)

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
        """Return one result for each system id, all at once.

        `refuse(...)` makes that of a vehicle that is not heard.
        """
        self._open()

        async def one(system_id: int, request: Request) -> Outcome:
            vehicle = self._vehicles.get(system_id)
            if vehicle is None or not vehicle.heard:
                return refuse(
                    system_id=system_id, seconds=0.0, error=f"system {system_id} was never heard on this link"
                )
            if self._options.may_send is not None and not self._options.may_send(system_id):
                return refuse(
                    system_id=system_id, seconds=0.0, error=f"system {system_id} is not this service's to command now"
                )
            began_s = asyncio.get_running_loop().time()
            try:
                return await act(vehicle, request)
            except NotDone as failed:
                reason = str(failed)
            except Exception as broken:  # the others' results count all the same
                _LOGGER.exception("system %d: the request broke", system_id)
                reason = f"{type(broken).__name__}: {broken}"
            seconds = asyncio.get_running_loop().time() - began_s
            return refuse(system_id=system_id, seconds=seconds, error=reason)

        outcomes = await asyncio.gather(*(one(*request) for request in requests.items()))
        return dict(zip(requests, outcomes, strict=True))
