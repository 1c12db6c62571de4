"""Commands that ask a running service, through the typed client."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated

import httpx2
import typer
from rich.console import Console
from rich.table import Table

from skyfolio.api.cli.files import Json, read_scenario
from skyfolio.api.client import Client
from skyfolio.api.common.configuration import require_known
from skyfolio.api.common.errors import InvalidError, ServiceError
from skyfolio.api.flights.operation_views import OperationView
from skyfolio.planner import EXAMPLES

ServiceUrl = Annotated[str, typer.Option(envvar="SKYFOLIO_SERVICE", help="Where the service is.")]
Key = Annotated[str | None, typer.Option(envvar="SKYFOLIO_KEY", help="API key, where one is needed.")]
LOCAL = "http://127.0.0.1:8080"


class UnreachableError(ServiceError):
    """Nobody answers at the service's address."""


def fly(
    scenario: Annotated[Path | None, typer.Argument(help="Scenario as JSON.")] = None,
    example: Annotated[str | None, typer.Option(help=f"Fly a ready scenario: {', '.join(EXAMPLES)}.")] = None,
    replanning: Annotated[str, typer.Option(help="After a loss: auto, approve or off.")] = "auto",
    guidance: Annotated[str, typer.Option(help="By mission, or by a stream of setpoints.")] = "mission",
    stream_fallback: Annotated[str, typer.Option(help="When the stream ends: fly on by mission, or hold.")] = "mission",
    force_stream: Annotated[bool, typer.Option(help="Stream even to a PX4 that would not hold without.")] = False,
    at_end: Annotated[str, typer.Option(help="After the last slot: land or return.")] = "land",
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Plan a scenario at the service and fly it with the vehicles registered there."""
    order = {
        "replanning": _one_of("replanning", replanning, "auto", "approve", "off"),
        "guidance": _one_of("guidance", guidance, "mission", "stream"),
        "stream_fallback": _one_of("stream_fallback", stream_fallback, "mission", "hold"),
        "at_end": _one_of("at_end", at_end, "land", "return"),
    }
    wanted = read_scenario(scenario, example)
    with _Asking(service, key) as client:
        plan = client.plan(wanted)
        _show(client.fly(plan.id, force_stream=force_stream, **order), as_json=as_json)  # type: ignore[arg-type]


def _one_of(name: str, value: str, *allowed: str) -> str:
    """Raises InvalidError naming the option and what it may be."""
    if value not in allowed:
        raise InvalidError(f"{name}: {value!r} must be one of {', '.join(allowed)}")
    return value


def status(
    operation_id: Annotated[str | None, typer.Argument(help="Operation; default: the newest.")] = None,
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Show where an operation is, and each of its UAVs."""
    with _Asking(service, key) as client:
        wanted = operation_id or next((row.id for row in client.operations()), None)
        if wanted is None:
            raise InvalidError("operation_id: the service has flown no operation yet")
        _show(client.operation(wanted), as_json=as_json)


def fleet(
    action: Annotated[str, typer.Argument(help="hold, return or land.")],
    uav_ids: Annotated[list[str] | None, typer.Argument(help="Which UAVs; default: all that are registered.")] = None,
    force: Annotated[bool, typer.Option(help="Return or land also who is flown by a human or a failsafe.")] = False,
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Order vehicles of a service to hold, return or land now.

    Whatever they do. Exits with 1 when one does not obey.
    """
    _one_of("action", action, "hold", "return", "land")
    if force and action == "hold":
        raise InvalidError("force: nobody is made to hold whom a human or a failsafe flies")
    with _Asking(service, key) as client:
        given = client.order(action, uav_ids or None, force=force)  # type: ignore[arg-type]
    if as_json:
        _print(json.dumps([one.model_dump(mode="json") for one in given], indent=2))
    else:
        table = Table("uav", "outcome", "reason", title=f"ordered to {action}")
        for one in given:
            table.add_row(one.uav_id, one.outcome.replace("_", " "), one.reason or "")
        Console().print(table)
    if any(one.outcome == "failed" for one in given):
        raise typer.Exit(1)


def drill(
    operation_id: Annotated[str, typer.Argument(help="Operation in the air.")],
    uav_id: Annotated[str, typer.Argument(help="The UAV that is struck; the service must simulate it.")],
    fault: Annotated[str, typer.Option(help="What happens to it.")] = "kill",
    at_slot: Annotated[int | None, typer.Option(min=0, help="When this slot begins (from 0); default: now.")] = None,
    service: ServiceUrl = LOCAL,
    key: Key = None,
    as_json: Json = False,
) -> None:
    """Let a fault strike a simulated vehicle, to see the service answer it."""
    with _Asking(service, key) as client:
        made = client.drill(operation_id, uav_id, fault=fault, at_slot=at_slot)
    if as_json:
        _print(made.model_dump_json(indent=2))
    else:
        _print(f"{made.id}: {made.fault} of {made.uav_id} is {made.state.value}")


class _Asking(Client):
    """A client whose connection errors are one message."""

    def __init__(self, service: str, key: str | None) -> None:
        require_known(os.environ)
        super().__init__(service, key=key)
        self._where = service

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self.close()
        if isinstance(error, httpx2.TransportError):
            raise UnreachableError(f"service: nobody answers at {self._where} ({error})") from error


def _show(view: OperationView, *, as_json: bool) -> None:
    if as_json:
        _print(json.dumps(view.model_dump(mode="json"), indent=2))
        return
    slot = "-" if view.slot is None else str(view.slot)
    table = Table("uav", "state", "item", "slip, m", title=f"{view.id}: {view.state.value}, slot {slot}")
    for uav, said in view.uavs.items():
        table.add_row(
            uav,
            said.end or said.state,
            str(said.mission_item or "-"),
            "-" if said.slip_m is None else f"{said.slip_m:.1f}",
        )
    Console().print(table)
    for report in view.recoveries:
        _print(f"{report.cause} of {', '.join(report.lost) or 'nobody'}: {report.outcome}, plan {report.plan_id}")


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
