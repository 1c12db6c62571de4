"""Guidance of one flight: missions kept on the slot clock, or a stream of setpoints with the missions behind it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.assigned_missions import AssignedMission, MissionBook
from skyfolio.api.flights.missions_on_board import MissionsOnBoard
from skyfolio.api.flights.setpoint_streams import Streaming
from skyfolio.mavlink_bridge import Mission, OnEnd, ReturnPathsTooClose, check_return_paths, compile_mission
from skyfolio.mavlink_bridge.deviations import AltitudeOffPlan, AltitudeWatch, Deviation, HomeWatch
from skyfolio.mavlink_bridge.findings import Finding
from skyfolio.mavlink_bridge.ghosts import DEADLINE_S, Airspace, Ghost
from skyfolio.mavlink_bridge.ghosts import Way as GhostWay
from skyfolio.mavlink_bridge.guidance import FallBack, Kept, keep
from skyfolio.mavlink_bridge.keeper import Keeper, Order, Slip
from skyfolio.mavlink_bridge.pace import Point
from skyfolio.mavlink_bridge.preflight import audit
from skyfolio.mavlink_bridge.reach import head_start_s
from skyfolio.mavlink_bridge.route import Route
from skyfolio.mavlink_bridge.verified import OnBoard
from skyfolio.planner import Plan

Mode = Literal["mission", "stream"]
GHOST_CLEARANCE_M = 5.0
"""Whoever must cross the air of a UAV we lost flies at least this much higher: heights are worse known than places."""


@dataclass(frozen=True)
class Way:
    """How a flight is guided, what follows a stream (`fall_back`), and what UAVs do after the last slot (`at_end`).

    force_stream: stream even to vehicles that would not hold when setpoints end.
    """

    mode: Mode = "mission"
    fall_back: FallBack = FallBack.MISSION
    at_end: OnEnd = OnEnd.LAND
    force_stream: bool = False


class FlightGuidance:
    """What is done between start and landing, beside waiting. `elapsed_s()`: fleet seconds since slot 0 began.

    Way "stream" guides by setpoints until a mission is swapped or the flight is paused; the missions on board are
    flown from then on. What every UAV is off its schedule is an event, `slip`, for each slot.
    """

    def __init__(
        self,
        systems: Mapping[str, int],
        fleet: Fleet,
        clock: FleetClock,
        *,
        elapsed_s: Callable[[], float],
        homes_m: Mapping[str, Point],
        way: Way | None = None,
    ) -> None:
        self.way = way or Way()
        self._systems, self._fleet, self._clock = systems, fleet, clock
        self._elapsed_s = elapsed_s
        self._aboard = MissionsOnBoard()
        self._homes: dict[str, HomeWatch] = {}
        self._homes_m = homes_m
        self._keeping: dict[str, asyncio.Task[None]] = {}
        self._left: set[str] = set()
        """Whom somebody else flies, until they follow a mission of ours again."""
        self.airspace = Airspace()
        """Air that UAVs we lost may still fly in."""
        self._streaming = Streaming(systems, fleet, clock, elapsed_s=elapsed_s, fall_back=self.way.fall_back)
        self._resuming: asyncio.Task[None] | None = None
        self.book: MissionBook | None = None
        """Where it is stored what UAVs are given."""

    def compile(
        self, plan: Plan, uav: str, *, from_m: Point | None = None, first_leg_s: float | None = None
    ) -> Mission:
        """The mission for this UAV's own autopilot and model; `from_m`: it is in flight there. Raises CompileError."""
        system, airborne = self._systems[uav], from_m is not None
        path = list(plan.trajectories_m[uav])
        if from_m is not None:
            path[0] = from_m
            plan = plan.model_copy(update={"trajectories_m": {**plan.trajectories_m, uav: path}})
            plan = self._above_ghosts(plan, uav, path)
        mission = compile_mission(
            plan,
            uav,
            airborne=airborne,
            first_leg_s=first_leg_s,
            autopilot=self._fleet.link.autopilot(system),
            model=self._fleet.link.model(system),
            on_end=self._end_of(plan),
        )
        given = AssignedMission(
            mission=mission,
            path_m=path,
            first_slot=plan.first_slot,
            slot_s=plan.scenario.slot_duration_s,
            origin=plan.scenario.origin,
            altitude_m=plan.scenario.altitude_of(plan.scenario.uav(uav)),
        )
        self._aboard.offer(uav, given)
        return mission

    def _end_of(self, plan: Plan) -> OnEnd:
        """As wanted; but where ways home of this plan would meet, UAVs land where they are."""
        if self.way.at_end is OnEnd.RETURN:
            try:
                check_return_paths(plan, self._homes_m)
            except ReturnPathsTooClose as error:
                self._fleet.note("lands_instead_of_returning", plan_id=plan.id, because=str(error))
                return OnEnd.LAND
        return self.way.at_end

    async def remember(self, uavs: Iterable[str]) -> None:
        """Store that what was compiled for these is sent now. The flight goes on when the database does not answer."""
        sent = self._aboard.sending(uavs)
        if self.book is not None:
            await self.book.write(sent)

    def settled(self, uav: str, mission: Mission, on_board: OnBoard) -> None:
        """How sending it ended: what is on board now."""
        self._aboard.settled(uav, mission, on_board)

    async def recall(self, ghosts: list[dict[str, Any]]) -> None:
        """Take over what UAVs were given, and whose air was reserved, before a restart."""
        self.airspace.recall(ghosts)
        if self.book is not None:
            self._aboard.recall(await self.book.read())

    def suspect_speeds(self) -> None:
        """After a restart: whoever is not ours any more may still fly at a speed that the last process ordered."""
        link = self._fleet.link
        for system in link.heard_systems & set(self._systems.values()):
            link.vehicle(system).flies_our_speed = True

    def resume(self, uavs: Iterable[str]) -> None:
        """After a restart: find out what is on board of each, and keep it on schedule, meanwhile and from then on."""
        wanted = [uav for uav in uavs if self._aboard.may_fly(uav)]
        self._resuming = asyncio.create_task(self._resume(wanted), name="resume-guidance")

    async def _resume(self, uavs: list[str]) -> None:
        link, known = self._fleet.link, {uav: self._aboard.may_fly(uav) for uav in uavs}
        await link.prepare(self._systems[uav] for uav in uavs)
        found = await link.recognise(
            {self._systems[uav]: [one.mission for one in reversed(given)] for uav, given in known.items()}
        )
        for uav in uavs:
            result = found[self._systems[uav]]
            if self._aboard.may_fly(uav) != known[uav]:
                continue  # it was given another one meanwhile
            flown = result.mission
            self._fleet.note(
                "guidance_resumed", uav_id=uav, level="warning" if flown is None else "ok", error=result.error
            )
            if flown is not None and uav not in self._left:
                self.settled(uav, flown, OnBoard.NEW)
                self.follow(uav, flown)

    def leave(self, uav: str, *, setpoints_too: bool = False) -> None:
        """Correct this UAV no more. One that is only silent may still hear its setpoints, and is safest with them."""
        if setpoints_too:
            self._left.add(uav)
            self._streaming.leave(uav)
        task = self._keeping.pop(uav, None)
        if task is not None:
            task.cancel()

    def reserve(self, uav: str, last_seen_m: Point) -> None:
        """A UAV that is lost may still fly: the route of each mission it may have and its ways home stay reserved."""
        may_fly = self._aboard.may_fly(uav)
        if not may_fly:
            return
        now_s = self._elapsed_s()
        self.airspace.reserve(
            Ghost(
                uav_id=uav,
                lost_at_s=now_s,
                last_seen_m=last_seen_m,
                ways=tuple(GhostWay(route=Route(one.path_m, one.slot_s), began_s=one.began_s) for one in may_fly),
                home_m=self._homes_m.get(uav),
                deadline_s=now_s + DEADLINE_S,
            )
        )

    def may_fly(self, uav: str) -> tuple[AssignedMission, ...]:
        """What this UAV may have on board, as far as it was sent."""
        return self._aboard.may_fly(uav)

    def found(self, uav: str) -> bool:
        """It was seen on the ground, or is guided again; whether air was reserved for it until now."""
        reserved = uav in self.airspace.ghosts
        self.airspace.release(uav)
        return reserved

    def _above_ghosts(self, plan: Plan, uav: str, path: list[Point]) -> Plan:
        """The plan for this UAV, flown higher if its way would come too close to that of a UAV we lost."""
        scenario, now_s = plan.scenario, self._elapsed_s()
        self.airspace.expire(now_s)
        first_s = max((plan.first_slot + 1) * scenario.slot_duration_s, now_s + 0.1)
        times = [now_s, *(first_s + n * scenario.slot_duration_s for n in range(len(path) - 1))]
        conflicts = self.airspace.conflicts({uav: path}, times, scenario.min_separation_m)
        if not conflicts:
            return plan
        higher_m = max(scenario.min_separation_m, GHOST_CLEARANCE_M)
        self._fleet.note("ghost_avoided", uav_id=uav, higher_m=higher_m, because=[str(one) for one in conflicts])
        uavs = tuple(
            one.model_copy(update={"altitude_m": scenario.altitude_of(one) + higher_m}) if one.id == uav else one
            for one in scenario.uavs
        )
        return plan.model_copy(update={"scenario": scenario.model_copy(update={"uavs": uavs})})

    async def get_ready(self) -> dict[int, str | None]:
        """In stream mode: put everybody into the mode that follows setpoints; what went wrong with each."""
        return await self._streaming.get_ready(self._aboard.newest()) if self.way.mode == "stream" else {}

    def head_start_s(self) -> float:
        """Fleet seconds by which missions are started before slot 0: what the slowest vehicle to set out needs."""
        return max(
            (
                head_start_s(one.path_m, 0, one.slot_s, self._fleet.link.model(self._systems[uav]))
                for uav, one in self._aboard.newest().items()
            ),
            default=0.0,
        )

    def begin(self) -> None:
        """Slot 0 begins: guide."""
        self._streaming.begin()
        for uav, one in self._aboard.newest().items():
            self.follow(uav, one.mission)

    def audit(self, plan: Plan) -> dict[str, list[Finding]]:
        """The preflight audit of each vehicle that was heard against the mission it is to be given for this plan."""
        link = self._fleet.link
        found = {}
        for uav, one in self._aboard.offered().items():
            if self._systems[uav] not in link.heard_systems:
                continue  # the upload tells
            facts, needs = link.facts(
                self._systems[uav],
                plan,
                uav,
                items=len(one.mission.items),
                stream=self.way.mode == "stream",
                force_stream=self.way.force_stream,
                start_within_m=self._fleet.start_within_m,
            )
            found[uav] = [*audit(facts, needs), *self._fleet.news.doubts_about(self._systems[uav])]
        return found

    def follow(self, uav: str, mission: Mission) -> None:
        """From now on this UAV flies this mission, which `compile` made and which was sent."""
        one = self._aboard.of(uav, mission)
        if one is None:
            return
        self.leave(uav)
        self._left.discard(uav)
        system = self._systems[uav]
        since_s = self._elapsed_s() - one.began_s
        keeper = Keeper(one.path_m, one.slot_s, mission, self._fleet.link.model(system), since_s=since_s)
        kept = Kept(
            vehicle=self._fleet.link.vehicle(system),
            keeper=keeper,
            origin=one.origin,
            altitude=AltitudeWatch(one.altitude_m),
            home=self._homes.setdefault(uav, HomeWatch()),
        )
        notes = _Notes(self._fleet, uav, one.first_slot)
        self._keeping[uav] = asyncio.create_task(
            keep(
                {system: kept},
                elapsed_s=lambda: self._elapsed_s() - one.began_s,
                now_s=self._clock.now,
                scale=self._clock.scale,
                on_slip=notes.slip,
                on_order=notes.order,
                on_deviation=notes.deviation,
            ),
            name=f"keep-{uav}",
        )

    @property
    def streams(self) -> bool:
        """Whether setpoints are being sent."""
        return self._streaming.is_on

    async def missions_only(self, uavs: Collection[str] | None = None) -> None:
        """End the stream: the missions on board are flown from here, by policy. Waits for these UAVs to do so.

        None: for all that are heard.
        """
        await self._streaming.end(uavs)

    def drop_stream(self) -> None:
        """End the stream at once, with nothing in its place: the caller commands the vehicles and waits for nobody."""
        self._streaming.drop()

    def let_go(self) -> None:
        """Guide nobody any more, from this moment: whoever calls this commands the vehicles and waits for nobody."""
        self.drop_stream()
        if self._resuming is not None:
            self._resuming.cancel()
        for uav in list(self._keeping):
            self.leave(uav)

    async def end(self) -> None:
        """Guide nobody any more."""
        if self._resuming is not None:
            self._resuming.cancel()
            await asyncio.gather(self._resuming, return_exceptions=True)
        await self.missions_only()
        await self._streaming.close()
        for uav in list(self._keeping):
            self.leave(uav)


class _Notes:
    """Makes events of what guidance sees and does with one UAV. first_slot: slot 0 of its plan in the operation."""

    def __init__(self, fleet: Fleet, uav: str, first_slot: int) -> None:
        self._fleet, self._uav, self._first_slot = fleet, uav, first_slot

    def slip(self, _system_id: int, slip: Slip) -> None:
        self._fleet.note(
            "slip",
            uav_id=self._uav,
            slot=self._first_slot + slip.slot,
            distance_m=round(slip.distance_m, 2),
            late_s=round(slip.late_s, 2),
        )

    def order(self, _system_id: int, order: Order) -> None:
        if order.stuck is not None:
            self._fleet.note(
                "stuck",
                uav_id=self._uav,
                level="warning",
                item=order.stuck.item,
                next_item=order.item,
                for_s=order.stuck.for_s,
                distance_m=order.stuck.distance_m,
            )

    def deviation(self, _system_id: int, deviation: Deviation) -> None:
        if isinstance(deviation, AltitudeOffPlan):
            level = "warning" if deviation.off else "ok"
            self._fleet.note("altitude_off_plan", uav_id=self._uav, level=level, off_m=deviation.off_m)
        else:
            moved = {"moved_m": deviation.moved_m, "up_m": deviation.up_m}
            self._fleet.note("home_moved", uav_id=self._uav, level="warning", **moved)
