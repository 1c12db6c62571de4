"""How the survivors of a flight get into a new plan, each with its own sequence of attempts."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import Any

from skyfolio.api.common.metrics import Metrics
from skyfolio.api.common.surroundings import monotonic_s
from skyfolio.api.flights.flight import Flight
from skyfolio.api.flights.journal import IncidentLog, Step
from skyfolio.api.flights.transition import Present, require_separated
from skyfolio.mavlink_bridge import BridgeError, Mission
from skyfolio.planner import Plan, ReplanError


class Swap:
    """One change of missions in flight. Every upload is in the journal before it is sent.

    keeps_stream: UAVs that are guided by setpoints go on so; else a change ends that.
    """

    def __init__(
        self, flight: Flight, steps: IncidentLog, metrics: Metrics, attempts: int, *, keeps_stream: bool = False
    ) -> None:
        self._flight, self._steps, self._metrics, self._attempts = flight, steps, metrics, attempts
        self._keeps_stream = keeps_stream
        self._new_plan: Plan | None = None
        self.seconds = 0.0
        """Wall seconds of the whole change."""
        self.in_force_at_s: float | None = None
        """Fleet seconds since slot 0 when the first UAV flew the new plan."""

    async def into(self, plan: Plan) -> dict[str, str | None]:
        """Send every survivor its mission; return None for each that verifiably flies it, else what went wrong.

        A UAV that does not take the new plan is tried again from where it then is, if that keeps it apart from the
        others; then it is sent the last good plan; if that fails too it holds.
        """
        began = monotonic_s()
        last_good = self._flight.plan
        self._new_plan = plan
        results = await self._try(plan, plan.scenario.uav_ids, attempt=1)
        for attempt in range(2, self._attempts + 1):
            failed = self._failed(results)
            if not failed:
                break
            try:
                self._require_separated(plan, dict.fromkeys(failed, plan))
            except ReplanError as error:
                results |= dict.fromkeys(failed, str(error))
                break
            self._metrics.upload_retries.inc(len(failed))
            results |= await self._try(plan, failed, attempt=attempt)
        failed = self._failed(results)
        if failed:
            await self._return_to(last_good, plan, failed)
        self.seconds = monotonic_s() - began
        return results

    def _failed(self, results: Mapping[str, str | None]) -> list[str]:
        return [uav for uav, error in results.items() if error and uav in self._flight.surviving()]

    async def _try(self, plan: Plan, uavs: Iterable[str], attempt: int) -> dict[str, str | None]:
        positions_m = self._flight.positions_m()
        unlocated = {uav: "it does not know where it is" for uav in uavs if uav not in positions_m}
        try:
            missions = await self._missions(plan, [uav for uav in uavs if uav not in unlocated])
        except (BridgeError, ReplanError) as error:
            return dict.fromkeys(uavs, str(error))
        await self._flight.guidance.record_sending(missions)
        intents = {uav: self._intent(plan, mission, attempt) for uav, mission in missions.items()}
        await self._steps.step_each(Step.UPLOADING, intents)
        results = await asyncio.gather(*(self._swap_one(plan, uav, mission) for uav, mission in missions.items()))
        return unlocated | dict(zip(missions, results, strict=True))

    async def _swap_one(self, plan: Plan, uav: str, mission: Mission) -> str | None:
        keeps = self._keeps_stream and plan is self._new_plan
        streamed_m = plan.trajectories_m[uav] if keeps else None
        error = await self._flight.swap(uav, mission, streamed_m=streamed_m)
        if error is not None:
            return error
        if plan is self._new_plan and self._flight.plan is not plan:
            self._flight.take_over(plan)
            self.in_force_at_s = self._flight.now_s()
        telemetry = self._flight.telemetry(uav)
        mission_id = telemetry.mission_id if telemetry else 0
        await self._steps.step_each(Step.VERIFIED, {uav: {"plan_id": plan.id, "mission_id": mission_id}})
        return None

    async def _missions(self, plan: Plan, uavs: Iterable[str]) -> dict[str, Mission]:
        flight = self._flight
        positions_m, now_s = flight.positions_m(), flight.now_s()
        boundary_s = (plan.first_slot + 1) * flight.slot_s
        first_leg_s = max(boundary_s - now_s, flight.slot_s / 2)
        missions = {}
        for uav in uavs:
            missions[uav] = flight.guidance.compile(plan, uav, from_m=positions_m[uav], first_leg_s=first_leg_s)
            await asyncio.sleep(0)  # a large fleet's take a while: let others take turns
        return missions

    def _intent(self, plan: Plan, mission: Mission, attempt: int) -> dict[str, Any]:
        """Return what a restarted service needs to find out whether this upload took effect."""
        telemetry = self._flight.telemetry(mission.uav_id)
        return {
            "plan_id": plan.id,
            "attempt": attempt,
            "items": len(mission.items),
            "mission_id_before": telemetry.mission_id if telemetry else 0,
            "items_before": telemetry.mission_total if telemetry else None,
        }

    async def _return_to(self, last_good: Plan, new_plan: Plan, uavs: list[str]) -> None:
        """Let UAVs fly the rest of the last good plan, unless that would bring them too close to the others."""
        flight = self._flight
        rest = rest_of(last_good, int(flight.now_s() // flight.slot_s))
        if rest is None:
            return
        try:
            self._require_separated(new_plan, dict.fromkeys(uavs, rest))
        except ReplanError:
            return  # they hold: the swap has seen to that
        await self._try(rest, uavs, attempt=self._attempts + 1)

    def _require_separated(self, new_plan: Plan, plans: Mapping[str, Plan]) -> None:
        """Raise ReplanError unless UAVs keep apart, if these fly these plans and the others the new one.

        Separation is checked from where the UAVs now are: since the first check those that failed have hovered, and the
        others have flown.
        """
        surviving = [uav for uav in self._flight.surviving() if uav in new_plan.scenario.uav_ids]
        require_separated({**dict.fromkeys(surviving, new_plan), **plans}, Present.of(self._flight))


def rest_of(plan: Plan, slot: int) -> Plan | None:
    """Return the plan from `slot` of the operation on; None if nothing is left of it."""
    begin = max(slot - plan.first_slot, 0)
    if begin >= plan.scenario.slots - 1:
        return None
    paths = {uav: path[begin:] for uav, path in plan.trajectories_m.items()}
    altitudes = None if plan.altitudes_m is None else {uav: row[begin:] for uav, row in plan.altitudes_m.items()}
    scenario = plan.scenario.model_copy(update={"slots": plan.scenario.slots - begin})
    return plan.model_copy(
        update={
            "trajectories_m": paths,
            "altitudes_m": altitudes,
            "first_slot": plan.first_slot + begin,
            "scenario": scenario,
        }
    )
