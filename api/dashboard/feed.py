"""The service's REST interface and events as the pages' views. No other module of this room knows routes or JSON."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter

from skyfolio.api.dashboard.recoveries import recoveries
from skyfolio.api.dashboard.rest import Rest, RestError
from skyfolio.api.dashboard.views import (
    OVER,
    Drill,
    ExplanationState,
    Operation,
    OperationLine,
    OrderResult,
    PlanState,
    ServiceEvent,
    TrackPoint,
    Vehicle,
    WhatIf,
)
from skyfolio.planner import Explanation, Pins, Plan, Scenario
from skyfolio.sim import FAULTS, fault_from

ENDED = {"succeeded", "infeasible", "cancelled", "failed", "interrupted"}
TRACK_AT_ONCE = 200
"""Points of a track that are read in one request; a long flight has thousands."""
_TRACK = TypeAdapter(list[TrackPoint])


class Feed:
    """The service as one operator sees it. Every method may raise RestError, whose text is fit for the operator."""

    def __init__(self, rest: Rest) -> None:
        self._rest = rest

    # --- plans ---

    async def examples(self) -> list[str]:
        """Return the names of the built-in scenarios."""
        return list((await self._rest.call("GET", "/v1/scenarios/examples"))["examples"])

    async def example(self, name: str) -> Scenario:
        """Return one built-in scenario."""
        return Scenario.model_validate(await self._rest.call("GET", f"/v1/scenarios/examples/{name}"))

    async def make_plan(self, scenario: Scenario, wait_s: float = 60.0, pins: Pins | None = None) -> Plan:
        """Plan a scenario and wait for the result."""
        return await self.awaited_plan(await self.begin_plan(scenario, pins), wait_s)

    async def begin_plan(self, scenario: Scenario, pins: Pins | None = None) -> str:
        """Request a plan that keeps `pins` and return its id."""
        body = scenario.model_dump(mode="json") | ({"pins": pins.model_dump(mode="json")} if pins else {})
        return str((await self._rest.call("POST", "/v1/plans", json=body))["id"])

    async def awaited_plan(self, plan_id: str, wait_s: float = 60.0) -> Plan:
        """Wait for a plan, at most `wait_s`, and return it."""
        return _finished(await self._rest.text("GET", f"/v1/plans/{plan_id}", wait_s=wait_s))

    async def what_if(
        self, plan_id: str, uav_id: str, at_slot: int, disruption_weight: float = 0.0, wait_s: float = 60.0
    ) -> Plan:
        """Return the replan for the loss of this UAV at the beginning of that slot of the operation's grid.

        disruption_weight: what a change must be worth, kbit/s. Pins are kept as far as they hold, as in flight.
        """
        body = {"failed": [uav_id], "at_slot": at_slot, "keep_pins": True, "disruption_weight": disruption_weight}
        return _finished(await self._rest.text("POST", f"/v1/plans/{plan_id}/replans", json=body, wait_s=wait_s))

    async def plan(self, plan_id: str) -> Plan:
        """Return a finished plan."""
        return _finished(await self._rest.text("GET", f"/v1/plans/{plan_id}"))

    async def explanation(self, plan_id: str, wait_s: float = 60.0) -> Explanation:
        """Return why a plan is as it is."""
        text = await self._rest.text("GET", f"/v1/plans/{plan_id}/explanation", wait_s=wait_s)
        known = ExplanationState.model_validate_json(text)
        if known.status is not None:
            raise RestError(202, "Not finished", f"the explanation of {plan_id} is still {known.status}")
        return Explanation.model_validate_json(text)

    async def imported(self, files: Mapping[str, bytes], base: Scenario | None) -> tuple[Scenario, list[str]]:
        """Return the scenario that GeoJSON, CSV and KML files describe, by name, and what was chosen for it.

        base: the scenario from which the rest is taken.
        """
        sent = [{"name": name, "content_base64": b64encode(content).decode()} for name, content in files.items()]
        body = {"files": sent, "base": base and base.model_dump(mode="json")}
        made = await self._rest.call("POST", "/v1/scenarios:import", json=body)
        return Scenario.model_validate(made["scenario"]), list(made["notes"])

    async def plan_file(self, plan_id: str, form: str) -> str:
        """Return a plan as GeoJSON, KML or CSV."""
        return await self._rest.text("GET", f"/v1/plans/{plan_id}/export", format=form)

    async def mission_file(self, plan_id: str, uav_id: str) -> Any:
        """Return one UAV's mission as a QGroundControl `.plan` document."""
        return await self._rest.call("GET", f"/v1/plans/{plan_id}/missions", format="plan", uav_id=uav_id)

    async def contingencies(self, plan_id: str, at_slot: int) -> list[WhatIf]:
        """Return, for each UAV, what users get if it is lost at that slot."""
        path = f"/v1/plans/{plan_id}/contingencies"
        table = await self._rest.call("GET", path, at_slot=at_slot, wait_s=30)
        planned = table["mean_sum_rate_bps"]
        return [WhatIf.model_validate({**row, "planned_bps": planned}) for row in table["rows"]]

    # --- fleet and operations ---

    async def vehicles(self) -> list[Vehicle]:
        """Return all registered vehicles."""
        return [Vehicle.model_validate(row) for row in await self._rest.call("GET", "/v1/fleet/vehicles")]

    async def start(
        self, plan_id: str, systems: Mapping[str, int], policy: str, disruption_weight: float | None = None
    ) -> Operation:
        """Register the vehicles that are not registered yet, and fly the plan.

        disruption_weight: what a recovery's change must be worth, kbit/s; None: as the service is set.
        """
        for uav_id, system_id in systems.items():
            await self._rest.call("POST", "/v1/fleet/vehicles", json={"uav_id": uav_id, "system_id": system_id})
        body = {"plan_id": plan_id, "replanning": policy, "disruption_weight": disruption_weight}
        return _operation(await self._rest.call("POST", "/v1/operations", json=body))

    async def operations(self, limit: int = 50) -> list[OperationLine]:
        """Return stored operations, the newest first."""
        page = await self._rest.call("GET", "/v1/operations", limit=limit)
        return [OperationLine.model_validate(row) for row in page["items"]]

    async def operation(self, operation_id: str) -> Operation:
        """Return an operation as it is now, with every step of its recoveries."""
        path = f"/v1/operations/{operation_id}"
        body = await self._rest.call("GET", path)
        happened = body["lost"] or body["recoveries"] or body["returned"]
        return _operation(body, await self._rest.call("GET", f"{path}/journal") if happened else ())

    async def track(self, operation_id: str) -> list[TrackPoint]:
        """Return where every UAV of an operation was, at two points per fleet second."""
        points: list[TrackPoint] = []
        path = f"/v1/operations/{operation_id}/track"
        while True:
            after_s = points[-1].elapsed_s if points else None
            some = _TRACK.validate_json(await self._rest.text("GET", path, after_s=after_s, limit=TRACK_AT_ONCE))
            points += some
            if len(some) < TRACK_AT_ONCE:
                return points

    async def pause(self, operation_id: str) -> None:
        """Pause an operation: its vehicles hold until it is resumed."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:pause")

    async def resume(self, operation_id: str) -> None:
        """Resume an operation after a pause."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:resume")

    async def abort(self, operation_id: str, action: str) -> None:
        """End an operation: every vehicle that is heard holds (`hold`), returns home (`return`) or lands (`land`)."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:abort", json={"action": action})

    async def order(self, action: str) -> list[OrderResult]:
        """Make every vehicle that is heard and in the air hold, return home or land now, whatever it is doing."""
        return [
            OrderResult.model_validate(row) for row in await self._rest.call("POST", f"/v1/fleet:{action}", json={})
        ]

    async def decide(self, operation_id: str, incident: int, *, agreed: bool) -> None:
        """Approve the proposed plan, or decline it and keep the plan in force."""
        verb = "approve" if agreed else "decline"
        await self._rest.call("POST", f"/v1/operations/{operation_id}/incidents/{incident}:{verb}")

    async def readmit(self, operation_id: str, uav_id: str) -> None:
        """Readmit a UAV that was lost and is heard again."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:readmit", json={"uav_id": uav_id})

    async def retire(self, operation_id: str, uav_id: str) -> None:
        """Send a UAV home and replan without it."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:retire", json={"uav_id": uav_id})

    # --- drills ---

    async def faults(self) -> list[str]:
        """Return the names of the faults that a drill can inject without further options."""
        return sorted(name for name in FAULTS if _complete(name))

    async def drill(self, operation_id: str, uav_id: str, fault: str, at_slot: int | None) -> Drill:
        """Inject a fault into a simulated UAV when that slot begins, or at once."""
        body = {"operation_id": operation_id, "uav_id": uav_id, "fault": fault, "at_slot": at_slot}
        return Drill.model_validate(await self._rest.call("POST", "/v1/drills", json=body))

    async def newest_drill(self) -> Drill | None:
        """Return the drill that was started last."""
        page = await self._rest.call("GET", "/v1/drills", limit=1)
        return Drill.model_validate(page["items"][0]) if page["items"] else None

    async def drill_now(self, drill_id: str) -> Drill:
        """Return a drill as it is now."""
        return Drill.model_validate(await self._rest.call("GET", f"/v1/drills/{drill_id}"))

    # --- events ---

    async def log(self, after: int, limit: int = 500) -> list[ServiceEvent]:
        """Return the stored events after that id, at most `limit`."""
        page = await self._rest.call("GET", "/v1/events/log", after=after, limit=limit)
        return [ServiceEvent.model_validate(event) for event in page["items"]]

    async def last_event_id(self) -> int:
        """Return the id of the newest stored event, found by bisection because the log may be long."""
        high = 1
        while await self.log(high - 1, 1):
            high *= 2
        low = high // 2
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if await self.log(middle - 1, 1) else (low, middle)
        return low

    async def events(self, after: int) -> AsyncIterator[ServiceEvent]:
        """Yield every event after that id, and then each new one."""
        async for event in self._rest.stream("/v1/events", after):
            yield ServiceEvent.model_validate(event)


def _complete(fault: str) -> bool:
    """Return whether the fault needs no further options."""
    try:
        fault_from({"kind": fault, "system_id": 1})
    except (TypeError, ValueError):
        return False
    return True


def _finished(text: str) -> Plan:
    """Return the plan, validated while it is parsed: a detour by Python objects would block the event loop."""
    known = PlanState.model_validate_json(text)
    if known.trajectories_m is not None:
        return Plan.model_validate_json(text)
    if known.status in ENDED:
        raise RestError(422, f"The plan is {known.status}", known.error or "it has no result")
    raise RestError(202, "Not finished", f"plan {known.id} is still {known.status}")


def _operation(body: Mapping[str, Any], journal: Sequence[Mapping[str, Any]] = ()) -> Operation:
    over = body["state"] in OVER
    shown = recoveries(body["recoveries"], journal, body["proposal"], over=over)
    ends = {uav: seen["end"] for uav, seen in body["uavs"].items() if seen["end"] is not None}
    return Operation.model_validate({**body, "policy": body["replanning"], "recoveries": shown, "ends": ends})
