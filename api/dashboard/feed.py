"""The facade: the service's REST and event surface as the pages' views. Nothing else here knows its routes or JSON."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from typing import Any

from api.dashboard.rest import Rest, RestError
from api.dashboard.views import Happening, Operation, Step, Transaction, Vehicle
from planner import Plan, Scenario

ENDED = {"succeeded", "infeasible", "cancelled", "failed", "interrupted"}


class Feed:
    """The service, as one operator sees it. Every method may raise RestError, whose text is fit to be shown."""

    def __init__(self, rest: Rest) -> None:
        self._rest = rest

    # --- plans ---

    async def examples(self) -> list[str]:
        """Names of the ready scenarios."""
        return list((await self._rest.call("GET", "/v1/scenarios/examples"))["examples"])

    async def example(self, name: str) -> Scenario:
        """One ready scenario."""
        return Scenario.model_validate(await self._rest.call("GET", f"/v1/scenarios/examples/{name}"))

    async def make_plan(self, scenario: Scenario, wait_s: float = 60.0) -> Plan:
        """Plan a scenario and wait for the result."""
        body = scenario.model_dump(mode="json")
        return _finished(await self._rest.call("POST", "/v1/plans", json=body, wait_s=wait_s))

    async def what_if(self, plan_id: str, uav_id: str, at_slot: int, wait_s: float = 60.0) -> Plan:
        """The plan for the survivors if this UAV were lost when that slot (of the operation's grid) begins."""
        body = {"failed": [uav_id], "at_slot": at_slot}
        return _finished(await self._rest.call("POST", f"/v1/plans/{plan_id}/replans", json=body, wait_s=wait_s))

    async def plan(self, plan_id: str) -> Plan:
        """A finished plan."""
        return _finished(await self._rest.call("GET", f"/v1/plans/{plan_id}"))

    async def mission_file(self, plan_id: str, uav_id: str) -> Any:
        """One UAV's mission as a QGroundControl `.plan` document."""
        return await self._rest.call("GET", f"/v1/plans/{plan_id}/missions", format="plan", uav_id=uav_id)

    # --- fleet and operations ---

    async def vehicles(self) -> list[Vehicle]:
        """All registered vehicles."""
        return [Vehicle.model_validate(row) for row in await self._rest.call("GET", "/v1/fleet/vehicles")]

    async def start(self, plan_id: str, systems: Mapping[str, int], policy: str) -> Operation:
        """Register what is not registered yet, and fly the plan."""
        for uav_id, system_id in systems.items():
            await self._rest.call("POST", "/v1/fleet/vehicles", json={"uav_id": uav_id, "system_id": system_id})
        body = {"plan_id": plan_id, "replanning": policy}
        return _operation(await self._rest.call("POST", "/v1/operations", json=body))

    async def operation(self, operation_id: str) -> Operation:
        """An operation as it is now."""
        return _operation(await self._rest.call("GET", f"/v1/operations/{operation_id}"))

    async def pause(self, operation_id: str) -> None:
        """Hold, to go on later from the same place."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:pause")

    async def resume(self, operation_id: str) -> None:
        """Go on after a pause."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:resume")

    async def abort(self, operation_id: str, action: str) -> None:
        """End it: every vehicle that answers holds (`hold`) or returns home (`rtl`)."""
        await self._rest.call("POST", f"/v1/operations/{operation_id}:abort", json={"action": action})

    # --- events ---

    async def happenings(self, after: int) -> AsyncIterator[Happening]:
        """Every event after that id, and then each as it comes."""
        async for event in self._rest.stream("/v1/events", after):
            yield Happening.model_validate(event)


def _finished(body: Mapping[str, Any]) -> Plan:
    if "trajectories_m" in body:
        return Plan.model_validate(body)
    status = str(body["status"])
    if status in ENDED:
        raise RestError(422, f"The plan is {status}", str(body.get("error") or "it has no result"))
    raise RestError(202, "Not finished", f"plan {body['id']} is still {status}")


def _operation(body: Mapping[str, Any]) -> Operation:
    recoveries = [_transaction(number, each) for number, each in enumerate(body.get("recoveries", []), start=1)]
    return Operation.model_validate({**body, "policy": body["replanning"], "transactions": recoveries})


def _transaction(number: int, body: Mapping[str, Any]) -> Transaction:
    """A recovery as the steps it went through."""
    steps = [
        Step(name="Loss declared", took=f"{max(body['lost'].values()):.1f} s silent", detail=", ".join(body["lost"]))
    ]
    if body["replan_ms"] is not None:
        steps.append(Step(name="Replanned", took=f"{body['replan_ms']:.0f} ms", detail=f"from slot {body['at_slot']}"))
    if body["upload_s"] is not None:
        steps.append(
            Step(name="Uploaded and verified", took=f"{body['upload_s'] * 1e3:.0f} ms", detail=_each(body["vehicles"]))
        )
    if body["in_force_at_s"] is not None:
        after = body["in_force_at_s"] - body["declared_at_s"]
        steps.append(Step(name="Flying the new plan", took=f"{after:.1f} s after declaration"))
    if body["error"]:
        steps.append(Step(name=body["outcome"].replace("_", " ").capitalize(), detail=body["error"], state="failed"))
    return Transaction.model_validate({**body, "number": number, "phase": body["outcome"], "steps": steps})


def _each(results: Mapping[str, str | None]) -> str:
    return ", ".join(uav if error is None else f"{uav}: {error}" for uav, error in results.items())
