"""One flight: the vehicles' side of an operation, its slot clock, and the record of who was where."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from typing import Any

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.commander import Action, OvertakenError
from skyfolio.api.fleet.registry import HEARD_WITHIN_S, Fleet
from skyfolio.api.flights.flown_rates import FlownRates
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.rates import InForce, Point
from skyfolio.api.flights.roster import Roster
from skyfolio.api.flights.take_off import LOOK_EVERY_S, FlightError, TakeOff, each
from skyfolio.api.flights.track import Seen, Track
from skyfolio.api.flights.traffic import Traffic
from skyfolio.mavlink_bridge import Autopilot, Mission, OnEnd, Telemetry, VehiclesMissing, geodetic_to_east_north
from skyfolio.mavlink_bridge.autopilots import HOLD_MODE, STREAM_MODE
from skyfolio.mavlink_bridge.results import CommandResult, SwapResult
from skyfolio.mavlink_bridge.verified import OnBoard
from skyfolio.planner import Plan

SAMPLE_EVERY_S = 0.5
TOLD_WITHIN_S = 3.0
"""Wall seconds that a vehicle has to send a MISSION_CURRENT, which comes at 1 Hz."""


class Flight:
    """Vehicles that fly a plan, and the plans that replaced it. Times are fleet seconds since slot 0 began."""

    def __init__(
        self,
        plan: Plan,
        systems: dict[str, int],
        fleet: Fleet,
        clock: FleetClock,
        options: GuidanceOptions | None = None,
    ) -> None:
        self.systems = systems
        self.timeline = [InForce(0.0, plan)]
        self._fleet, self._clock = fleet, clock
        self._uavs = {system: uav for uav, system in systems.items()}
        homes_m = {uav: path[0] for uav, path in plan.trajectories_m.items()}
        self.guidance = FlightGuidance(systems, fleet, clock, elapsed_s=self.now_s, homes_m=homes_m, options=options)
        self.roster = Roster(
            systems,
            plan.scenario.origin,
            fleet,
            self.guidance,
            now_s=self.now_s,
            last_change_s=(plan.scenario.slots - 2) * plan.scenario.slot_duration_s,
            last_slot_s=(plan.scenario.slots - 1) * plan.scenario.slot_duration_s,
        )
        self.take_off = TakeOff(plan, systems, fleet, clock, self.guidance)
        self.traffic: Traffic | None = None
        """What it knows of other flights, once it has entered their airspace."""
        self._began: float | None = None
        self._frozen_s: float | None = None
        self._record = Track(systems)
        self._rates = FlownRates(self._record, plan.scenario.user_ids, self.n_slots, self.slot_s)

    # --- the plan and its clock ---

    @property
    def first_plan(self) -> Plan:
        """The plan of the whole fleet that the operation began with."""
        return self.timeline[0].plan

    @property
    def plan(self) -> Plan:
        """The plan in force."""
        return self.timeline[-1].plan

    @property
    def n_slots(self) -> int:
        """Slots of the whole operation."""
        return self.first_plan.scenario.slots

    @property
    def slot_s(self) -> float:
        """Slot duration in fleet seconds."""
        return self.first_plan.scenario.slot_duration_s

    def elapsed_s(self) -> float | None:
        """Fleet seconds since slot 0 began, None before. They stand still while the flight is paused."""
        if self._frozen_s is not None:
            return self._frozen_s
        return None if self._began is None else self._clock.now() - self._began

    @property
    def paused(self) -> bool:
        """Whether the slot clock stands still."""
        return self._frozen_s is not None

    def set_slot_clock(self, elapsed_s: float, *, paused: bool = False) -> None:
        """Set the slot clock: after a pause, or after a restart of the service."""
        self._began = self._clock.now() - elapsed_s
        self._frozen_s = elapsed_s if paused else None

    def restore(self, record: Iterable[Seen]) -> None:
        """Take over the record of who was where from before a restart."""
        for at, where in record:
            self._record.append(at, where)

    @property
    def record(self) -> Track:
        """(fleet seconds, metres east/north of each UAV heard), the oldest first."""
        return self._record

    def now_s(self) -> float:
        """As `elapsed_s`, for a flight that has begun."""
        return self.elapsed_s() or 0.0

    def slot(self) -> int | None:
        """The slot that lasts now, None before the first and after the last."""
        elapsed = self.elapsed_s()
        if elapsed is None or elapsed >= self.n_slots * self.slot_s:
            return None
        return int(elapsed // self.slot_s)

    def past_last_slot(self) -> bool:
        """Whether every slot is over."""
        return self.now_s() >= self.n_slots * self.slot_s

    # --- commands ---

    def begin(self, began_s: float) -> None:
        """Slot 0 began at this fleet second: guide."""
        self._began = began_s
        self.guidance.begin()

    async def swap(self, uav: str, mission: Mission) -> str | None:
        """Replace a mission in flight; None when the UAV verifiably flies the new one, else what went wrong.

        An order of the operator ends it at once; then it is not known which of the two is on board.
        """
        if not self.roster.may_command(uav):
            self.guidance.record_on_board(uav, mission, OnBoard.OLD)
            return "not ours to command any more, and left alone"
        try:
            result = await self._fleet.commander.carry_out(self.systems[uav], self._swap(uav, mission))
        except OvertakenError as error:
            self.guidance.record_on_board(uav, mission, OnBoard.UNKNOWN)
            return str(error)
        sent = result.upload.attempts > 0
        self.guidance.record_on_board(uav, mission, result.upload.on_board if sent else OnBoard.OLD)
        if result.ok and self.roster.may_command(uav):
            self.guidance.follow(uav, mission)
        return None if result.ok else f"{result.error or 'failed'}{'; its old mission goes on' * result.went_on}"

    async def _swap(self, uav: str, mission: Mission) -> SwapResult:
        await self.guidance.end_stream([uav])
        system = self.systems[uav]
        return (await self._fleet.link.swap({system: mission}))[system]

    def stop(self) -> list[str]:
        """The operation is over, now: nobody is guided or commanded any more; who may be given a last order."""
        left = [uav for uav in self.still_up() if self.roster.is_ours(uav)]
        self.roster.stopped = True
        self.guidance.leave_all()
        return left

    async def hover(self) -> dict[str, str | None]:
        """Hold every vehicle that may be commanded; what went wrong with each, None when it does.

        Each is told at once: nobody waits for another one, nor for what a stream would do first.
        """
        self.guidance.drop_stream()
        ours = [uav for uav in self.still_up() if self.roster.may_command(uav)]
        return self._by_uav(await self._fleet.commander.each(self._fleet.link.hold, self._systems_of(ours)))

    async def order(self, action: Action, uavs: Collection[str]) -> dict[str, str | None]:
        """Hold, land or return these before whatever else is sent to them; what went wrong with each, or None."""
        return self._by_uav(await self._fleet.commander.order(action, self._systems_of(uavs)))

    async def bring_down(self, uavs: Collection[str], *, home: bool) -> dict[str, str | None]:
        """Land these where they are, or return them; what went wrong with each, None when it is on its way."""
        link = self._fleet.link
        command = link.return_home if home else link.land
        return self._by_uav(await self._fleet.commander.each(command, self._systems_of(uavs)))

    def _systems_of(self, uavs: Collection[str]) -> list[int]:
        return [self.systems[uav] for uav in uavs]

    def _by_uav(self, errors: Mapping[int, str | None]) -> dict[str, str | None]:
        return {self._uavs[system]: error for system, error in errors.items()}

    async def pause(self) -> None:
        """Hover. Raises FlightError with each vehicle that does not."""
        bad = {uav: error for uav, error in (await self.hover()).items() if error}
        if bad:
            raise FlightError(f"hold failed for {each(bad)}")

    async def resume(self) -> None:
        """Fly on from the item each vehicle was at. Raises FlightError with each vehicle that does not."""
        await self.fly_on([uav for uav in self.still_up() if self.roster.may_command(uav)])

    async def fly_on(self, uavs: Collection[str]) -> None:
        """Enter mission mode at the item that is current on board. Raises FlightError."""

        link = self._fleet.link

        async def start(systems: list[int]) -> dict[int, CommandResult]:
            said = link.telemetry(systems[0])
            return await link.start(systems, item=(said.mission_current if said else None) or 0)

        errors = self._by_uav(await self._fleet.commander.each(start, self._systems_of(uavs)))
        bad = {uav: error for uav, error in errors.items() if error}
        if bad:
            raise FlightError(f"start failed for {each(bad)}")

    async def wait_until_heard(self) -> None:
        """After a restart: wait until those who should be there have told what they fly.

        Who is silent is declared lost in time.
        """
        with suppress(VehiclesMissing):
            await self._fleet.link.wait_for({self.systems[uav] for uav in self.surviving()}, timeout_s=HEARD_WITHIN_S)
        self.guidance.suspect_speeds()
        until = time.monotonic() + TOLD_WITHIN_S
        while time.monotonic() < until and not all(map(self._has_told, self.surviving())):  # noqa: ASYNC110
            await asyncio.sleep(LOOK_EVERY_S)

    def _has_told(self, uav: str) -> bool:
        """Whether a MISSION_CURRENT of it was heard, or nothing at all."""
        said = self.telemetry(uav)
        return said is None or said.mission_current is not None

    def telemetry(self, uav: str) -> Telemetry | None:
        """What the vehicle last said, its mission included."""
        return self._fleet.link.telemetry(self.systems[uav])

    def autopilot(self, uav: str) -> Autopilot:
        """Which autopilot it has."""
        return self._fleet.link.autopilot(self.systems[uav])

    def note(self, kind: str, **data: Any) -> None:
        """Add an event about a vehicle to the log."""
        self._fleet.note(kind, **data)

    def hovers(self, uav: str) -> bool:
        """Return whether it last said that it waits for orders, or for setpoints that nobody sends any more."""
        said = self.telemetry(uav)
        if said is None or not said.armed:
            return False
        autopilot = self.autopilot(uav)
        waits = {HOLD_MODE[autopilot], STREAM_MODE[autopilot]}
        return said.mode in waits and not (said.mode is STREAM_MODE[autopilot] and self.guidance.is_streaming)

    def recorded(self, name: str) -> AbstractContextManager[None]:
        """Keep a telemetry log of this name meanwhile, if the service keeps logs."""
        return self._fleet.recorded(name)

    def take_over(self, plan: Plan) -> None:
        """From now on users and vehicles follow this plan."""
        self.timeline.append(InForce(self.now_s(), plan))

    # --- who is there ---

    def surviving(self) -> list[str]:
        """UAVs not declared lost, in the order of the first plan."""
        return [uav for uav in self.systems if uav not in self.lost]

    @property
    def lost(self) -> dict[str, float]:
        """UAVs that are lost, and since when."""
        return self.roster.lost

    @property
    def returned(self) -> set[str]:
        """UAVs that were lost and are heard again."""
        return self.roster.returned

    def positions_m(self) -> dict[str, Point]:
        """Where each UAV that knows its place was last heard, metres east/north of the scenario's origin."""
        return self.roster.positions_m()

    def still_up(self) -> list[str]:
        """Surviving UAVs that have not landed."""
        return [uav for uav in self.surviving() if not self.roster.is_down(uav)]

    def home_m(self, uav: str) -> Point:
        """Where it returns to, metres east/north: the home it told of, else its start in the plan."""
        scenario = self.first_plan.scenario
        home = self._fleet.link.home_deg(self.systems[uav])
        return scenario.uav(uav).start_m if home is None else geodetic_to_east_north(scenario.origin, *home)

    def ends_m(self, uav: str) -> tuple[Point, ...]:
        """Where the plan may end for it on the ground: UAVs land instead of returning where ways home would meet."""
        path = self.plan.trajectories_m.get(uav)
        if path is None or self.guidance.options.at_end is OnEnd.HOLD:
            return ()
        return (path[-1], self.home_m(uav)) if self.guidance.options.at_end is OnEnd.RETURN else (path[-1],)

    def over(self, landing_limit_s: float) -> bool:
        """Whether there is nothing left to wait for: who counts is down, and who left the plan too, if it is coming."""
        return (
            not (self.still_up() or self.roster.coming_down())
            or self.now_s() > self.n_slots * self.slot_s + landing_limit_s
        )

    # --- the record ---

    def sample(self) -> None:
        """Record where everyone is, at most twice a fleet second, and work out what users got there."""
        now = self.now_s()
        if not self._record or now - self._record.at_s(-1) >= SAMPLE_EVERY_S:
            self._record.append(now, self.positions_m())
        self._rates.work(self.timeline, self.lost)

    async def settle_rates(self) -> None:
        """Work out what users got at every sample that still waits for it, and let others take turns meanwhile."""
        await self._rates.settle(self.timeline, self.lost)

    def reported_rates_bps(self) -> Mapping[str, Sequence[float | None]]:
        """Rates of each user in each slot from reported positions; None for slots not (yet) recorded or worked out."""
        return self._rates.by_user
