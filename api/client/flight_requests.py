"""Requests about vehicles and operations: register, fly, command, decide, drill."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Any, Literal

from skyfolio.api.client.transport import Transport
from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.flights.allocations import Acknowledgement, AllocationsView
from skyfolio.api.flights.drills import DrillView
from skyfolio.api.flights.endless.relief_terms import ReliefTerms
from skyfolio.api.flights.guidance_options import Mode
from skyfolio.api.flights.journal import Entry
from skyfolio.api.flights.measured_rates import Measurement
from skyfolio.api.flights.operation_views import OperationRow, OperationView, Policy
from skyfolio.api.flights.orders import OrderResult
from skyfolio.api.webhooks.delivery import WebhookTrial
from skyfolio.api.webhooks.hooks import WebhookView


class FlightRequests(Transport):
    """The part of the client that flies."""

    def register(self, uav_id: str, system_id: int) -> VehicleView:
        """Tie a UAV id to a MAVLink system id."""
        body = {"uav_id": uav_id, "system_id": system_id}
        return VehicleView.model_validate_json(self.call("POST", "/v1/fleet/vehicles", json=body).content)

    def vehicles(self) -> list[VehicleView]:
        """Return all registered vehicles."""
        return [VehicleView.model_validate(row) for row in self.call("GET", "/v1/fleet/vehicles").json()]

    def order(self, action: Action, uav_ids: Sequence[str] | None = None, *, force: bool = False) -> list[OrderResult]:
        """Let these vehicles (None: all) hold, land or return now, whatever they do; a result for each.

        force: also from a human or a failsafe, but never to hold.
        """
        body = {"uav_ids": None if uav_ids is None else list(uav_ids)} | ({"force": True} if force else {})
        return [OrderResult.model_validate(row) for row in self.call("POST", f"/v1/fleet:{action}", json=body).json()]

    def fly(
        self,
        plan_id: str,
        *,
        replanning: Policy = "auto",
        disruption_weight: float | None = None,
        launch: Literal["auto", "manual"] = "auto",
        guidance: Mode = "mission",
        stream_fallback: Literal["mission", "hold"] = "mission",
        force_stream: bool = False,
        at_end: Literal["land", "return"] | None = None,
        horizon_slots: int | None = None,
        replan_every_slots: int | None = None,
        duration_s: float | None = None,
        until: datetime | None = None,
        relief: ReliefTerms | None = None,
        key: str | None = None,
    ) -> OperationView:
        """Start an operation. disruption_weight: what a recovery's change must be worth, kbit/s; None: the setting.

        horizon_slots, replan_every_slots, duration_s (fleet seconds), until, relief: any of them makes it one without
        a fixed end, whose plan is extended in flight.
        """
        body = {
            "plan_id": plan_id,
            "replanning": replanning,
            "disruption_weight": disruption_weight,
            "launch": launch,
            "guidance": guidance,
            "stream_fallback": stream_fallback,
            "force_stream": force_stream,
            "at_end": at_end,
            "horizon_slots": horizon_slots,
            "replan_every_slots": replan_every_slots,
            "duration_s": duration_s,
            "until": None if until is None else until.isoformat(),
            "relief": None if relief is None else relief.model_dump(mode="json"),
        }
        return self._operation("POST", "/v1/operations", json=body, key=key)

    def operation(self, operation_id: str) -> OperationView:
        """Return the state of an operation."""
        return self._operation("GET", f"/v1/operations/{operation_id}")

    def operations(self) -> Iterator[OperationRow]:
        """Return all operations, the newest first."""
        return self.pages("/v1/operations", OperationRow)

    def command(
        self,
        /,
        operation_id: str,
        verb: Literal["start", "pause", "resume", "abort", "readmit", "retire", "extend"],
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
        rows = self.call("GET", f"/v1/operations/{operation_id}/journal").json()
        return [Entry.model_validate(row) for row in rows]

    def allocations(self, operation_id: str) -> AllocationsView:
        """Return what the base station of each UAV must serve now and next."""
        answer = self.call("GET", f"/v1/operations/{operation_id}/allocations")
        return AllocationsView.model_validate_json(answer.content)

    def acknowledge(self, operation_id: str, uav_id: str, revision: int) -> Acknowledgement:
        """Say that the base station of a UAV serves by this revision from now on."""
        body = {"uav_id": uav_id, "revision": revision}
        answer = self.call("POST", f"/v1/operations/{operation_id}/allocations:acknowledge", json=body)
        return Acknowledgement.model_validate_json(answer.content)

    def measure(self, operation_id: str, measurements: Sequence[Measurement]) -> int:
        """Report what users get; return how many measurements were new."""
        body = {"measurements": [one.model_dump() for one in measurements]}
        return int(self.call("POST", f"/v1/operations/{operation_id}/measurements", json=body).json()["new"])

    def register_webhook(
        self,
        url: str,
        topics: Sequence[Literal["loss", "approval", "completion"]],
        secret: str,
        *,
        key: str | None = None,
    ) -> WebhookView:
        """Have these topics sent to an address, signed with this secret, from now on."""
        body = {"url": url, "topics": list(topics), "secret": secret}
        return WebhookView.model_validate_json(self.call("POST", "/v1/webhooks", json=body, key=key).content)

    def webhooks(self) -> list[WebhookView]:
        """Return all webhooks, with how far their deliveries are."""
        return [WebhookView.model_validate(row) for row in self.call("GET", "/v1/webhooks").json()]

    def delete_webhook(self, webhook_id: str) -> None:
        """Delete a webhook."""
        self.call("DELETE", f"/v1/webhooks/{webhook_id}")

    def test_webhook(self, webhook_id: str) -> WebhookTrial:
        """Send the topic `test` to a webhook now; how that went."""
        return WebhookTrial.model_validate_json(self.call("POST", f"/v1/webhooks/{webhook_id}:test").content)

    def drill(
        self, /, operation_id: str, uav_id: str, *, fault: str = "kill", at_slot: int | None = None, **options: Any
    ) -> DrillView:
        """Let a fault strike a simulated vehicle."""
        body = {
            "operation_id": operation_id,
            "uav_id": uav_id,
            "fault": fault,
            "at_slot": at_slot,
            "options": options,
        }
        return DrillView.model_validate_json(self.call("POST", "/v1/drills", json=body).content)

    def _operation(self, method: str, path: str, **options: Any) -> OperationView:
        return OperationView.model_validate_json(self.call(method, path, **options).content)
