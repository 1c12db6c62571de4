"""`skyfolio fleet`: which vehicle is which UAV of a service, and orders to them."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from skyfolio.api.cli import reasons
from skyfolio.api.cli.files import Json, write
from skyfolio.api.cli.lazy import application
from skyfolio.api.cli.remote import LOCAL, Key, ReportingClient, ServiceUrl
from skyfolio.api.fleet.commander import Action
from skyfolio.api.fleet.vehicle_view import VehicleView

fleet = application("Register and list the vehicles of a service, and order them.")
UavIds = Annotated[list[str] | None, typer.Argument(help="Which UAVs; default: all that are registered.")]
Force = Annotated[bool, typer.Option("--force", help="Also vehicles that a human or a failsafe flies.")]


@fleet.command()
def register(
    uav_id: Annotated[str, typer.Argument(help="The UAV, as scenarios name it.")],
    system_id: Annotated[int, typer.Argument(min=1, max=255, help="MAVLink system id of the vehicle that flies it.")],
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Tie a UAV of scenarios to the vehicle that flies it; show how it is heard."""
    with ReportingClient(service, key) as client:
        _show([client.register(uav_id, system_id)], as_json=as_json)


@fleet.command("list")
def list_vehicles(service: ServiceUrl = LOCAL, key: Key = None, as_json: Json = False) -> None:
    """List all registered vehicles as they were last heard, with the reason of what is wrong with them."""
    with ReportingClient(service, key) as client:
        _show(client.vehicles(), as_json=as_json)


@fleet.command()
def hold(uav_ids: UavIds = None, service: ServiceUrl = LOCAL, key: Key = None, as_json: Json = False) -> None:
    """Let vehicles hover where they are, now, whatever they do; status 1 when one does not obey.

    A vehicle that a human or a failsafe flies is never made to hold.
    """
    _order("hold", uav_ids, service, key, as_json=as_json)


@fleet.command("return")
def return_home(
    uav_ids: UavIds = None, force: Force = False, service: ServiceUrl = LOCAL, key: Key = None, as_json: Json = False
) -> None:
    """Send vehicles home, now, whatever they do; status 1 when one does not obey."""
    _order("return", uav_ids, service, key, force=force, as_json=as_json)


@fleet.command()
def land(
    uav_ids: UavIds = None, force: Force = False, service: ServiceUrl = LOCAL, key: Key = None, as_json: Json = False
) -> None:
    """Land vehicles where they are, now, whatever they do; status 1 when one does not obey."""
    _order("land", uav_ids, service, key, force=force, as_json=as_json)


def _order(
    action: Action,
    uav_ids: list[str] | None,
    service: str,
    key: str | None,
    *,
    as_json: bool,
    force: bool = False,
) -> None:
    with ReportingClient(service, key) as client:
        results = client.order(action, uav_ids or None, force=force)
    if as_json:
        write(json.dumps([result.model_dump(mode="json") for result in results], indent=2), None)
    else:
        table = Table("uav", "outcome", "reason", title=f"ordered to {action}")
        for result in results:
            table.add_row(result.uav_id, result.outcome.replace("_", " "), result.reason or "")
        Console().print(table)
    if any(result.outcome == "failed" for result in results):
        raise typer.Exit(1)


def _show(vehicles: list[VehicleView], *, as_json: bool) -> None:
    if as_json:
        write(json.dumps([vehicle.model_dump(mode="json") for vehicle in vehicles], indent=2), None)
        return
    table = Table("uav", "system", "link", "mode", "battery, %", "altitude, m", "reason")
    for vehicle in vehicles:
        table.add_row(
            vehicle.uav_id,
            f"{vehicle.system_id}{' (simulated)' if vehicle.simulated else ''}",
            vehicle.link,
            vehicle.mode or "-",
            "-" if vehicle.battery_percent is None else f"{vehicle.battery_percent:.0f}",
            "-" if vehicle.relative_alt_m is None else f"{vehicle.relative_alt_m:.1f}",
            reasons.of_vehicle(vehicle),
        )
    Console().print(table)
