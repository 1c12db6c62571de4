"""One flight: the vehicles' side of an operation, its slot clock, and the record of who was where."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict
from typing import Literal

import numpy as np

from api.clock import FleetClock
from api.fleet import HEARD_WITHIN_S, Fleet
from api.guidance import FlightGuidance, Mode
from api.losses import Loss, seen, silent
from api.rates import InForce, Point, Sample, rates_by_slot
from mavlink_bridge import (
    BridgeError,
    LinkEvent,
    LinkState,
    Mission,
    Telemetry,
    VehiclesMissing,
    geodetic_to_east_north,
)
from mavlink_bridge.fence import fence_items
from planner import Plan

SAMPLE_EVERY_S = 0.5
LOOK_EVERY_S = 0.05
TOLD_WITHIN_S = 3.0
"""Wall seconds that a vehicle has to send a MISSION_CURRENT, which comes at 1 Hz."""


class FlightError(BridgeError):
    """Vehicles did not do what an operation needs; the message names them."""


class Flight:
    """Vehicles that fly a plan, and the plans that replaced it. Times are fleet seconds since slot 0 began."""

    def __init__(
        self, plan: Plan, systems: dict[str, int], fleet: Fleet, clock: FleetClock, guidance: Mode = "mission"
    ) -> None:
        self.systems = systems
        self.timeline = [InForce(0.0, plan)]
        self.lost: dict[str, float] = {}
        self.losses: dict[str, Loss] = {}
        """Why each that is lost is."""
        self._fleet, self._clock = fleet, clock
        self._uavs = {system: uav for uav, system in systems.items()}
        self.guidance = FlightGuidance(systems, fleet, clock, elapsed_s=self.now_s, mode=guidance)
        self.returned: set[str] = set()
        """UAVs that were lost and are heard again: offered to the operator, not commanded."""
        self._began: float | None = None
        self._frozen_s: float | None = None
        self._record: list[tuple[float, dict[str, Point]]] = []

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

    def go_on_from(self, elapsed_s: float, *, paused: bool = False) -> None:
        """Set the slot clock: after a pause, or after a restart of the service."""
        self._began = self._clock.now() - elapsed_s
        self._frozen_s = elapsed_s if paused else None

    def recall(self, record: list[tuple[float, dict[str, Point]]]) -> None:
        """Take over the record of who was where from before a restart."""
        self._record = record

    @property
    def record(self) -> list[tuple[float, dict[str, Point]]]:
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

    async def upload(self) -> float:
        """Put the plan's missions on board and prove it; wall seconds of the slowest.

        Each is compiled for what the vehicle says about itself. Raises FlightError with each failure.
        """
        with suppress(VehiclesMissing):  # the upload itself tells of each vehicle that is not there
            await self._fleet.link.wait_for(set(self.systems.values()), timeout_s=HEARD_WITHIN_S)
        await self._fleet.link.prepare(self.systems.values())
        missions = {uav: self.guidance.compile(self.plan, uav) for uav in self.systems}
        self._audit()
        await self._fence()
        results = await self._fleet.link.upload({self.systems[uav]: mission for uav, mission in missions.items()})
        bad = {self._uavs[system]: result.error for system, result in results.items() if not result.verified}
        if bad:
            good = sorted(self._uavs[system] for system, result in results.items() if result.verified)
            raise FlightError(f"upload failed for {_each(bad)}; verified on board of {', '.join(good) or 'nobody'}")
        return max((result.seconds for result in results.values()), default=0.0)

    async def _fence(self) -> None:
        """Give each vehicle the plan's area as its geofence; one that takes none flies all the same, with a warning.

        Before the missions: PX4 measures a mission against the fence that is on board, and that may be an older one.
        """
        items = fence_items(self.plan.scenario)
        results = await self._fleet.link.upload_fence(dict.fromkeys(self._uavs, items))
        for system, result in sorted(results.items()):
            self._fleet.note(
                "geofence",
                uav_id=self._uavs[system],
                level="ok" if result.verified else "warning",
                corners=len(items),
                error=result.error,
            )

    def _audit(self) -> None:
        """Report what the preflight audit finds; with `preflight` "enforce" a blocker keeps everybody on the ground."""
        blockers = {}
        for uav, findings in self.guidance.audit().items():
            for finding in findings:
                self._fleet.note("preflight", uav_id=uav, **asdict(finding))
            blocked = [
                f"{one.name} is {one.found}, should be {one.should}" for one in findings if one.level == "blocker"
            ]
            if blocked:
                blockers[uav] = ", ".join(blocked)
        if blockers and self._fleet.enforces_preflight:
            raise FlightError(f"preflight: {_each(blockers)}")

    async def launch(self, timeout_s: float) -> None:
        """Arm, climb to the plan's altitude and wait there for each other. Raises FlightError."""
        scenario = self.first_plan.scenario
        altitudes = {system: scenario.altitude_of(scenario.uav(uav)) for system, uav in self._uavs.items()}
        results = await self._fleet.link.launch(altitudes, timeout_s=timeout_s)
        bad = {self._uavs[system]: result.error for system, result in results.items() if not result.ok}
        if bad:
            raise FlightError(f"launch failed for {_each(bad)}")

    async def start(self) -> None:
        """Begin slot 0 on all vehicles at once. Raises FlightError."""
        if self.guidance.mode == "stream":
            errors = await self.guidance.get_ready()
            began = self._clock.now()
        else:
            began = self._clock.now()
            results = await self._fleet.link.start(set(self._uavs))
            errors = {system: result.error for system, result in results.items()}
        bad = {self._uavs[system]: error for system, error in errors.items() if error}
        if bad:
            raise FlightError(f"start failed for {_each(bad)}")
        self._began = began
        self.guidance.begin()

    async def swap(self, missions: Mapping[str, Mission]) -> dict[str, str | None]:
        """Replace missions in flight; for each UAV None when it verifiably flies the new one, else what went wrong."""
        await self.guidance.missions_only()
        ours = {uav: mission for uav, mission in missions.items() if self._may_command(uav)}
        results = await self._fleet.link.swap({self.systems[uav]: mission for uav, mission in ours.items()})
        told: dict[str, str | None] = dict.fromkeys(missions.keys() - ours.keys(), "lost, and left alone")
        for uav, mission in ours.items():
            result = results[self.systems[uav]]
            told[uav] = None if result.ok else result.error or "failed"
            if result.ok and uav not in self.lost:
                self.guidance.follow(uav, mission)
        return told

    async def stop_where_it_is(self, action: Literal["hold", "land", "return"]) -> dict[str, str | None]:
        """Hold, land or return every vehicle that still answers; what went wrong with each, None when it does."""
        systems = {self.systems[uav] for uav in self.still_up() if self._may_command(uav)}
        await self.guidance.missions_only()
        link = self._fleet.link
        act = {"hold": link.hold, "land": link.land, "return": link.return_home}[action]
        results = await act(systems)
        return {self._uavs[system]: result.error for system, result in results.items()}

    async def pause(self) -> None:
        """Hover. Raises FlightError with each vehicle that does not."""
        bad = {uav: error for uav, error in (await self.stop_where_it_is("hold")).items() if error}
        if bad:
            raise FlightError(f"hold failed for {_each(bad)}")

    async def resume(self) -> None:
        """Fly on from the item each vehicle was at. Raises FlightError with each vehicle that does not."""
        await self.fly_on([uav for uav in self.still_up() if self._may_command(uav)])

    async def fly_on(self, uavs: Collection[str]) -> None:
        """Enter mission mode at the item that is current on board. Raises FlightError."""

        async def one(uav: str) -> str | None:
            system = self.systems[uav]
            said = self._fleet.link.telemetry(system)
            item = (said.mission_current if said else None) or 0
            return (await self._fleet.link.start([system], item=item))[system].error

        errors = dict(zip(uavs, await asyncio.gather(*map(one, uavs)), strict=True))
        bad = {uav: error for uav, error in errors.items() if error}
        if bad:
            raise FlightError(f"start failed for {_each(bad)}")

    async def reattach(self) -> None:
        """After a restart: wait until those who should be there have told what they fly.

        Who is silent is declared lost in time.
        """
        with suppress(VehiclesMissing):
            await self._fleet.link.wait_for({self.systems[uav] for uav in self.surviving()}, timeout_s=HEARD_WITHIN_S)
        until = time.monotonic() + TOLD_WITHIN_S
        while time.monotonic() < until and not all(map(self._has_told, self.surviving())):  # noqa: ASYNC110
            await asyncio.sleep(LOOK_EVERY_S)

    def _has_told(self, uav: str) -> bool:
        """Whether a MISSION_CURRENT of it was heard, or nothing at all."""
        said = self.on_board(uav)
        return said is None or said.mission_current is not None

    def on_board(self, uav: str) -> Telemetry | None:
        """What the vehicle last said, its mission included."""
        return self._fleet.link.telemetry(self.systems[uav])

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

    def follow_losses(self) -> asyncio.Queue[LinkEvent]:
        """Begin to receive link events."""
        return self._fleet.follow()

    def unfollow_losses(self, queue: asyncio.Queue[LinkEvent]) -> None:
        """Stop receiving them."""
        self._fleet.unfollow(queue)

    def newly_lost(self, queue: asyncio.Queue[LinkEvent]) -> dict[str, Loss]:
        """UAVs that are lost since the last call, and why: fallen silent in flight, or seen in no state to serve."""
        found = {}
        while not queue.empty():
            event = queue.get_nowait()
            uav = self._uavs.get(event.system_id)
            if uav is None:
                continue
            if event.after == LinkState.LIVE and uav in self.losses and self.losses[uav].may_return:
                self.returned.add(uav)  # its air stays reserved: nobody knows yet what it flies
            if event.after == LinkState.LOST and not self._down(uav):
                self.returned.discard(uav)
                if uav not in self.lost:
                    found[uav] = self._lose(uav, silent(event.silent_for_s))
        return found | self._seen_lost()

    def _seen_lost(self) -> dict[str, Loss]:
        """UAVs newly seen crashed, landed off plan, flown by a human or in failsafe; who is lost gets a cause."""
        found = {}
        for uav in self.systems:
            loss = self._seen(uav)
            if loss is None:
                continue
            if uav not in self.lost:
                found[uav] = self._lose(uav, loss)
            elif self.losses[uav].kind != loss.kind:
                self.losses[uav] = loss
                self.returned.discard(uav)
            if not loss.in_the_air and self.guidance.found(uav):
                self._fleet.note("ghost_released", uav_id=uav, because=loss.detail)
        return found

    def _lose(self, uav: str, loss: Loss) -> Loss:
        """From now on it is neither counted on nor commanded."""
        self.lost[uav] = self.now_s() - loss.silent_for_s
        self.losses[uav] = loss
        self.guidance.leave(uav, setpoints_too=not loss.may_return)
        where = self.positions_m().get(uav)
        if loss.in_the_air and where is not None:
            self.guidance.reserve(uav, where)
        return loss

    def readmit(self, uav: str) -> None:
        """Count on a UAV again that has returned."""
        self.returned.discard(uav)
        self.lost.pop(uav)
        self.losses.pop(uav)
        self.guidance.found(uav)

    def _may_command(self, uav: str) -> bool:
        """Whether it is ours: a human, a failsafe or a crash is never overruled, not even before it is declared."""
        return uav not in self.lost and self._seen(uav) is None

    def _seen(self, uav: str) -> Loss | None:
        """What it is seen in that ends its service. Once no slot can be flown differently, missions end as planned."""
        flown = uav in self.lost or self.now_s() < (self.n_slots - 2) * self.slot_s
        return seen(self._fleet.condition(self.systems[uav]), plan_is_flown=flown)

    def positions_m(self) -> dict[str, Point]:
        """Where each UAV was last heard, metres east/north of the scenario's origin."""
        found = {}
        for uav, system in self.systems.items():
            said = self._fleet.link.telemetry(system)
            if said is not None:
                origin = self.first_plan.scenario.origin
                found[uav] = geodetic_to_east_north(origin, said.lat_deg, said.lon_deg)
        return found

    def still_up(self) -> list[str]:
        """Surviving UAVs that have not landed."""
        return [uav for uav in self.surviving() if not self._down(uav)]

    def all_down(self) -> bool:
        """Whether at least one UAV survived and all that did have landed."""
        return bool(self.surviving()) and not self.still_up()

    def over(self, landing_limit_s: float) -> bool:
        """Whether there is nothing left to wait for."""
        return not self.still_up() or self.now_s() > self.n_slots * self.slot_s + landing_limit_s

    def _down(self, uav: str) -> bool:
        said = self._fleet.link.telemetry(self.systems[uav])
        return said is not None and not said.armed

    # --- the record ---

    def sample(self) -> None:
        """Record where everyone is, at most twice a fleet second."""
        now = self.now_s()
        if self._record and now - self._record[-1][0] < SAMPLE_EVERY_S:
            return
        self._record.append((now, self.positions_m()))

    def reported_rates_bps(self) -> dict[str, list[float | None]]:
        """Rates of each user in each slot from reported positions; None for slots not (yet) recorded."""
        users = self.first_plan.scenario.user_ids
        samples = [
            Sample(at, where, frozenset(uav for uav in where if at <= self.lost.get(uav, np.inf)))
            for at, where in self._record
            if at < self.n_slots * self.slot_s
        ]
        if not samples:
            return {user: [None] * self.n_slots for user in users}
        table = rates_by_slot(self.timeline, samples, self.n_slots)
        return {
            user: [None if np.isnan(rate) else float(rate) for rate in row]
            for user, row in zip(users, table, strict=True)
        }


def _each(errors: Mapping[str, str | None]) -> str:
    return "; ".join(f"'{uav}': {error or 'no answer'}" for uav, error in sorted(errors.items()))
