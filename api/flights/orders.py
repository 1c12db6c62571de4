"""Orders of the operator to vehicles, in every state of every operation and without one: hold, land, return.

Each registered vehicle that is heard is told at once, and answers for itself. Operations give way: they leave such a
vehicle alone before it is told, go on without it, or end with the last one. A human or a failsafe is never made to
hold; landing or returning a vehicle that they fly takes `force`.
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

    `ok`: it is seen to do so. `operation_id`: the operation that gave way.
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
        """Order these vehicles, or all: one result for each, by UAV id. Raises NotFoundError before anybody is told."""
        addressed = self._addressed(uavs)
        if not addressed:
            return []
        reasons = {uav: reason_to_leave_alone(self._fleet, uav, action, force=force) for uav in addressed}
        told = [uav for uav, reason in reasons.items() if reason is None]
        owners = self._operations.owners()
        results = asyncio.ensure_future(self._order(action, told))
        endings = self._operations.yield_to_operator(addressed, told, action, results)  # before the first is told
        errors = await asyncio.shield(results)
        await asyncio.gather(*endings)
        given = [_result(uav, reasons[uav], errors.get(uav), owners.get(uav)) for uav in addressed]
        self._note(action, given, force=force)
        return given

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

    def _note(self, action: Action, given: Iterable[OrderResult], *, force: bool) -> None:
        said = [one.model_dump(mode="json", exclude_none=True) for one in given]
        level = "warning" if any(one["outcome"] == "failed" for one in said) else "ok"
        self._fleet.note("fleet_order", action=action, force=force, level=level, vehicles=said)


def _result(uav: str, reason: str | None, error: str | None, operation_id: str | None) -> OrderResult:
    if reason is not None:
        return OrderResult(uav_id=uav, outcome="left_alone", reason=reason)
    outcome: Literal["ok", "failed"] = "ok" if error is None else "failed"
    return OrderResult(uav_id=uav, outcome=outcome, reason=error, operation_id=operation_id)
