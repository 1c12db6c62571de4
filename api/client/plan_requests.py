"""Requests about plans: import what is planned, make, replan, explain, preview, put through disturbances, export."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import httpx2

from skyfolio.api.client.transport import ApiError, Transport
from skyfolio.api.common.problem import Problem
from skyfolio.api.plans.contingencies import ContingencyTable
from skyfolio.api.plans.plan_records import PlanRow, UnfinishedPlan
from skyfolio.planner import Changes, Comparison, Explanation, Pins, Plan, Robustness, Scenario, Trial


class PlanRequests(Transport):
    """The part of the client that asks for plans."""

    def submit(
        self,
        scenario: Scenario,
        *,
        pins: Pins | None = None,
        wait_s: float = 0,
        deadline_s: float | None = None,
        key: str | None = None,
    ) -> Plan | UnfinishedPlan:
        """Ask for a plan that keeps `pins`; `key` makes it safe to ask again."""
        params = {"wait_s": wait_s} | ({"deadline_s": deadline_s} if deadline_s else {})
        body = {**scenario.model_dump(mode="json"), **_pins(pins)}
        return _plan(self.call("POST", "/v1/plans", json=body, params=params, key=key))

    def plan(
        self, scenario: Scenario, *, pins: Pins | None = None, wait_s: float = 60, deadline_s: float | None = None
    ) -> Plan:
        """Plan a scenario and return the finished plan. Raises ApiError when it has no result within `wait_s`."""
        return self._finished(self.submit(scenario, pins=pins, wait_s=wait_s, deadline_s=deadline_s))

    def replan(
        self,
        plan_id: str,
        *,
        failed: Sequence[str] = (),
        at_slot: int,
        positions_m: Mapping[str, tuple[float, float]] | None = None,
        changes: Changes | None = None,
        pins: Pins | None = None,
        keep_pins: bool = False,
        disruption_weight: float = 0.0,
        wait_s: float = 60,
        key: str | None = None,
    ) -> Plan:
        """Return a finished plan from `at_slot` on: for the survivors, and for what else is different.

        keep_pins: those of the old plan hold too, as far as they can. disruption_weight: kbit/s of utility that a
        change of the old plan must be worth.
        """
        lost = [*(changes.failed if changes else ()), *failed]
        rest = changes.model_dump(mode="json", exclude={"failed"}) if changes else {}
        body = {**rest, "failed": lost, "at_slot": at_slot, "positions_m": positions_m, **_pins(pins)}
        body |= ({"keep_pins": True} if keep_pins else {}) | _weight(disruption_weight or None)
        path = f"/v1/plans/{plan_id}/replans"
        return self._finished(_plan(self.call("POST", path, json=body, params={"wait_s": wait_s}, key=key)))

    def read_plan(self, plan_id: str, *, wait_s: float = 0) -> Plan | UnfinishedPlan:
        """Return a plan, or how far it is."""
        return _plan(self.call("GET", f"/v1/plans/{plan_id}", params={"wait_s": wait_s}))

    def cancel(self, plan_id: str, *, wait_s: float = 0) -> Plan | UnfinishedPlan:
        """Stop a plan; it ends with the best found so far."""
        return _plan(self.call("POST", f"/v1/plans/{plan_id}:cancel", params={"wait_s": wait_s}))

    def plans(self) -> Iterator[PlanRow]:
        """Return all plans, the newest first."""
        return self.pages("/v1/plans", PlanRow)

    def contingencies(
        self, plan_id: str, *, at_slot: int | None = None, disruption_weight: float | None = None, wait_s: float = 60
    ) -> ContingencyTable:
        """Return what users receive for each UAV that could be lost at a slot, by the setting's weight by default."""
        params = {"wait_s": wait_s} | ({} if at_slot is None else {"at_slot": at_slot}) | _weight(disruption_weight)
        return ContingencyTable.model_validate_json(
            self.call("GET", f"/v1/plans/{plan_id}/contingencies", params=params).content
        )

    def explanation(self, plan_id: str, *, resolves: int = 32, wait_s: float = 60) -> Explanation:
        """Return why a plan is as it is. Raises ApiError when it is not explained within `wait_s`."""
        path = f"/v1/plans/{plan_id}/explanation"
        answer = self.call("GET", path, params={"resolves": resolves, "wait_s": wait_s})
        if answer.status_code == 202:
            detail = f"the explanation of plan {plan_id} was not ready in time"
            raise ApiError("GET", path, Problem(type="client", title="No explanation", status=409, detail=detail))
        return Explanation.model_validate_json(answer.content)

    def preview(
        self,
        plan_id: str,
        *,
        scenario: Scenario | None = None,
        at_slot: int | None = None,
        changes: Changes | None = None,
        deadline_s: float | None = None,
    ) -> Comparison:
        """Compare a plan with a changed scenario, or with changes from `at_slot` on; nothing is stored."""
        body: dict[str, Any] = {"plan_id": plan_id}
        if scenario is not None:
            body["scenario"] = scenario.model_dump(mode="json")
        if at_slot is not None or changes is not None:
            body["changes"] = {**(changes or Changes()).model_dump(mode="json"), "at_slot": at_slot}
        params = {} if deadline_s is None else {"deadline_s": deadline_s}
        return Comparison.model_validate_json(self.call("POST", "/v1/plans:preview", json=body, params=params).content)

    def robustness(self, plan_id: str, trial: Trial | None = None, *, deadline_s: float | None = None) -> Robustness:
        """Put a plan through disturbances and losses; what there was no time for is in its `notes`."""
        params = {} if deadline_s is None else {"deadline_s": deadline_s}
        path, body = f"/v1/plans/{plan_id}/robustness", (trial or Trial()).model_dump(mode="json")
        return Robustness.model_validate_json(self.call("POST", path, json=body, params=params).content)

    def import_files(self, /, files: Mapping[str, bytes], *, base: Scenario | None = None, **settings: Any) -> Scenario:
        """Return the scenario that files describe, by name; base: what the rest is taken from; settings: slots..."""
        sent = [{"name": name, "content_base64": b64encode(content).decode()} for name, content in files.items()]
        body = {"files": sent, "base": base and base.model_dump(mode="json"), "settings": settings}
        answer = self.call("POST", "/v1/scenarios:import", json=body)
        return Scenario.model_validate(answer.json()["scenario"])

    def export(self, plan_id: str, form: Literal["geojson", "kml", "csv"] = "geojson") -> str:
        """Return a plan as a file for maps and spreadsheets."""
        return self.call("GET", f"/v1/plans/{plan_id}/export", params={"format": form}).text

    def _finished(self, plan: Plan | UnfinishedPlan) -> Plan:
        if isinstance(plan, Plan):
            return plan
        detail = f"plan {plan.id} is {plan.status.value}: {plan.error or 'not finished in time'}"
        raise ApiError(
            "GET", f"/v1/plans/{plan.id}", Problem(type="client", title="No plan", status=409, detail=detail)
        )


def _pins(pins: Pins | None) -> dict[str, Any]:
    """Return the part of a request's body that holds the pins: nothing without any."""
    return {"pins": pins.model_dump(mode="json")} if pins else {}


def _weight(disruption_weight: float | None) -> dict[str, float]:
    """Return the part of a request that holds the weight: nothing where the service's own is meant."""
    return {} if disruption_weight is None else {"disruption_weight": disruption_weight}


def _plan(answer: httpx2.Response) -> Plan | UnfinishedPlan:
    if "trajectories_m" in answer.json():
        return Plan.model_validate_json(answer.content)
    return UnfinishedPlan.model_validate_json(answer.content)
