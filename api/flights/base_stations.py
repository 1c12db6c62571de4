"""Joins the base stations of a simulated fleet to the operation that flies it, as an integrator joins real ones.

Again and again they ask what they must serve (`operations/{id}/allocations`), acknowledge what they are ready for, and
report what their users get. What users truly get is the simulator's (`sim.RadioTruth`): the service knows of it only
by those reports.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from skyfolio import sim
from skyfolio.api.common.errors import ConflictError
from skyfolio.api.flights.allocations import AllocationsView, SlotAllocation, UavAllocation
from skyfolio.api.flights.measured_rates import LEAST_DB, Measurement
from skyfolio.api.flights.operations import Operations
from skyfolio.mavlink_bridge import east_north_to_geodetic, geodetic_to_east_north
from skyfolio.planner import Channel, Scenario
from skyfolio.planner.ground.hidden import edges_of

ASK_EVERY_S = 0.2
"""Fleet seconds between two looks of base stations at what they must serve."""


class RadioPort(Protocol):
    """How base stations reach the service."""

    def allocations(self) -> Awaitable[AllocationsView | None]:
        """Return what they must serve; None if there is nothing to serve any more, or no answer."""
        ...

    def acknowledge(self, uav_id: str, revision: int) -> Awaitable[bool]:
        """Acknowledge a revision; return whether that was accepted."""
        ...

    def measure(self, measurements: Sequence[Measurement]) -> Awaitable[None]:
        """Report what users get."""
        ...


class OperationPort:
    """Reaches an operation of this service, as REST clients do over HTTP."""

    def __init__(self, operations: Operations, operation_id: str) -> None:
        self._operations, self._id = operations, operation_id

    async def allocations(self) -> AllocationsView | None:
        """Return what base stations must serve; None once the operation has ended."""
        operation = self._operations.active(self._id)
        return None if operation is None else operation.radio.allocations.view()

    async def acknowledge(self, uav_id: str, revision: int) -> bool:
        """Acknowledge a revision; return whether that was accepted: it may be stale by now."""
        operation = self._operations.active(self._id)
        try:
            return operation is not None and bool(operation.radio.allocations.acknowledge(uav_id, revision))
        except ConflictError:
            return False

    async def measure(self, measurements: Sequence[Measurement]) -> None:
        """Report what users get, unless the operation has ended."""
        operation = self._operations.active(self._id)
        if operation is not None:
            operation.radio.measure(measurements)


@dataclass
class Log:
    """What users truly got: (fleet seconds since slot 0, bit/s by user), and how many acknowledgements were refused."""

    rates_bps: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    refused: int = 0


def radio_truth(
    fleet: sim.Fleet,
    scenario: Scenario,
    channel: sim.TruthChannel | None = None,
    system_of: Mapping[str, int] | None = None,
) -> sim.RadioTruth:
    """Return what the users of a scenario get from a fleet.

    channel: by default what planners of the scenario assume. system_of: the system id of each UAV; by default 1, 2, ...
    in their order.
    """
    systems = system_of or {uav: number for number, uav in enumerate(scenario.uav_ids, start=1)}
    given = channel or assumed_by(scenario)
    places = {user.id: east_north_to_geodetic(scenario.origin, *user.position_m) for user in scenario.users}
    power_w = {systems[uav.id]: uav.transmit_power_w for uav in scenario.uavs}
    noise_dbm = None
    if scenario.channel.noise_figure_db is not None:
        noise_w = scenario.channel.noise_w(np.array([uav.bandwidth_hz for uav in scenario.uavs]))
        noise_dbm = dict(
            zip((systems[uav] for uav in scenario.uav_ids), (10 * np.log10(noise_w) + 30).tolist(), strict=True)
        )
    mean_gain = None
    if scenario.terrain is not None or not scenario.channel.is_inverse_square:
        mean_gain = mean_gain_of(scenario, {system: uav for uav, system in systems.items()})
    return sim.RadioTruth(fleet, given, places, power_w, noise_dbm, mean_gain)


def assumed_by(scenario: Scenario, drawn: sim.TruthChannel | None = None) -> sim.TruthChannel:
    """Return the channel that planners of the scenario assume, with what `drawn` has of bias, shadowing and fading."""
    assumed = scenario.channel
    made = drawn or sim.TruthChannel()
    if assumed.noise_dbm is not None:
        made = replace(made, noise_dbm=assumed.noise_dbm)
    if isinstance(assumed, Channel):
        made = replace(made, reference_gain_db=assumed.reference_gain_db)
    return made


def mean_gain_of(scenario: Scenario, uav_of: Mapping[int, str]) -> sim.MeanGain:
    """Return the mean gain of links by the scenario's channel and terrain. uav_of: the UAV of each system id."""
    channel, terrain = scenario.channel, scenario.terrain
    users_m = {user.id: user.position_m for user in scenario.users}
    homes_m = {system: scenario.uav(uav).home_m or scenario.uav(uav).start_m for system, uav in uav_of.items()}

    def over_user_m(system: int, user: str) -> float:
        """Return how high a UAV's home is above a user."""
        return 0.0 if terrain is None else terrain.height_at(*homes_m[system]) - terrain.height_at(*users_m[user])

    def gain(system: int, user: str, position: tuple[float, float, float]) -> float:
        at_m, user_m = geodetic_to_east_north(scenario.origin, *position[:2]), users_m[user]
        height_m = position[2] + over_user_m(system, user)
        edge = edges_of(scenario, np.array([[user_m]]), np.array([[at_m]]), np.array([[[height_m]]]))
        places_m = np.array(user_m), np.array(at_m)
        return channel.gain_at(math.dist(at_m, user_m), height_m, edge, places_m)

    return gain


class BaseStations:
    """The base stations of one fleet in one operation. system_of: the system id of each UAV.

    report: whether they measure and report; measure_every_s: how often, in fleet seconds. keep: whether to log what
    users get at every step.
    """

    def __init__(
        self,
        fleet: sim.Fleet,
        truth: sim.RadioTruth,
        port: RadioPort,
        system_of: Mapping[str, int],
        *,
        report: bool = True,
        measure_every_s: float = 1.0,
        keep: bool = False,
    ) -> None:
        self._fleet, self._truth, self._port, self._system_of = fleet, truth, port, dict(system_of)
        self._uav_of = {system: uav for uav, system in system_of.items()}
        self._report, self._measure_every_s, self._keep = report, measure_every_s, keep
        self._measure_at_s = 0.0
        self._revision: int | None = None
        self.log = Log()

    async def step(self) -> bool:
        """Ask, acknowledge, and report once; return whether there is anything left to serve."""
        view = await self._port.allocations()
        if view is None:
            return False
        if self._revision is None:
            self._join()
        if view.revision != self._revision and view.elapsed_s is not None:  # before slot 0 there is no time to serve by
            self._revision = view.revision
            self._tell(view)
        for uav, system in self._system_of.items():
            station = self._fleet.vehicles[system].base_station
            revision = station.ready(self._fleet.now_s)
            if revision is None or not self._is_reached(system):
                continue
            if await self._port.acknowledge(uav, revision):
                station.acknowledge(revision)
            else:
                self.log.refused += 1
        await self._measure(view)
        return True

    def _join(self) -> None:
        self._revision = -1
        for system in self._system_of.values():
            self._fleet.vehicles[system].base_station.join()

    def _is_reached(self, system: int) -> bool:
        """Return whether the link on board works, over which base stations are reached too."""
        vehicle = self._fleet.vehicles[system]
        return vehicle.alive and vehicle.transmitting

    def _tell(self, view: AllocationsView) -> None:
        """Let every base station receive what it must serve; slots begin and end by the fleet's clock."""
        now_s = self._fleet.now_s
        slot0_s = now_s - (view.elapsed_s or 0.0)
        for uav, allocation in view.uavs.items():
            system = self._system_of[uav]
            if self._is_reached(system):
                slots = held(allocation, now_s) if view.paused else served(allocation, slot0_s)
                self._fleet.vehicles[system].base_station.hear(view.revision, slots, now_s)

    async def _measure(self, view: AllocationsView) -> None:
        elapsed_s = view.elapsed_s
        if elapsed_s is None:
            return
        is_due = self._report and elapsed_s >= self._measure_at_s
        received = self._truth.received() if is_due or self._keep else []
        if self._keep:
            self.log.rates_bps.append((elapsed_s, {one.user_id: one.rate_bps for one in received}))
        if not is_due:
            return
        self._measure_at_s = elapsed_s + self._measure_every_s
        measured = self._reports(view, received, round(elapsed_s, 3))
        if measured:
            await self._port.measure(measured)

    def _reports(self, view: AllocationsView, received: Sequence[sim.Received], elapsed_s: float) -> list[Measurement]:
        """Return what base stations that are reached report: their users' rates, 0 of those that get nothing."""
        got = {(self._uav_of[one.system_id], one.user_id): one for one in received}
        meant = {
            (uav, user)
            for uav, allocation in view.uavs.items()
            if allocation.now is not None
            for user in allocation.now.bandwidth_hz
        }
        served_users = {user for _, user in got}
        missed = {link for link in meant if link[1] not in served_users}
        return [
            Measurement(
                uav_id=uav,
                user_id=user,
                elapsed_s=elapsed_s,
                rate_bps=got[uav, user].rate_bps if (uav, user) in got else 0.0,
                sinr_db=max(got[uav, user].sinr_db, LEAST_DB) if (uav, user) in got else None,
            )
            for uav, user in sorted({*got, *missed})
            if self._is_reached(self._system_of[uav])
        ]


def held(allocation: UavAllocation, now_s: float) -> list[sim.Served]:
    """Return what is served while an operation is paused: its clock stands still, and what is valid stays so."""
    now = allocation.now
    return [] if now is None else [sim.Served(now_s, math.inf, now.bandwidth_hz, now.sends)]


def served(allocation: UavAllocation, slot0_s: float) -> list[sim.Served]:
    """Return an allocation as the simulator's base station takes it; slot0_s: fleet second in which slot 0 began."""
    slots: list[SlotAllocation] = [slot for slot in (allocation.now, allocation.next) if slot is not None]
    return [
        sim.Served(slot0_s + slot.valid_from_s, slot0_s + slot.valid_until_s, slot.bandwidth_hz, slot.sends)
        for slot in slots
    ]
