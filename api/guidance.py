"""Guidance of one flight: missions kept on the slot clock, or a stream of setpoints with the missions behind it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from api.clock import FleetClock
from api.fleet import Fleet
from api.given import Given, MissionBook
from api.streaming import Streaming
from mavlink_bridge import Mission, OnEnd, ReturnPathsTooClose, check_return_paths, compile_mission
from mavlink_bridge.ghosts import DEADLINE_S, Airspace, Ghost
from mavlink_bridge.guidance import FallBack, Kept, keep
from mavlink_bridge.keeper import Keeper, Slip
from mavlink_bridge.pace import Point
from mavlink_bridge.preflight import Finding, audit
from mavlink_bridge.route import Route
from planner import Plan

Mode = Literal["mission", "stream"]
GHOST_CLEARANCE_M = 5.0
"""Whoever must cross the air of a UAV we lost flies at least this much higher: heights are worse known than places."""


@dataclass(frozen=True)
class Way:
    """How a flight is guided, what follows a stream (`fall_back`), and what UAVs do after the last slot (`at_end`)."""

    mode: Mode = "mission"
    fall_back: FallBack = FallBack.MISSION
    at_end: OnEnd = OnEnd.LAND


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
        self._given: dict[str, Given] = {}
        self._homes_m = homes_m
        self._keeping: dict[str, asyncio.Task[None]] = {}
        self.airspace = Airspace()
        """Air that UAVs we lost may still fly in."""
        self._streaming = Streaming(systems, fleet, clock, elapsed_s=elapsed_s, fall_back=self.way.fall_back)
        self._resuming: asyncio.Task[None] | None = None
        self._may_have: dict[str, list[Given]] = {}
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
        self._given[uav] = Given(
            mission=mission,
            path_m=path,
            first_slot=plan.first_slot,
            slot_s=plan.scenario.slot_duration_s,
            origin=plan.scenario.origin,
            altitude_m=plan.scenario.altitude_of(plan.scenario.uav(uav)),
        )
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
        """Store what these are about to be given. The flight goes on when the database does not answer."""
        if self.book is not None:
            await self.book.write({uav: self._given[uav] for uav in uavs})

    async def recall(self, ghosts: list[dict[str, Any]]) -> None:
        """Take over what UAVs were given, and whose air was reserved, before a restart."""
        self.airspace.recall(ghosts)
        if self.book is not None:
            self._may_have = await self.book.read()
            self._given = {uav: given[0] for uav, given in self._may_have.items()}

    def resume(self, uavs: Iterable[str]) -> None:
        """After a restart: find out what is on board of each, and keep it on schedule, meanwhile and from then on."""
        wanted = [uav for uav in uavs if uav in self._given]
        self._resuming = asyncio.create_task(self._resume(wanted), name="resume-guidance")

    async def _resume(self, uavs: list[str]) -> None:
        link, newest = self._fleet.link, {uav: self._given[uav] for uav in uavs}
        await link.prepare(self._systems[uav] for uav in uavs)
        found = await link.recognise({self._systems[uav]: [one.mission for one in self._may_have[uav]] for uav in uavs})
        for uav in uavs:
            result = found[self._systems[uav]]
            if self._given[uav] is not newest[uav]:
                continue  # it was given another one meanwhile
            flown = next((one for one in self._may_have[uav] if one.mission is result.mission), None)
            self._fleet.note(
                "guidance_resumed", uav_id=uav, level="warning" if flown is None else "ok", error=result.error
            )
            if flown is not None:
                self._given[uav] = flown
                self.follow(uav, flown.mission)

    def leave(self, uav: str, *, setpoints_too: bool = False) -> None:
        """Correct this UAV no more. One that is only silent may still hear its setpoints, and is safest with them."""
        if setpoints_too:
            self._streaming.leave(uav)
        task = self._keeping.pop(uav, None)
        if task is not None:
            task.cancel()

    def reserve(self, uav: str, last_seen_m: Point) -> None:
        """A UAV that is lost may still fly: its old route and its way home stay reserved."""
        one = self._given.get(uav)
        if one is None:
            return
        now_s = self._elapsed_s()
        self.airspace.reserve(
            Ghost(
                uav_id=uav,
                lost_at_s=now_s,
                last_seen_m=last_seen_m,
                route=Route(one.path_m, one.slot_s),
                route_began_s=one.began_s,
                home_m=self._homes_m.get(uav),
                deadline_s=now_s + DEADLINE_S,
            )
        )

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
        return await self._streaming.get_ready(self._given) if self.way.mode == "stream" else {}

    def begin(self) -> None:
        """Slot 0 begins: guide."""
        self._streaming.begin()
        for uav, one in self._given.items():
            self.follow(uav, one.mission)

    def audit(self, plan: Plan) -> dict[str, list[Finding]]:
        """The preflight audit of each vehicle that was heard against the mission it is to be given for this plan."""
        link = self._fleet.link
        found = {}
        for uav, one in self._given.items():
            if self._systems[uav] not in link.heard_systems:
                continue  # the upload tells
            items = len(one.mission.items)
            facts, needs = link.facts(self._systems[uav], plan, uav, items=items, stream=self.way.mode == "stream")
            found[uav] = audit(facts, needs)
        return found

    def follow(self, uav: str, mission: Mission) -> None:
        """From now on this UAV flies this mission, which `compile` made."""
        one = self._given.get(uav)
        if one is None or one.mission is not mission:
            return
        self.leave(uav)
        system = self._systems[uav]
        since_s = self._elapsed_s() - one.began_s
        keeper = Keeper(one.path_m, one.slot_s, mission, self._fleet.link.model(system), since_s=since_s)
        kept = Kept(vehicle=self._fleet.link.vehicle(system), keeper=keeper, origin=one.origin)
        self._keeping[uav] = asyncio.create_task(
            keep(
                {system: kept},
                elapsed_s=lambda: self._elapsed_s() - one.began_s,
                now_s=self._clock.now,
                scale=self._clock.scale,
                on_slip=lambda _system, slip: self._note(uav, slip, one.first_slot),
            ),
            name=f"keep-{uav}",
        )

    async def missions_only(self) -> None:
        """End the stream: the missions on board are flown from here, by policy."""
        await self._streaming.end()

    async def end(self) -> None:
        """Guide nobody any more."""
        if self._resuming is not None:
            self._resuming.cancel()
            await asyncio.gather(self._resuming, return_exceptions=True)
        await self.missions_only()
        for uav in list(self._keeping):
            self.leave(uav)

    def _note(self, uav: str, slip: Slip, first_slot: int) -> None:
        self._fleet.note(
            "slip",
            uav_id=uav,
            slot=first_slot + slip.slot,
            distance_m=round(slip.distance_m, 2),
            late_s=round(slip.late_s, 2),
        )
