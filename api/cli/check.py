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
        str, typer.Argument(help="udpin://, udpout://, tcpout://HOST:PORT or serial://DEVICE:BAUD; several: by commas.")
    ],
    system_id: Annotated[
        list[int] | None, typer.Option(min=1, max=254, help="Check this vehicle only; may be given several times.")
    ] = None,
    wait_s: Annotated[float, typer.Option(min=1, max=600, help="How long a heartbeat may take to come.")] = 15.0,
    signing_key_file: Annotated[
        Path | None,
        typer.Option(envvar="SKYFOLIO_SIGNING_KEY_FILE", help="Key of both ends, where MAVLink is signed."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check vehicles on the ground: audit them, and try what is put on board; then restore what was there.

    Exit status 0: all is right; 1: something keeps a vehicle from being flown; 2: nobody answers, or wrong usage.
    """
    from skyfolio.api.fleet import vehicle_check as checking  # noqa: PLC0415 - MAVSDK is only loaded where it is used

    urls = tuple(one.strip() for one in url.split(",") if one.strip())
    if not urls:
        raise UsageError("URL: give at least one")
    config = checking.CheckConfig(
        urls=urls, system_ids=tuple(system_id or ()), wait_s=wait_s, signing_key_file=signing_key_file
    )
    progress = Console(stderr=True)
    status = nullcontext() if as_json else progress.status("connecting")
    with status as shown:
        report = asyncio.run(checking.check(config, (lambda _words: None) if shown is None else shown.update))
    if as_json:
        write(report.model_dump_json(indent=2), None)
    else:
        _show(report)
    raise typer.Exit(0 if report.ready else 1)


def _show(report: CheckReport) -> None:
    console = Console()
    for one in report.vehicles:
        title = f"system {one.system_id}, {one.autopilot or 'unknown autopilot'}"
        findings = Table("", "audit", "found", "should be", "why", title=title)
        for finding in one.findings:
            colour = "red" if finding.level.value == "blocker" else "yellow"
            findings.add_row(
                f"[{colour}]{finding.level.value}[/]", finding.name, finding.found, finding.should, finding.why
            )
        console.print(findings if one.findings else f"{title}: the audit has no finding")
        if one.transfers:
            console.print(_transfers(one))
        console.print(f"system {one.system_id}: " + ("[green]ready[/]" if one.ready else "[red]NOT READY[/]"))


def _transfers(one: VehicleReport) -> Table:
    table = Table("on board", "items", "proven", "s", "stored otherwise", "restored")
    for transfer in one.transfers:
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
