"""A typed Python client of the service, for scripts, the command line and tests.

    with Client("http://127.0.0.1:8080") as service:
        plan = service.plan(EXAMPLES["paper"](), wait_s=5)
        operation = service.fly(plan.id)
        for event in service.events(last_id=0):
            print(event.kind, event.data)

Methods return the service's own models. An answer that is an error raises `ApiError` with the problem's detail.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Literal, Self, TypeVar

import httpx2
from pydantic import BaseModel

from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.problem import Problem
from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.flights.drills import DrillView
from skyfolio.api.flights.guidance_options import Mode
from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.operation_views import OperationRow, OperationView, Policy
from skyfolio.api.flights.orders import OrderResult
from skyfolio.api.plans.contingencies import ContingencyTable
from skyfolio.api.plans.plan_records import PlanRow, UnfinishedPlan
from skyfolio.api.store.event_log import PROVISIONAL, Event
from skyfolio.planner import Changes, Comparison, Explanation, Pins, Plan, Scenario

Model = TypeVar("Model", bound=BaseModel)
PAGE = 100


class ApiError(ServiceError):
    """The service refused the request; `problem` holds its response."""

    def __init__(self, method: str, path: str, problem: Problem) -> None:
        super().__init__(f"{method} {path}: {problem.status} {problem.detail}")
        self.problem = problem

    @property
    def status(self) -> int:
        """Return the HTTP status."""
        return self.problem.status


class Client:
    """The client of one service. `key` is an API key; `http` replaces the HTTP client (tests pass Starlette's)."""

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8080",
        *,
        key: str | None = None,
        timeout_s: float = 70.0,
        http: httpx2.Client | None = None,
    ) -> None:
        self._http = http or httpx2.Client(base_url=base_url, timeout=timeout_s)
        self._headers = {"Authorization": f"Bearer {key}"} if key else {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    # -- plans ----------------------------------------------------------------------------------------------------

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
        return _plan(self._call("POST", "/v1/plans", json=body, params=params, key=key))

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
        disruption_weight: float = 0.0,
        wait_s: float = 60,
        key: str | None = None,
    ) -> Plan:
        """Return a finished plan from `at_slot` on: for the survivors, and for what else is different.

        disruption_weight: kbit/s of utility that a change of the old plan must be worth.
        """
        lost = [*(changes.failed if changes else ()), *failed]
        rest = changes.model_dump(mode="json", exclude={"failed"}) if changes else {}
        body = {**rest, "failed": lost, "at_slot": at_slot, "positions_m": positions_m, **_pins(pins)}
        if disruption_weight:
            body["disruption_weight"] = disruption_weight
        path = f"/v1/plans/{plan_id}/replans"
        return self._finished(_plan(self._call("POST", path, json=body, params={"wait_s": wait_s}, key=key)))

    def read_plan(self, plan_id: str, *, wait_s: float = 0) -> Plan | UnfinishedPlan:
        """Return a plan, or how far it is."""
        return _plan(self._call("GET", f"/v1/plans/{plan_id}", params={"wait_s": wait_s}))

    def cancel(self, plan_id: str, *, wait_s: float = 0) -> Plan | UnfinishedPlan:
        """Stop a plan; it ends with the best found so far."""
        return _plan(self._call("POST", f"/v1/plans/{plan_id}:cancel", params={"wait_s": wait_s}))

    def plans(self) -> Iterator[PlanRow]:
        """Return all plans, the newest first."""
        return self._pages("/v1/plans", PlanRow)

    def contingencies(self, plan_id: str, *, at_slot: int | None = None, wait_s: float = 60) -> ContingencyTable:
        """Return what users receive for each UAV that could be lost at a slot."""
        params = {"wait_s": wait_s} | ({} if at_slot is None else {"at_slot": at_slot})
        return ContingencyTable.model_validate_json(
            self._call("GET", f"/v1/plans/{plan_id}/contingencies", params=params).content
        )

    def explanation(self, plan_id: str, *, resolves: int = 32, wait_s: float = 60) -> Explanation:
        """Return why a plan is as it is. Raises ApiError when it is not explained within `wait_s`."""
        path = f"/v1/plans/{plan_id}/explanation"
        answer = self._call("GET", path, params={"resolves": resolves, "wait_s": wait_s})
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
        return Comparison.model_validate_json(self._call("POST", "/v1/plans:preview", json=body, params=params).content)

    def import_files(self, files: Mapping[str, bytes], *, base: Scenario | None = None, **settings: Any) -> Scenario:
        """Return the scenario that files describe, by name; base: what the rest is taken from; settings: slots..."""
        sent = [{"name": name, "content_base64": b64encode(content).decode()} for name, content in files.items()]
        body = {"files": sent, "base": base and base.model_dump(mode="json"), "settings": settings}
        answer = self._call("POST", "/v1/scenarios:import", json=body)
        return Scenario.model_validate(answer.json()["scenario"])

    def export(self, plan_id: str, form: Literal["geojson", "kml", "csv"] = "geojson") -> str:
        """Return a plan as a file for maps and spreadsheets."""
        return self._call("GET", f"/v1/plans/{plan_id}/export", params={"format": form}).text

    # -- flying ---------------------------------------------------------------------------------------------------

    def register(self, uav_id: str, system_id: int) -> VehicleView:
        """Tie a UAV id to a MAVLink system id."""
        body = {"uav_id": uav_id, "system_id": system_id}
        return VehicleView.model_validate_json(self._call("POST", "/v1/fleet/vehicles", json=body).content)

    def vehicles(self) -> list[VehicleView]:
        """Return all registered vehicles."""
        return [VehicleView.model_validate(row) for row in self._call("GET", "/v1/fleet/vehicles").json()]

    def order(self, action: Action, uav_ids: Sequence[str] | None = None, *, force: bool = False) -> list[OrderResult]:
        """Let these vehicles (None: all) hold, land or return now, whatever they do; a result for each.

        force: also from a human or a failsafe, but never to hold.
        """
        body = {"uav_ids": None if uav_ids is None else list(uav_ids)} | ({"force": True} if force else {})
        return [OrderResult.model_validate(row) for row in self._call("POST", f"/v1/fleet:{action}", json=body).json()]

    def fly(
        self,
        plan_id: str,
        *,
        replanning: Policy = "auto",
        launch: Literal["auto", "manual"] = "auto",
        guidance: Mode = "mission",
        stream_fallback: Literal["mission", "hold"] = "mission",
        force_stream: bool = False,
        at_end: Literal["land", "return"] = "land",
        key: str | None = None,
    ) -> OperationView:
        """Start an operation."""
        body = {
            "plan_id": plan_id,
            "replanning": replanning,
            "launch": launch,
            "guidance": guidance,
            "stream_fallback": stream_fallback,
            "force_stream": force_stream,
            "at_end": at_end,
        }
        return self._operation("POST", "/v1/operations", json=body, key=key)

    def operation(self, operation_id: str) -> OperationView:
        """Return the state of an operation."""
        return self._operation("GET", f"/v1/operations/{operation_id}")

    def operations(self) -> Iterator[OperationRow]:
        """Return all operations, the newest first."""
        return self._pages("/v1/operations", OperationRow)

    def command(
        self,
        operation_id: str,
        verb: Literal["start", "pause", "resume", "abort", "readmit", "retire"],
        *,
        version: int | None = None,
        **body: Any,
    ) -> OperationView:
        """Command an operation; with `version`, only if it still has that version."""
        headers = {} if version is None else {"If-Match": f'"{operation_id}.{version}"'}
        return self._operation("POST", f"/v1/operations/{operation_id}:{verb}", json=body or None, headers=headers)

    def decide(self, operation_id: str, incident: int, *, agreed: bool) -> OperationView:
        """Approve or decline a proposed plan."""
        verb = "approve" if agreed else "decline"
        return self._operation("POST", f"/v1/operations/{operation_id}/incidents/{incident}:{verb}")

    def journal(self, operation_id: str) -> list[Entry]:
        """Return every step of every incident."""
        rows = self._call("GET", f"/v1/operations/{operation_id}/journal").json()
        return [Entry.model_validate(row) for row in rows]

    def drill(
        self, operation_id: str, uav_id: str, *, fault: str = "kill", at_slot: int | None = None, **options: Any
    ) -> DrillView:
        """Let a fault strike a simulated vehicle."""
        body = {
            "operation_id": operation_id,
            "uav_id": uav_id,
            "fault": fault,
            "at_slot": at_slot,
            "options": options,
        }
        return DrillView.model_validate_json(self._call("POST", "/v1/drills", json=body).content)

    # -- events ---------------------------------------------------------------------------------------------------

    def events(self, last_id: int = 0, *, follow: bool = True) -> Iterator[Event]:
        """Yield events after `last_id`, then each new one as it comes; without `follow`, until the last one stored.

        While the service cannot store events they arrive late here, each with its number (`provisional` is left
        out).
        """
        headers = {**self._headers, "Last-Event-ID": str(last_id)}
        with self._http.stream(
            "GET", "/v1/events", headers=headers, params={"follow": follow}, timeout=httpx2.Timeout(70.0)
        ) as stream:
            if stream.status_code >= 400:
                stream.read()
                _raise_for(stream, "GET", "/v1/events")
            kind = ""
            for line in stream.iter_lines():
                if line.startswith("event: "):
                    kind = line.removeprefix("event: ")
                elif line.startswith("data: ") and kind != PROVISIONAL:
                    yield Event.model_validate_json(line.removeprefix("data: "))

    # -- inside ---------------------------------------------------------------------------------------------------

    def _call(self, method: str, path: str, *, key: str | None = None, **options: Any) -> httpx2.Response:
        headers = {**self._headers, **options.pop("headers", {})}
        if key is not None:
            headers["Idempotency-Key"] = key
        answer = self._http.request(method, path, headers=headers, **options)
        _raise_for(answer, method, path)
        return answer

    def _operation(self, method: str, path: str, **options: Any) -> OperationView:
        return OperationView.model_validate_json(self._call(method, path, **options).content)

    def _finished(self, plan: Plan | UnfinishedPlan) -> Plan:
        if isinstance(plan, Plan):
            return plan
        detail = f"plan {plan.id} is {plan.status.value}: {plan.error or 'not finished in time'}"
        raise ApiError(
            "GET", f"/v1/plans/{plan.id}", Problem(type="client", title="No plan", status=409, detail=detail)
        )

    def _pages(self, path: str, row: type[Model]) -> Iterator[Model]:
        cursor: int | None = None
        while True:
            params = {"limit": PAGE} | ({} if cursor is None else {"cursor": cursor})
            page = self._call("GET", path, params=params).json()
            yield from (row.model_validate(item) for item in page["items"])
            cursor = page["next"]
            if cursor is None:
                return


def _raise_for(answer: httpx2.Response, method: str, path: str) -> None:
    if answer.status_code < 400:
        return
    try:
        problem = Problem.model_validate(answer.json())
    except (json.JSONDecodeError, ValueError):
        problem = Problem(type="unknown", title="Error", status=answer.status_code, detail=answer.text[:500])
    raise ApiError(method, path, problem)


def _pins(pins: Pins | None) -> dict[str, Any]:
    """Return the part of a request's body that holds the pins: nothing without any."""
    return {"pins": pins.model_dump(mode="json")} if pins else {}


def _plan(answer: httpx2.Response) -> Plan | UnfinishedPlan:
    if "trajectories_m" in answer.json():
        return Plan.model_validate_json(answer.content)
    return UnfinishedPlan.model_validate_json(answer.content)
