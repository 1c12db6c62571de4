"""Why a vehicle or a UAV of an operation is in the state that a table shows, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.flights.operation_views import OperationView


def of_vehicle(vehicle: VehicleView) -> str:
    """Return why a vehicle is not well; nothing for one that is."""
    if vehicle.condition not in {None, "live"} and vehicle.condition_cause:
        return f"{str(vehicle.condition).replace('_', ' ')}: {vehicle.condition_cause}"
    if vehicle.link != "live":
        silent = vehicle.silent_for_s
        return "not heard yet" if silent is None else f"silent for {silent:.1f} s"
    return ""


def of_uav(view: OperationView, uav: str, vehicles: Mapping[str, VehicleView]) -> str:
    """Return what is to be said of a UAV of an operation: why it was lost, what it did not do, what is offered."""
    vehicle = vehicles.get(uav)
    said = [*_lost(view, uav)]
    if view.abort is not None and view.abort.vehicles.get(uav):
        said.append(f"{view.abort.action} failed: {view.abort.vehicles[uav]}")
    if uav in view.returned:
        said.append("heard again: it can be readmitted")
    if uav in view.low_on_battery:
        said.append("low on battery: it can be retired")
    if vehicle is not None and (of_it := of_vehicle(vehicle)):
        said.append(of_it)
    return "; ".join(said)


def of_operation(view: OperationView) -> Iterator[str]:
    """Yield why an operation is as it is, and what it waits for."""
    if view.error:
        yield f"error: {view.error}"
    if view.abort is not None:
        yield f"ended by an order to {view.abort.action}"
    if view.proposal is not None:
        who = ", ".join(view.proposal.lost) or "a change"
        yield f"waits for approval of {view.proposal.plan_id} (incident {view.proposal.incident}: {who})"
    if view.owner:
        yield f"flown by service {view.owner}"


def _lost(view: OperationView, uav: str) -> Iterator[str]:
    report = next((report for report in reversed(view.recoveries) if uav in report.lost), None)
    if report is not None:
        yield f"{report.cause.replace('_', ' ')} at {report.lost[uav]:.1f} s"
    elif uav in view.lost:
        yield "lost"
