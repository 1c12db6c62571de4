"""From the ground into slot 0: upload, geofence, audit, launch and the common start, watched all the while.

If a UAV crashes, is taken over, falls silent or goes into failsafe before slot 0, the operation ends at once for all.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Coroutine, Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Any, TypeVar

from skyfolio.api.common.fleet_clock import FleetClock
from skyfolio.api.common.surroundings import monotonic_s
from skyfolio.api.fleet.registry import HEARD_WITHIN_S, Fleet
from skyfolio.api.flights.guidance import FlightGuidance
from skyfolio.api.flights.losses import Loss, seen, silent
from skyfolio.mavlink_bridge import (
    BridgeError,
    LinkState,
    Mission,
    UnknownAutopilot,
    VehiclesMissing,
    geodetic_to_east_north,
)
from skyfolio.mavlink_bridge.altitudes import altitudes_of
from skyfolio.mavlink_bridge.fence import fence_items, rally_items
from skyfolio.mavlink_bridge.mission_messages import MissionType
from skyfolio.mavlink_bridge.readiness import ARMABLE_WITHIN_S
from skyfolio.planner import Plan

LOOK_EVERY_S = 0.05
LOW_M = 3.0
"""Metres above home; if the launch fails, UAVs that are lower land, and the others hover."""
ONE_MORE_HEARTBEAT_S = 1.5
"""Wall seconds within which a vehicle reports that it was armed after all; heartbeats come at 1 Hz."""

Result = TypeVar("Result")


class FlightError(BridgeError):
    """Vehicles did not do what an operation needs; the message names them."""


class TakeOff:
    """The vehicles of one plan before its slot 0.

    systems: the MAVLink system id of each UAV. patience_s: wall seconds within which a vehicle must become armable.
    """

    def __init__(
        self,
        plan: Plan,
        systems: Mapping[str, int],
        fleet: Fleet,
        clock: FleetClock,
        guidance: FlightGuidance,
        *,
        patience_s: float = ARMABLE_WITHIN_S,
    ) -> None:
        self._patience_s = patience_s
        self._plan, self._systems, self._fleet = plan, systems, fleet
        self._clock, self._guidance = clock, guidance
        self._uavs = {system: uav for uav, system in systems.items()}
        self._created_s = clock.now()
        self._armed_s: dict[str, float] = {}
        self._was_heard: set[str] = set()
        self._launched = False

    # -- watching ---------------------------------------------------------------------------------------------------

    async def watched(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Do some work unless a vehicle is lost before it is done.

        In that case the work is ended, and FlightError names the vehicle and the cause.
        """
        task = asyncio.ensure_future(work)
        try:
            while not task.done():
                fallen = {uav: loss for uav in self._systems if (loss := self._loss_of(uav)) is not None}
                if fallen:
                    raise FlightError(
                        f"lost before slot 0: {in_words({uav: str(loss) for uav, loss in fallen.items()})}"
                    )
                await asyncio.wait([task], timeout=LOOK_EVERY_S)
            return task.result()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def _loss_of(self, uav: str) -> Loss | None:
        """Return why this UAV cannot begin; None while it can. How its last flight ended does not matter.

        Silence counts only for a UAV that was heard in this operation; the upload reports the others.
        """
        system, link, now_s = self._systems[uav], self._fleet.link, self._clock.now()
        telemetry = link.telemetry(system)
        if telemetry is not None and telemetry.armed:
            self._armed_s.setdefault(uav, now_s)
        if system in link.heard_systems and system in link.monitor.watched:
            silent_s = link.monitor.silent_for_s(system, now_s)
            if link.monitor.state(system) is not LinkState.LOST:
                self._was_heard.add(uav)
            elif uav in self._was_heard and silent_s >= link.monitor.stale_after_s:  # unless it is coming back
                return silent(silent_s)
        change = self._fleet.condition(system)
        loss = seen(change, plan_is_flown=True)
        if change is None or loss is None:
            return None
        if loss.kind == "rebooted":  # it may have been switched off before, and have reported its clock only now
            happened = self._created_s < (
                change.at_s if telemetry is None else telemetry.heard_at_s - telemetry.boot_ms / 1000
            )
        else:
            happened = change.at_s > self._armed_s.get(uav, now_s)
        goes_on = telemetry is not None and telemetry.armed
        return loss if (happened if loss.is_over else goes_on) else None

    async def stand_down(self, except_for: Collection[str] = ()) -> None:
        """Let UAVs that are armed and ours hover where they are, or land if they are low: the launch has failed.

        except_for: UAVs that have other orders.
        """
        commanded = set(except_for)
        until = monotonic_s() + (ONE_MORE_HEARTBEAT_S if self._launched else 0.0)
        while True:
            up = {
                uav: up_m for uav in self._systems if uav not in commanded and (up_m := self._height_m(uav)) is not None
            }
            if not up and monotonic_s() >= until:
                return
            commanded |= up.keys()
            link, commander = self._fleet.link, self._fleet.commander
            await asyncio.gather(
                commander.each(link.land, [self._systems[uav] for uav, up_m in up.items() if up_m < LOW_M]),
                commander.each(link.hold, [self._systems[uav] for uav, up_m in up.items() if up_m >= LOW_M]),
            )
            await asyncio.sleep(LOOK_EVERY_S)

    def _height_m(self, uav: str) -> float | None:
        """Return the metres above home of a UAV that is armed and ours to command; None of any other."""
        system = self._systems[uav]
        telemetry = self._fleet.link.telemetry(system)
        if telemetry is None or not telemetry.armed or not self._fleet.link.is_ours(system):
            return None
        return telemetry.relative_alt_m if self._loss_of(uav) is None else None

    # -- commands ---------------------------------------------------------------------------------------------------

    async def upload(self) -> float:
        """Upload the plan's missions and verify them; return the wall seconds of the slowest vehicle.

        Each mission is compiled for what the vehicle reports about itself. Raises FlightError with each failure.
        """
        link = self._fleet.link
        with suppress(VehiclesMissing):  # the upload itself reports each vehicle that is not there
            await link.wait_for(set(self._systems.values()), timeout_s=HEARD_WITHIN_S)
        await link.prepare(self._systems.values())
        await link.wait_for_facts(self._systems.values(), self._waits)
        missions = await self._compiled()
        self._audit()
        await self._guidance.record_sending(missions)
        await self._fence()
        await self._rally()
        results = await link.upload({self._systems[uav]: mission for uav, mission in missions.items()})
        for system, result in results.items():
            uav = self._uavs[system]
            self._guidance.record_on_board(uav, missions[uav], result.on_board)
        failed = {self._uavs[system]: result.error for system, result in results.items() if not result.verified}
        if failed:
            verified = sorted(self._uavs[system] for system, result in results.items() if result.verified)
            raise FlightError(
                f"upload failed for {in_words(failed)}; verified on board of {', '.join(verified) or 'none'}"
            )
        return max((result.seconds for result in results.values()), default=0.0)

    async def _compiled(self) -> dict[str, Mission]:
        """Return the mission of each UAV. Raises FlightError with each that none can be compiled for."""
        missions: dict[str, Mission] = {}
        failed: dict[str, str | None] = {}
        for uav in self._systems:
            try:
                missions[uav] = self._guidance.compile(self._plan, uav)
            except UnknownAutopilot as error:
                failed[uav] = str(error)
            await asyncio.sleep(0)  # a large fleet's take a while: let others take turns
        if failed:
            raise FlightError(f"upload failed for {in_words(failed)}; nothing was sent")
        return missions

    def _waits(self, system: int, missing: tuple[str, ...]) -> None:
        """Report that an autopilot that has just booted is being waited for."""
        self._fleet.note("waiting_for_facts", uav_id=self._uavs[system], missing=list(missing))

    async def arm(self) -> None:
        """Arm every vehicle before any leaves the ground. Raises FlightError with each that refuses."""
        self._launched = True
        results = await self._fleet.link.arm(
            self._systems.values(), patience_s=self._patience_s, on_refused=self._arming_refused
        )
        failed = {self._uavs[system]: result.error for system, result in results.items() if not result.ok}
        if failed:
            raise FlightError(f"launch failed for {in_words(failed)}")

    def _arming_refused(self, system: int, why: str) -> None:
        self._fleet.note("arming_refused", uav_id=self._uavs[system], because=why)

    async def launch(self, timeout_s: float) -> None:
        """Arm, climb to the plan's altitude, and wait there for each other.

        Raises FlightError for the first failure.
        """
        await self.arm()

        async def climb(uav: str, system: int) -> None:
            result = (await self._fleet.link.launch({system: self._first_up_m(uav)}, timeout_s=timeout_s))[system]
            if not result.ok:
                raise FlightError(f"launch failed for {in_words({uav: result.error})}")

        try:
            async with asyncio.TaskGroup() as climbing:
                for uav, system in self._systems.items():
                    climbing.create_task(climb(uav, system))
        except ExceptionGroup as failures:
            raise failures.exceptions[0] from None

    def _first_up_m(self, uav: str) -> float:
        """Return how high above its own home a UAV begins slot 0. Raises FlightError if its home's height is needed."""
        altitudes = altitudes_of(self._plan, uav)
        if not altitudes.amsl:
            return altitudes.metres[0]
        home_amsl_m = self._fleet.home_amsl_m(self._systems[uav])
        if home_amsl_m is None:
            raise FlightError(f"launch failed for '{uav}': the height of its home is not known")
        return altitudes.metres[0] - home_amsl_m

    async def start(self) -> float:
        """Begin slot 0 on all vehicles at once; return the fleet second in which it begins. Raises FlightError.

        Missions are started early, by the head start that the slowest vehicle needs, and this returns when slot 0
        begins: keepers see to it that the others do not reach their next point too soon.
        """
        if self._guidance.options.mode == "stream":
            errors = await self._guidance.prepare_stream()
            began = self._clock.now()
        else:
            started_s: list[float] = []
            results = await self._fleet.link.start(
                self._systems.values(), on_go=lambda: started_s.append(self._clock.now())
            )
            began = started_s[0] + self._guidance.head_start_s()
            errors = {system: result.error for system, result in results.items()}
        failed = {self._uavs[system]: error for system, error in errors.items() if error}
        if failed:
            raise FlightError(f"start failed for {in_words(failed)}")
        await self._clock.sleep(began - self._clock.now())
        return began

    async def _fence(self) -> None:
        """Send each vehicle the plan's area as its geofence; one that refuses it flies without, with a warning.

        This comes before the missions: PX4 checks a mission against the geofence on board, which may be an older one.
        """
        items = fence_items(self._plan.scenario)
        results = await self._fleet.link.upload_fence(dict.fromkeys(self._uavs, items))
        for system, result in sorted(results.items()):
            self._fleet.note(
                "geofence",
                uav_id=self._uavs[system],
                level="ok" if result.verified else "warning",
                corners=len(items),
                error=result.error,
            )

    async def _rally(self) -> None:
        """Send each vehicle its present position and the scenario's rally points, at the altitude of its slot 0.

        So a return ends at one of them even if its home is changed in the air, and where the energy of the plan was
        proven to suffice to. A vehicle that refuses them flies with a warning.
        """
        scenario, points = self._plan.scenario, {}
        for uav, system in self._systems.items():
            telemetry = self._fleet.link.telemetry(system)
            if telemetry is not None and telemetry.place_deg is not None and not telemetry.armed:
                stands_m = geodetic_to_east_north(scenario.origin, *telemetry.place_deg)
                points[system] = rally_items(scenario, [stands_m, *scenario.rally_m], self._first_up_m(uav))
        results = await self._fleet.link.upload_fence(points, mission_type=MissionType.RALLY)
        for system, result in sorted(results.items()):
            level = "ok" if result.verified else "warning"
            self._fleet.note("rally_point", uav_id=self._uavs[system], level=level, error=result.error)

    def _audit(self) -> None:
        """Report the findings of the preflight audit.

        Raises FlightError with each vehicle that must stay on the ground.

        With `preflight` "enforce" any blocker keeps the whole fleet on the ground; a finding that refuses does so in
        any case.
        """
        blockers, enforced = {}, self._fleet.enforces_preflight
        for uav, findings in self._guidance.audit(self._plan).items():
            for finding in findings:
                self._fleet.note("preflight", uav_id=uav, **asdict(finding))
            blocked = [
                f"{finding.name} is {finding.found}, should be {finding.should}"
                for finding in findings
                if finding.refuses or (finding.level == "blocker" and enforced)
            ]
            if blocked:
                blockers[uav] = ", ".join(blocked)
        if blockers:
            raise FlightError(f"preflight: {in_words(blockers)}")


def in_words(errors: Mapping[str, str | None]) -> str:
    """Return what went wrong with each UAV, on one line."""
    return "; ".join(f"'{uav}': {error or 'no answer'}" for uav, error in sorted(errors.items()))
