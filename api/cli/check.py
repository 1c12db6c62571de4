"""`skyfolio check`: whether an operator's own vehicles are fit to be flown."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from skyfolio.api.cli.files import Json, UsageError, write

if TYPE_CHECKING:
    from skyfolio.api.fleet.vehicle_check import CheckReport, VehicleReport


def check(
    url: Annotated[
        str,
        typer.Argument(
            help="udpin://, udpout://, tcpout://HOST:PORT or serial://DEVICE:BAUD; separate several with commas."
        ),
    ],
    system_id: Annotated[
        list[int] | None, typer.Option(min=1, max=254, help="Check this vehicle only; may be given several times.")
    ] = None,
    wait_s: Annotated[float, typer.Option(min=1, max=600, help="Seconds to wait for a heartbeat.")] = 15.0,
    signing_key_file: Annotated[
        Path | None,
        typer.Option(envvar="SKYFOLIO_SIGNING_KEY_FILE", help="Signing key, where MAVLink is signed."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check vehicles on the ground: audit them, and try what is put on board; then restore what was there.

    Exit status 0: all is well; 1: something prevents a vehicle from being flown; 2: no vehicle answers, or wrong
    usage.
    """
    from skyfolio.api.fleet import vehicle_check as checking  # noqa: PLC0415 - MAVSDK is only loaded where it is used

    urls = tuple(part.strip() for part in url.split(",") if part.strip())
    if not urls:
        raise UsageError("URL: give at least one")
    config = checking.CheckConfig(
        urls=urls, system_ids=tuple(system_id or ()), wait_s=wait_s, signing_key_file=signing_key_file
    )
    progress = Console(stderr=True)
    status = nullcontext() if as_json else progress.status("connecting")
    with status as spinner:
        report = asyncio.run(checking.check(config, (lambda _words: None) if spinner is None else spinner.update))
    if as_json:
        write(report.model_dump_json(indent=2), None)
    else:
        _show(report)
    raise typer.Exit(0 if report.ready else 1)


def _show(report: CheckReport) -> None:
    console = Console()
    for vehicle in report.vehicles:
        title = f"system {vehicle.system_id}, {vehicle.autopilot or 'unknown autopilot'}"
        findings = Table("", "audit", "found", "should be", "why", title=title)
        for finding in vehicle.findings:
            colour = "red" if finding.level.value == "blocker" else "yellow"
            findings.add_row(
                f"[{colour}]{finding.level.value}[/]", finding.name, finding.found, finding.should, finding.why
            )
        console.print(findings if vehicle.findings else f"{title}: the audit has no finding")
        if vehicle.transfers:
            console.print(_transfers(vehicle))
        console.print(f"system {vehicle.system_id}: " + ("[green]ready[/]" if vehicle.ready else "[red]NOT READY[/]"))


def _transfers(vehicle: VehicleReport) -> Table:
    table = Table("on board", "items", "proven", "s", "stored otherwise", "restored")
    for transfer in vehicle.transfers:
        table.add_row(
            transfer.kind,
            str(transfer.items),
            "[green]yes[/]" if transfer.verified else f"[red]NO[/]: {transfer.error}",
            f"{transfer.seconds:.2f}",
            "\n".join(transfer.changed) or "-",
            _restored(transfer.restored, transfer.items_before),
        )
    return table


def _restored(restored: bool | None, items: int | None) -> str:
    if restored is None:
        return "nothing was written"
    return f"[green]yes[/], {items} items" if restored else "[red]NO[/]"
