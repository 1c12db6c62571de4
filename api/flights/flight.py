"""One flight: the vehicles' side of an operation, its slot clock, and the record of where every UAV was."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from math import inf
from typing import Any

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.surroundings import monotonic_s
from skyfolio.api.fleet.commander import Action, OvertakenError
from skyfolio.api.fleet.registry import HEARD_WITHIN_S, Fleet
from skyfolio.api.flights.endless.horizon import Horizon
from skyfolio.api.flights.endless.pool import Pool
from skyfolio.api.flights.endless.terms import Terms
from skyfolio.api.flights.energy import EnergyWatch
from skyfolio.api.flights.flight_timeline import FlightTimeline
from skyfolio.api.flights.flown_rates import FlownRates
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.measured_rates import MeasuredRates
from skyfolio.api.flights.rates import InForce
from skyfolio.api.flights.roster import Roster
from skyfolio.api.flights.take_off import LOOK_EVERY_S, FlightError, TakeOff, in_words
from skyfolio.api.flights.track import Seen, Track
from skyfolio.api.flights.traffic import Traffic
from skyfolio.mavlink_bridge import Mission, OnEnd, Telemetry, VehiclesMissing, geodetic_to_east_north
from skyfolio.mavlink_bridge.results import CommandResult, SwapResult
from skyfolio.mavlink_bridge.verified import OnBoard
from skyfolio.planner import Plan
from skyfolio.planner.geometry import Point

SAMPLE_EVERY_S = 0.5
REPORTED_WITHIN_S = 3.0
"""Wall seconds within which a vehicle sends a MISSION_CURRENT, which comes at 1 Hz."""


class Flight(FlightTimeline):
    """Vehicles that fly a plan, and the plans that replaced it."""

    def __init__(
        self,
        plan: Plan,
        systems: dict[str, int],
        fleet: Fleet,
        clock: FleetClock,
        options: GuidanceOptions | None = None,
        terms: Terms | None = None,
        pool: Pool | None = None,
    ) -> None:
        super().__init__(plan, clock)
        self.pool = pool
        """The vehicles that relieve each other, if they do: those of the plan and others, which are on their pads."""
        self.horizon = None if terms is None else Horizon(terms, self, clock)
        """How far ahead it is planned, if it has no fixed end."""
        self.systems = systems
        self.fleet = self._fleet = fleet
        self._uavs = {system: uav for uav, system in systems.items()}
        self._pads_m = {uav.id: uav.start_m for uav in (plan.scenario.uavs if pool is None else pool.uavs.values())}
        self.guidance = FlightGuidance(
            systems,
            fleet,
            clock,
            elapsed_s=self.now_s,
            homes_m=self._pads_m,
            rally_m=plan.scenario.rally_m,
            options=options,
        )
        self.energy = EnergyWatch(lambda: self.plan, self.elapsed_s, self.telemetry)
        self.roster = Roster(
            systems,
            plan.scenario.origin,
            fleet,
            self.guidance,
            now_s=self.now_s,
            last_slot_s=self.last_slot_s,
            slot_s=self.slot_s,
            lacking=self.energy.lacking,
        )
        first = {uav: systems[uav] for uav in plan.scenario.uav_ids}
        self.take_off = TakeOff(plan, first, fleet, clock, self.guidance)
        self.traffic: Traffic | None = None
        """What it knows of other flights, once it has entered the shared airspace."""
        self._record = Track(systems)
        self._rates = FlownRates(self._record, plan.scenario.user_ids, self.n_slots, self.slot_s)
        self.measured = MeasuredRates(self, self._record, lambda: self.lost)
        """What users were measured to get."""

    # --- commands ---

    def begin(self, began_s: float) -> None:
        """Guide from now on: slot 0 began at this fleet second."""
        self._began = began_s
        self.guidance.begin()

    async def swap(self, uav: str, mission: Mission, *, streamed_m: Sequence[Point] | None = None) -> str | None:
        """Replace a mission in flight; return None if the UAV verifiably flies the new one, else what went wrong.

        streamed_m: a UAV that is guided by setpoints goes on so, by this path, metres east/north from the mission's
        first slot on, and the mission only replaces the one on board; None flies the mission from now on.
        An order of the operator ends it at once; then it is not known which of the two missions is on board.
        """
        if not self.roster.may_command(uav):
            self.guidance.record_on_board(uav, mission, OnBoard.OLD)
            return "left alone: it is lost, or flown by somebody else"
        try:
            stays = streamed_m is not None and self.guidance.streams_to(uav)
            work = self._replace_below(uav, mission) if stays else self._swap(uav, mission)
            result = await self._fleet.commander.carry_out(self.systems[uav], work)
        except OvertakenError as error:
            self.guidance.record_on_board(uav, mission, OnBoard.UNKNOWN)
            return str(error)
        sent = result.upload.attempts > 0
        self.guidance.record_on_board(uav, mission, result.upload.on_board if sent else OnBoard.OLD)
        if result.ok and self.roster.may_command(uav):
            self.guidance.follow(uav, mission)
            if stays and streamed_m is not None:
                self.guidance.go_on_streaming(uav, mission, streamed_m)
        return None if result.ok else f"{result.error or 'failed'}{'; its old mission goes on' * result.went_on}"

    async def _swap(self, uav: str, mission: Mission) -> SwapResult:
        await self.guidance.end_stream([uav])
        system = self.systems[uav]
        return (await self._fleet.link.swap({system: mission}))[system]

    async def _replace_below(self, uav: str, mission: Mission) -> SwapResult:
        """Replace the mission on board of a UAV that is guided by setpoints."""
        self.guidance.unguard(uav)
        system = self.systems[uav]
        upload = (await self._fleet.link.upload({system: mission}))[system]
        error = None if upload.verified else upload.error or "not verified"
        return SwapResult(system_id=system, seconds=upload.seconds, error=error, upload=upload)

    def stop(self) -> list[str]:
        """Stop guiding and commanding every UAV at once: the operation is over.

        Return those that may be sent a last order.
        """
        commandable = [uav for uav in self.still_up() if self.roster.is_ours(uav)]
        self.roster.stopped = True
        self.guidance.leave_all()
        return commandable

    async def hover(self) -> dict[str, str | None]:
        """Hold every vehicle that may be commanded; return what went wrong with each, None if nothing did.

        Every vehicle is ordered at once: none waits for another, nor for what the end of a stream would send it first.
        """
        self.guidance.drop_stream()
        commandable = [uav for uav in self.still_up() if self.roster.may_command(uav)]
        return self._by_uav(await self._fleet.commander.each(self._fleet.link.hold, self._systems_of(commandable)))

    async def order(self, action: Action, uavs: Collection[str]) -> dict[str, str | None]:
        """Hold, land or return these before whatever else is sent to them; return each one's error, or None."""
        return self._by_uav(await self._fleet.commander.order(action, self._systems_of(uavs)))

    async def bring_down(self, uavs: Collection[str], *, home: bool) -> dict[str, str | None]:
        """Land these UAVs where they are, or return them; return what went wrong with each, or None."""
        link = self._fleet.link
        command = link.return_home if home else link.land
        return self._by_uav(await self._fleet.commander.each(command, self._systems_of(uavs)))

    def _systems_of(self, uavs: Collection[str]) -> list[int]:
        return [self.systems[uav] for uav in uavs]

    def _by_uav(self, errors: Mapping[int, str | None]) -> dict[str, str | None]:
        return {self._uavs[system]: error for system, error in errors.items()}

    async def pause(self) -> None:
        """Let every vehicle hover. Raises FlightError with each vehicle that does not."""
        failed = {uav: error for uav, error in (await self.hover()).items() if error}
        if failed:
            raise FlightError(f"hold failed for {in_words(failed)}")

    async def resume(self) -> None:
        """Fly on from the item at which each vehicle was. Raises FlightError with each vehicle that does not."""
        await self.fly_on([uav for uav in self.still_up() if self.roster.may_command(uav)])

    async def fly_on(self, uavs: Collection[str]) -> None:
        """Put these UAVs into mission mode at the item that is current on board. Raises FlightError."""
        link = self._fleet.link

        async def start(systems: list[int]) -> dict[int, CommandResult]:
            telemetry = link.telemetry(systems[0])
            return await link.start(systems, item=(telemetry.mission_current if telemetry else None) or 0)

        errors = self._by_uav(await self._fleet.commander.each(start, self._systems_of(uavs)))
        failed = {uav: error for uav, error in errors.items() if error}
        if failed:
            raise FlightError(f"start failed for {in_words(failed)}")

    async def wait_until_heard(self) -> None:
        """Wait after a restart until the surviving vehicles have reported what they fly.

        A vehicle that is silent is declared lost in time.
        """
        self.guidance.expect_holds()
        with suppress(VehiclesMissing):
            await self._fleet.link.wait_for({self.systems[uav] for uav in self.surviving()}, timeout_s=HEARD_WITHIN_S)
        self.guidance.suspect_speeds()
        until = monotonic_s() + REPORTED_WITHIN_S
        while monotonic_s() < until and not all(map(self._has_reported_mission, self.surviving())):  # noqa: ASYNC110
            await asyncio.sleep(LOOK_EVERY_S)

    def _has_reported_mission(self, uav: str) -> bool:
        """Return whether a MISSION_CURRENT of the UAV was received, or nothing at all."""
        telemetry = self.telemetry(uav)
        if telemetry is None:
            return not self._fleet.link.is_heard(self.systems[uav])
        return telemetry.mission_current is not None

    def telemetry(self, uav: str) -> Telemetry | None:
        """Return what the vehicle last reported, its mission included; None before the first report."""
        return self._fleet.link.telemetry(self.systems[uav])

    def silent_s(self, uav: str) -> float:
        """Return for how many fleet seconds a vehicle was not heard; infinite if it never was."""
        heard = self._fleet.heard().get(self.systems[uav])
        return inf if heard is None else heard.silent_for_s

    def in_our_mode(self, uav: str) -> bool:
        """Return whether the vehicle was last seen in a mode in which the service may command it."""
        return self._fleet.link.is_ours(self.systems[uav])

    def note(self, kind: str, **data: Any) -> None:
        """Add an event about a vehicle to the log."""
        self._fleet.note(kind, **data)

    def hovers(self, uav: str) -> bool:
        """Return whether the UAV waits for orders, or for setpoints that are no longer sent."""
        telemetry = self.telemetry(uav)
        if telemetry is None or not telemetry.armed or not self.in_our_mode(uav):
            return False
        profile = self._fleet.link.profile(self.systems[uav])
        if telemetry.mode is profile.stream_mode:
            return not self.guidance.is_streaming
        return telemetry.mode is profile.hold_mode

    def recorded(self, name: str) -> AbstractContextManager[None]:
        """Keep a telemetry log of this name meanwhile, if the service keeps logs."""
        return self._fleet.recorded(name)

    # --- who is there ---

    def surviving(self) -> list[str]:
        """Return the UAVs that are not declared lost, in the order of the first plan."""
        return [uav for uav in self.systems if uav not in self.lost]

    @property
    def lost(self) -> dict[str, float]:
        """Return the UAVs that are lost, and since when."""
        return self.roster.lost

    @property
    def returned(self) -> set[str]:
        """Return the UAVs that were lost and are heard again."""
        return self.roster.returned

    def positions_m(self) -> dict[str, Point]:
        """Return where each UAV that knows its position was last heard, metres east/north of the scenario's origin."""
        return self.roster.positions_m()

    def altitudes_m(self) -> dict[str, float]:
        """Return how high each UAV was last heard to be, metres above mean sea level."""
        heard = {uav: self.telemetry(uav) for uav in self.systems}
        return {uav: telemetry.altitude_amsl_m for uav, telemetry in heard.items() if telemetry is not None}

    def heights_m(self) -> dict[str, float]:
        """Return how high each UAV was last heard to be, metres in the datum of its plan's altitudes."""
        if self.first_plan.scenario.terrain is not None:
            return self.altitudes_m()
        heard = {uav: self.telemetry(uav) for uav in self.systems}
        return {uav: telemetry.relative_alt_m for uav, telemetry in heard.items() if telemetry is not None}

    def still_up(self) -> list[str]:
        """Return the surviving UAVs that have not landed."""
        return [uav for uav in self.surviving() if not self.roster.has_landed(uav)]

    def home_m(self, uav: str) -> Point:
        """Return where a UAV returns to, metres east/north: the home that it reported, else its start in the plan."""
        scenario = self.first_plan.scenario
        home = self._fleet.link.home_deg(self.systems[uav])
        return self._pads_m[uav] if home is None else geodetic_to_east_north(scenario.origin, *home)

    def landing_m(self, uav: str) -> tuple[Point, ...]:
        """Return where a return of a UAV may end, metres east/north: its home and the rally points."""
        return (self.home_m(uav), *self.first_plan.scenario.rally_m)

    def ends_m(self, uav: str) -> tuple[Point, ...]:
        """Return the places on the ground where a UAV's plan may end, metres east/north.

        UAVs land instead of returning where their ways home would meet, so there may be two.
        """
        path = self.plan.trajectories_m.get(uav)
        if path is None or self.guidance.options.at_end is OnEnd.HOLD:
            return ()
        returns = self.guidance.options.at_end is OnEnd.RETURN
        return (path[-1], *self.landing_m(uav)) if returns else (path[-1],)

    def over(self, landing_limit_s: float) -> bool:
        """Return whether there is no landing left to wait for.

        That is so when every UAV that counts, and every other that is coming down, has landed; or landing_limit_s fleet
        seconds after the last slot. Before that somebody of a pool may yet fly.
        """
        if self.pool is not None and not self.past_last_slot() and self.pool.can_go_on():
            return False
        return (
            not (self.still_up() or self.roster.coming_down())
            or self.now_s() > self.n_slots * self.slot_s + landing_limit_s
        )

    # --- the record ---

    def restore(self, record: Iterable[Seen]) -> None:
        """Take over the record of positions from before a restart."""
        for at_s, positions_m in record:
            self._record.append(at_s, positions_m)
            self.roster.remember(positions_m)

    def recall_who_flew(self) -> None:
        """Tell the fleet who flew the plan when it was last heard, as the record from before a restart has it.

        It is not known when that was where the slot clock stands still.
        """
        for uav in self.surviving():
            at_s = self._record.still_since_s(uav)
            if at_s is not None and at_s < self.last_slot_s(uav):
                altitude_m = self.plan.scenario.altitude_of(self.newest_uav(uav))
                at_s = max(at_s, self._record.at_s(-1) - self._fleet.link.monitor.lost_after_s)  # else it were lost
                ago_s = inf if self.paused else self.now_s() - at_s
                self._fleet.was_flying(self.systems[uav], altitude_m, ago_s)

    @property
    def record(self) -> Track:
        """Return (fleet seconds, metres east/north of each UAV heard), the oldest first."""
        return self._record

    def sample(self) -> None:
        """Record where every UAV is, at most twice a fleet second, and evaluate what users got there."""
        now = self.now_s()
        if not self._record or now - self._record.at_s(-1) >= SAMPLE_EVERY_S:
            self._record.append(now, self.positions_m())
        self._rates.work(self.serving, self.lost)

    async def settle_rates(self) -> None:
        """Evaluate what users got at every sample that still waits for it, and let other tasks run meanwhile."""
        await self._rates.settle(self.serving, self.lost)

    def modelled_rates_bps(self) -> Mapping[str, Sequence[float | None]]:
        """Return the bit/s of each user in each slot by the plans' channel model at the reported positions.

        Rows begin with slot `rates_from_slot`.
        """
        return self._rates.by_user

    def reported_rates_bps(self) -> Mapping[str, Sequence[float | None]]:
        """Return the bit/s of each user in each slot from `rates_from_slot` on; None for those not evaluated (yet).

        They are what was measured in slots in which something was, else what the channel model says at the reported
        positions.
        """
        return self.measured.over(self._rates.by_user, self._rates.first_slot)

    @property
    def rates_from_slot(self) -> int:
        """Return the slot of the operation with which the rows of rates begin: 0, unless older ones are forgotten."""
        return self._rates.first_slot

    @property
    def uav_ids(self) -> Sequence[str]:
        """Return every UAV that may fly in the operation."""
        return [*self.systems]

    def take_over_since(self, from_s: float, plan: Plan) -> None:
        """Put this plan into force from that fleet second on."""
        super().take_over_since(from_s, plan)
        self._rates.cover(self.n_slots)

    def restore_plans(self, timeline: Sequence[InForce]) -> None:
        """Take over from before a restart which plans were in force since when, the first plan first."""
        super().restore_plans(timeline)
        self._rates.cover(self.n_slots)

    def forget_before(self, slot: int) -> list[Plan]:
        """Forget rates, places and plans from before this slot; return the plans that are no longer needed."""
        self._rates.forget_before(slot)
        self.measured.forget_before(slot)
        self._record.forget_before(slot * self.slot_s)
        return self.forget_plans_before(slot * self.slot_s)
