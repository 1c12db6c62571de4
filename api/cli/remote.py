"""Commands that ask a running service, through the typed client."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import httpx2
import typer
from rich.console import Console
from rich.table import Table

from skyfolio.api.cli import reasons
from skyfolio.api.cli.files import Json, PinsFile, read_as, read_scenario
from skyfolio.api.client import Client
from skyfolio.api.common.configuration import require_known
from skyfolio.api.common.errors import InvalidError, ServiceError
from skyfolio.api.fleet.vehicle_view import VehicleView
from skyfolio.api.flights.operation_views import OperationView
from skyfolio.api.flights.recovery_report import RecoveryReport
from skyfolio.planner import EXAMPLES, Pins

ServiceUrl = Annotated[str, typer.Option(envvar="SKYFOLIO_SERVICE", help="Where the service is.")]
Key = Annotated[str | None, typer.Option(envvar="SKYFOLIO_KEY", help="API key, where one is needed.")]
LOCAL = "http://127.0.0.1:8080"


class UnreachableError(ServiceError):
    """Nothing answers at the service's address."""


def fly(
    scenario: Annotated[Path | None, typer.Argument(help="Scenario as JSON.")] = None,
    example: Annotated[str | None, typer.Option(help=f"Fly a ready scenario: {', '.join(EXAMPLES)}.")] = None,
    pins: PinsFile = None,
    replanning: Annotated[str, typer.Option(help="After a loss: auto, approve or off.")] = "auto",
    disruption_weight: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="kbit/s that a recovery's change must be worth: a user's other UAV throughout, or 100 m off the old "
            "paths. Default: the service's setting.",
        ),
    ] = None,
    guidance: Annotated[str, typer.Option(help="By mission, or by a stream of setpoints.")] = "mission",
    stream_fallback: Annotated[str, typer.Option(help="When the stream ends: fly on by mission, or hold.")] = "mission",
    force_stream: Annotated[
        bool, typer.Option(help="Stream even to a PX4 that would not hold when the stream ends.")
    ] = False,
    at_end: Annotated[str, typer.Option(help="After the last slot: land or return.")] = "land",
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Plan a scenario at the service and fly it with the vehicles registered there.

    Recoveries keep the plan's pins as far as they hold.
    """
    order = {
        "replanning": one_of("replanning", replanning, "auto", "approve", "off"),
        "guidance": one_of("guidance", guidance, "mission", "stream"),
        "stream_fallback": one_of("stream_fallback", stream_fallback, "mission", "hold"),
        "at_end": one_of("at_end", at_end, "land", "return"),
    }
    requested = read_scenario(scenario, example)
    with ReportingClient(service, key) as client:
        plan = client.plan(requested, pins=read_as(Pins, pins) if pins else None)
        options: dict[str, Any] = {**order, "force_stream": force_stream, "disruption_weight": disruption_weight}
        _show(client.fly(plan.id, **options), {}, as_json=as_json)


def one_of(name: str, value: str, *allowed: str) -> str:
    """Return the value. Raises InvalidError naming the option and its allowed values."""
    if value not in allowed:
        raise InvalidError(f"{name}: {value!r} must be one of {', '.join(allowed)}")
    return value


def status(
    operation_id: Annotated[str | None, typer.Argument(help="Operation; default: the newest.")] = None,
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Show the state of an operation and of each of its UAVs, with the reasons."""
    with ReportingClient(service, key) as client:
        wanted_id = operation_id or next((row.id for row in client.operations()), None)
        if wanted_id is None:
            raise InvalidError("operation_id: the service has flown no operation yet")
        view = client.operation(wanted_id)
        vehicles = {} if as_json else {vehicle.uav_id: vehicle for vehicle in client.vehicles()}
        _show(view, vehicles, as_json=as_json)


def drill(
    operation_id: Annotated[str, typer.Argument(help="Operation in the air.")],
    uav_id: Annotated[str, typer.Argument(help="The UAV with the fault; the service must simulate it.")],
    fault: Annotated[str, typer.Option(help="Kind of fault.")] = "kill",
    at_slot: Annotated[int | None, typer.Option(min=0, help="When this slot begins (from 0); default: now.")] = None,
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Inject a fault into a simulated vehicle, to see the service recover."""
    with ReportingClient(service, key) as client:
        drill_view = client.drill(operation_id, uav_id, fault=fault, at_slot=at_slot)
    if as_json:
        _print(drill_view.model_dump_json(indent=2))
    else:
        _print(f"{drill_view.id}: {drill_view.fault} of {drill_view.uav_id} is {drill_view.state.value}")


class ReportingClient(Client):
    """A client whose connection errors are one message."""

    def __init__(self, service: str, key: str | None) -> None:
        require_known(os.environ)
        super().__init__(service, key=key)
        self._where = service

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self.close()
        if isinstance(error, httpx2.TransportError):
            raise UnreachableError(f"service: nothing answers at {self._where} ({error})") from error


def _show(view: OperationView, vehicles: Mapping[str, VehicleView], *, as_json: bool) -> None:
    if as_json:
        _print(json.dumps(view.model_dump(mode="json"), indent=2))
        return
    slot = "-" if view.slot is None else str(view.slot)
    table = Table("uav", "state", "item", "slip, m", "reason", title=f"{view.id}: {view.state.value}, slot {slot}")
    for uav, uav_view in view.uavs.items():
        table.add_row(
            uav,
            uav_view.end or uav_view.state,
            str(uav_view.mission_item or "-"),
            "-" if uav_view.slip_m is None else f"{uav_view.slip_m:.1f}",
            reasons.of_uav(view, uav, vehicles),
        )
    Console().print(table)
    for line in reasons.of_operation(view):
        _print(line)
    for report in view.recoveries:
        why = f": {report.error}" if report.error else ""
        _print(f"{report.cause} of {', '.join(report.lost) or 'none'}: {report.outcome}, plan {report.plan_id}{why}")
        for line in changes(report):
            _print(f"  {line}")


def changes(report: RecoveryReport) -> list[str]:
    """Return what a recovery's plan changes of the one before, in words."""
    lines, made = [], report.disruption
    if made is not None:
        price = f", priced {made.price_bps / 1e3:.2f} kbit/s" if made.weight_kbps > 0.0 else ""
        lines.append(f"{made.users_changed} users change server, {made.path_changed_m:.0f} m off the old paths{price}")
    if report.pins is not None:
        lines.append(f"pins kept: {', '.join([*report.pins.uavs, *report.pins.users]) or 'none'}")
        lines += [f"{pin.kind} pin of {pin.id} dropped: {pin.reason}" for pin in report.pins.dropped]
    return lines


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
