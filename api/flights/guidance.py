"""Guidance of one flight: missions kept on the slot clock, or a stream of setpoints with the missions behind it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from math import dist
from typing import Any

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.assigned_missions import AssignedMission, AssignedMissionStore
from skyfolio.api.flights.ghost_clearance import climb_above_ghosts
from skyfolio.api.flights.guidance_options import GuidanceOptions
from skyfolio.api.flights.missions_on_board import MissionsOnBoard
from skyfolio.api.flights.schedule_keepers import ScheduleKeepers
from skyfolio.api.flights.setpoint_streams import SetpointStreams
from skyfolio.mavlink_bridge import FlightMode, Mission, OnEnd, ReturnPathsTooClose, check_return_paths, compile_mission
from skyfolio.mavlink_bridge.altitudes import Altitudes, altitudes_of
from skyfolio.mavlink_bridge.findings import Finding
from skyfolio.mavlink_bridge.ghosts import DEADLINE_S, Airspace, Ghost
from skyfolio.mavlink_bridge.ghosts import Way as GhostWay
from skyfolio.mavlink_bridge.preflight import audit
from skyfolio.mavlink_bridge.reach import head_start_s
from skyfolio.mavlink_bridge.route import Route
from skyfolio.mavlink_bridge.verified import OnBoard
from skyfolio.planner import Plan
from skyfolio.planner.geometry import Point

AT_HOME_M = 1.0
"""Metres; a UAV that is nearer to its home is above it."""
HOLDS_WITHIN_S = 5.0
"""Fleet seconds in which a vehicle has reported that it holds because setpoints ended.

PX4 waits for COM_OF_LOSS_T, 1 s by default, and reports its mode with HEARTBEATs at 1 Hz.
"""
_HOLD = frozenset({FlightMode.HOLD})


class FlightGuidance:
    """Compiles the missions of one flight, knows what is on board, and keeps UAVs on schedule from start to landing.

    In mode "stream" UAVs are guided by setpoints until the flight is paused or a mission is swapped, unless that only
    extends the plan; from then on they fly the missions on board. How far each UAV is off its schedule is an event,
    `slip`, for each slot.

    systems: MAVLink system id of each UAV. elapsed_s: returns fleet seconds since slot 0 of the operation began.
    homes_m: where each UAV returns to, rally_m: where it may land instead, metres east/north of the scenario's origin.
    """

    def __init__(
        self,
        systems: Mapping[str, int],
        fleet: Fleet,
        clock: FleetClock,
        *,
        elapsed_s: Callable[[], float],
        homes_m: Mapping[str, Point],
        rally_m: Sequence[Point] = (),
        options: GuidanceOptions | None = None,
    ) -> None:
        self.options = options or GuidanceOptions()
        self._systems, self._fleet = systems, fleet
        self._elapsed_s = elapsed_s
        self._on_board = MissionsOnBoard()
        self._homes_m, self._rally_m = homes_m, tuple(rally_m)
        self._keepers = ScheduleKeepers(systems, fleet, clock, elapsed_s=elapsed_s)
        self._flown_by_others: set[str] = set()
        """UAVs that somebody else flies, until they follow an assigned mission again."""
        self.airspace = Airspace()
        """Air in which UAVs that were lost may still fly."""
        self._streams = SetpointStreams(systems, fleet, clock, elapsed_s=elapsed_s, fall_back=self.options.fall_back)
        self._resuming: asyncio.Task[None] | None = None
        self.was_streaming = False
        """Whether a process before this one sent setpoints, which ended with it."""
        self.mission_store: AssignedMissionStore | None = None
        """Where assigned missions are stored; None stores nothing."""

    # -- missions ---------------------------------------------------------------------------------------------------

    def compile(
        self, plan: Plan, uav: str, *, from_m: Point | None = None, first_leg_s: float | None = None
    ) -> Mission:
        """Compile the mission of a UAV for its own autopilot and model. Raises CompileError.

        from_m: where the UAV is in flight, metres east/north; None on the ground. first_leg_s: fleet seconds that the
        first leg shall take.
        """
        system, airborne = self._systems[uav], from_m is not None
        path_m = list(plan.trajectories_m[uav])
        if from_m is not None:
            path_m[0] = from_m
            plan = plan.model_copy(update={"trajectories_m": {**plan.trajectories_m, uav: path_m}})
            plan, higher_m, conflicts = climb_above_ghosts(plan, uav, path_m, self.airspace, self._elapsed_s())
            if conflicts:
                self._fleet.note("ghost_avoided", uav_id=uav, higher_m=higher_m, because=conflicts)
        altitudes = self._altitudes_from_here(plan, uav) if airborne else altitudes_of(plan, uav)
        mission = compile_mission(
            plan,
            uav,
            altitudes=altitudes,
            airborne=airborne,
            first_leg_s=first_leg_s,
            autopilot=self._fleet.link.autopilot(system),
            model=self._fleet.link.model(system),
            on_end=self._end_of(plan, uav),
        )
        assigned = AssignedMission(
            mission=mission,
            path_m=path_m,
            first_slot=plan.first_slot,
            slot_s=plan.scenario.slot_duration_s,
            origin=plan.scenario.origin,
            altitude_m=altitudes.highest_m,
            altitudes_m=None if plan.altitudes_m is None else list(altitudes.metres),
            amsl=altitudes.amsl,
        )
        self._on_board.offer(uav, assigned)
        return mission

    def _altitudes_from_here(self, plan: Plan, uav: str) -> Altitudes:
        """Return the plan's altitudes of a UAV in flight, the first one where it is now if they are above sea level."""
        altitudes = altitudes_of(plan, uav)
        telemetry = self._fleet.link.telemetry(self._systems[uav])
        if not altitudes.amsl or telemetry is None:
            return altitudes
        return altitudes.begun_at(telemetry.altitude_amsl_m)

    def _end_of(self, plan: Plan, uav: str) -> OnEnd:
        """Return what a UAV does after its last slot: as asked for, but all land where ways home would meet.

        One that is above its home by then has no way home, and returns: so it lands on its pad rather than beside it.
        """
        if self.options.at_end is not OnEnd.RETURN:
            return self.options.at_end
        if dist(plan.trajectories_m[uav][-1], self._homes_m[uav]) > AT_HOME_M:
            try:
                check_return_paths(plan, self._homes_m)
            except ReturnPathsTooClose as error:
                self._fleet.note("lands_instead_of_returning", plan_id=plan.id, because=str(error))
                return OnEnd.LAND
        return OnEnd.RETURN

    async def record_sending(self, uavs: Iterable[str]) -> None:
        """Store that the missions compiled last for these UAVs are about to be sent.

        The flight goes on if the database does not answer.
        """
        sent = self._on_board.sending(uavs)
        if self.mission_store is not None:
            await self.mission_store.write(sent)

    def record_on_board(self, uav: str, mission: Mission, on_board: OnBoard) -> None:
        """Note how sending a mission ended: which mission is on board now."""
        self._on_board.record_on_board(uav, mission, on_board)

    def may_fly(self, uav: str) -> tuple[AssignedMission, ...]:
        """Return the missions that this UAV may have on board, as far as they were sent."""
        return self._on_board.may_fly(uav)

    def audit(self, plan: Plan) -> dict[str, list[Finding]]:
        """Audit each vehicle that was heard against the mission that it is about to be sent for this plan.

        Vehicles that were not heard are left out: their upload fails, and says so.
        """
        link = self._fleet.link
        findings = {}
        for uav, assigned in self._on_board.offered().items():
            if uav not in plan.trajectories_m or self._systems[uav] not in link.heard_systems:
                continue
            facts, needs = link.facts(
                self._systems[uav],
                plan,
                uav,
                items=len(assigned.mission.items),
                stream=self.options.mode == "stream",
                force_stream=self.options.force_stream,
                start_within_m=self._fleet.start_within_m,
            )
            findings[uav] = [*audit(facts, needs), *self._fleet.news.doubts_about(self._systems[uav])]
        return findings

    # -- after a restart --------------------------------------------------------------------------------------------

    async def restore(self, ghosts: list[dict[str, Any]]) -> None:
        """Take over from before a restart which missions were assigned, and which air was reserved."""
        self.airspace.recall(ghosts)
        if self.mission_store is not None:
            self._on_board.restore(await self.mission_store.read())

    def expect_holds(self) -> None:
        """Expect vehicles to hold now if setpoints ended with the process before a restart: that is ours to end.

        No human has decided it, and one that is heard only once it holds counts as ours, too.
        """
        if self.was_streaming:
            until_s = self._fleet.now_s() + HOLDS_WITHIN_S
            for system in self._systems.values():
                self._fleet.link.classifier.expect(system, _HOLD, self._fleet.now_s(), until_s)

    def suspect_speeds(self) -> None:
        """Expect vehicles that we no longer command to fly at a speed that the process before a restart ordered."""
        link = self._fleet.link
        for system in link.heard_systems & set(self._systems.values()):
            link.vehicle(system).flies_our_speed = True

    def resume(self, uavs: Iterable[str]) -> None:
        """Begin to find out what is on board of each UAV after a restart, and to keep it on schedule."""
        uncertain = [uav for uav in uavs if self._on_board.may_fly(uav)]
        self._resuming = asyncio.create_task(self._resume(uncertain), name="resume-guidance")

    async def _resume(self, uavs: list[str]) -> None:
        link, candidates = self._fleet.link, {uav: self._on_board.may_fly(uav) for uav in uavs}
        await link.prepare(self._systems[uav] for uav in uavs)
        recognised = await link.recognise(
            {
                self._systems[uav]: [assigned.mission for assigned in reversed(missions)]
                for uav, missions in candidates.items()
            }
        )
        for uav in uavs:
            result = recognised[self._systems[uav]]
            if self._on_board.may_fly(uav) != candidates[uav]:
                continue  # it was sent another one meanwhile
            mission = result.mission
            self._fleet.note(
                "guidance_resumed", uav_id=uav, level="warning" if mission is None else "ok", error=result.error
            )
            if mission is not None and uav not in self._flown_by_others:
                self.record_on_board(uav, mission, OnBoard.NEW)
                self.follow(uav, mission)

    # -- air of UAVs that were lost ---------------------------------------------------------------------------------

    def reserve(self, uav: str, last_seen_m: Point) -> None:
        """Reserve the air of a UAV that was lost and may still fly: each route that it may have, and its ways home.

        last_seen_m: where it was last seen, metres east/north of the scenario's origin.
        """
        missions = self._on_board.may_fly(uav)
        if not missions:
            return
        now_s = self._elapsed_s()
        self.airspace.reserve(
            Ghost(
                uav_id=uav,
                lost_at_s=now_s,
                last_seen_m=last_seen_m,
                ways=tuple(
                    GhostWay(route=Route(assigned.path_m, assigned.slot_s), began_s=assigned.began_s)
                    for assigned in missions
                ),
                home_m=self._homes_m.get(uav),
                rally_m=self._rally_m,
                deadline_s=now_s + DEADLINE_S,
            )
        )

    def release_air(self, uav: str) -> bool:
        """Release the air of a UAV that is on the ground or guided again; return whether any was reserved."""
        reserved = uav in self.airspace.ghosts
        self.airspace.release(uav)
        return reserved

    # -- guiding ----------------------------------------------------------------------------------------------------

    async def prepare_stream(self) -> dict[int, str | None]:
        """Put every UAV into the mode that follows setpoints, if the flight is guided by a stream.

        Returns what went wrong with each system, None where nothing did.
        """
        return await self._streams.prepare(self._on_board.newest()) if self.options.mode == "stream" else {}

    def head_start_s(self) -> float:
        """Return the fleet seconds by which missions are started before slot 0: what the slowest vehicle needs."""
        return max(
            (
                head_start_s(assigned.path_m, 0, assigned.slot_s, self._fleet.link.model(self._systems[uav]))
                for uav, assigned in self._on_board.newest().items()
            ),
            default=0.0,
        )

    def begin(self) -> None:
        """Guide from now on: slot 0 begins."""
        self._streams.begin()
        for uav, assigned in self._on_board.newest().items():
            self.follow(uav, assigned.mission)

    def follow(self, uav: str, mission: Mission) -> None:
        """Keep this UAV on the schedule of a mission that `compile` made and that was sent."""
        assigned = self._on_board.of(uav, mission)
        if assigned is None:
            return
        self._flown_by_others.discard(uav)
        self._keepers.keep(uav, assigned)

    def leave(self, uav: str, *, setpoints_too: bool = False) -> None:
        """Stop correcting this UAV.

        setpoints_too: stop sending it setpoints as well. A UAV that is only silent may still receive them, and is
        safest with them.
        """
        if setpoints_too:
            self._flown_by_others.add(uav)
            self._streams.leave(uav)
        self._keepers.leave(uav)

    def streams_to(self, uav: str) -> bool:
        """Return whether this UAV is guided by setpoints now."""
        return self._streams.streams_to(uav)

    def unguard(self, uav: str) -> None:
        """Let no process command a UAV that is streamed to, if this one dies, while its mission is being replaced."""
        self._streams.unguard(uav)

    def go_on_streaming(self, uav: str, mission: Mission, path_m: Sequence[Point]) -> None:
        """Stream this path once it begins to a UAV that has its mission on board."""
        assigned = self._on_board.of(uav, mission)
        if assigned is not None:
            self._streams.go_on(uav, assigned, path_m)

    @property
    def is_streaming(self) -> bool:
        """Return whether setpoints are being sent."""
        return self._streams.is_on

    def renew_guard(self) -> None:
        """Let the guard of a stream know that we may command the vehicles for longer."""
        self._streams.renew_guard()

    async def end_stream(self, uavs: Collection[str] | None = None) -> None:
        """End the stream, so that the missions on board are flown; wait until these UAVs do so.

        uavs: None waits for all that are heard.
        """
        await self._streams.end(uavs)

    def drop_stream(self) -> None:
        """End the stream at once, with nothing in its place: the caller commands the vehicles, and waits for none."""
        self._streams.drop()

    def leave_all(self) -> None:
        """Stop guiding every UAV at once: the caller commands the vehicles, and waits for none."""
        self.drop_stream()
        if self._resuming is not None:
            self._resuming.cancel()
        self._keepers.leave_all()

    async def end(self) -> None:
        """End all guidance, and wait until UAVs that were streamed to fly the missions on board."""
        if self._resuming is not None:
            self._resuming.cancel()
            await asyncio.gather(self._resuming, return_exceptions=True)
        await self.end_stream()
        await self._streams.close()
        self._keepers.leave_all()
