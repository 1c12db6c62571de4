"""The operator's orders to vehicles, in every state of every operation and without one: hold, land, return.

Each registered vehicle that is heard is ordered at once, and has a result of its own. Operations yield: they leave such
a vehicle alone before it is sent the order, and go on without it, or end with their last one. A vehicle that a human or
a failsafe flies is never made to hold; to land or return it takes `force`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable
from typing import Literal

from pydantic import BaseModel

from skyfolio.api.common.errors import NotFoundError
from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.order_rules import reason_to_leave_alone
from skyfolio.api.fleet.registry import Fleet
from skyfolio.api.flights.operations import Operations


class OrderResult(BaseModel):
    """What became of an order to one vehicle. `reason`: why it was left alone, or what went wrong.

    `ok`: it is seen to obey. `operation_id`: the operation that yielded.
    """

    uav_id: str
    outcome: Literal["ok", "failed", "left_alone"]
    reason: str | None = None
    operation_id: str | None = None


class Orders:
    """Gives orders to the vehicles of the fleet."""

    def __init__(self, fleet: Fleet, operations: Operations) -> None:
        self._fleet, self._operations = fleet, operations

    async def give(
        self, action: Action, uavs: Collection[str] | None = None, *, force: bool = False
    ) -> list[OrderResult]:
        """Order these vehicles, or all; return one result for each, by UAV id.

        Raises NotFoundError before any vehicle is ordered.
        """
        addressed = self._addressed(uavs)
        if not addressed:
            return []
        reasons = {uav: reason_to_leave_alone(self._fleet, uav, action, force=force) for uav in addressed}
        ordered = [uav for uav, reason in reasons.items() if reason is None]
        owners = self._operations.owners()
        results = asyncio.ensure_future(self._order(action, ordered))
        endings = self._operations.yield_to_operator(addressed, ordered, action, results)  # before any order is sent
        errors = await asyncio.shield(results)
        await asyncio.gather(*endings)
        order_results = [_result(uav, reasons[uav], errors.get(uav), owners.get(uav)) for uav in addressed]
        self._report(action, order_results, force=force)
        return order_results

    def _addressed(self, uavs: Collection[str] | None) -> list[str]:
        known = self._fleet.uav_ids
        unknown = sorted(set(uavs or ()).difference(known))
        if unknown:
            raise NotFoundError(f"vehicle {unknown[0]!r} does not exist")
        return known if uavs is None else [uav for uav in known if uav in uavs]

    async def _order(self, action: Action, uavs: Iterable[str]) -> dict[str, str | None]:
        systems = {self._fleet.system_of(uav): uav for uav in uavs}
        errors = await self._fleet.commander.order(action, systems)
        return {systems[system]: error for system, error in errors.items()}

    def _report(self, action: Action, results: Iterable[OrderResult], *, force: bool) -> None:
        vehicles = [result.model_dump(mode="json", exclude_none=True) for result in results]
        level = "warning" if any(vehicle["outcome"] == "failed" for vehicle in vehicles) else "ok"
        self._fleet.note("fleet_order", action=action, force=force, level=level, vehicles=vehicles)


def _result(uav: str, reason: str | None, error: str | None, operation_id: str | None) -> OrderResult:
    if reason is not None:
        return OrderResult(uav_id=uav, outcome="left_alone", reason=reason)
    outcome: Literal["ok", "failed"] = "ok" if error is None else "failed"
    return OrderResult(uav_id=uav, outcome=outcome, reason=error, operation_id=operation_id)
