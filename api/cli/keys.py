"""`skyfolio keys`: make, list and revoke API keys, in the database that the service uses."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from typing import Annotated, TypeVar

import typer
from rich.console import Console
from rich.table import Table

from skyfolio.api.access.api_keys import KeyRing, KeyView, Role
from skyfolio.api.cli.files import Json
from skyfolio.api.cli.lazy import application
from skyfolio.api.common.configuration import require_known
from skyfolio.api.common.errors import InvalidError
from skyfolio.api.common.settings import TEMPORARY, default_database_url
from skyfolio.api.store import Database

Result = TypeVar("Result")
keys = application("Create, list and revoke the API keys of the service.")
DatabaseUrl = Annotated[
    str | None, typer.Option(envvar="SKYFOLIO_DATABASE_URL", help="The service's database; default: as `serve`.")
]


@keys.command()
def create(
    name: Annotated[str, typer.Argument(help="Whose key it is; shown in the audit log.")],
    role: Annotated[Role, typer.Option(help="viewer reads, planner also plans, pilot also flies.")] = Role.VIEWER,
    database_url: DatabaseUrl = None,
    as_json: Json = False,
) -> None:
    """Create a key and print it. It is shown only this once; the database keeps no more than its digest."""
    if not 1 <= len(name) <= 64 or not name.isprintable():
        raise InvalidError(f"name: {name!r} must be 1 to 64 printable characters")
    key = _with_ring(database_url, lambda ring: ring.create(name, role))
    if as_json:
        _print(json.dumps({"name": name, "role": role.value, "key": key}))
    else:
        _print(key)


@keys.command("list")
def list_keys(database_url: DatabaseUrl = None, as_json: Json = False) -> None:
    """List all keys, without their secrets."""
    api_keys: list[KeyView] = _with_ring(database_url, lambda ring: ring.all())
    if as_json:
        _print(json.dumps([key.model_dump(mode="json") for key in api_keys], indent=2))
        return
    table = Table("id", "name", "role", "created", "revoked")
    for key in api_keys:
        table.add_row(key.id, key.name, key.role.value, _day(key.created_at), _day(key.revoked_at))
    Console().print(table)


@keys.command()
def revoke(
    key_id: Annotated[str, typer.Argument(help="Id of the key, as `list` shows it.")],
    database_url: DatabaseUrl = None,
    as_json: Json = False,
) -> None:
    """Revoke a key; a running service refuses it within seconds. After the last one, every request is refused."""
    _with_ring(database_url, lambda ring: ring.revoke(key_id))
    if as_json:
        _print(json.dumps({"id": key_id, "revoked": True}))


@keys.command()
def reset(database_url: DatabaseUrl = None, as_json: Json = False) -> None:
    """Delete all keys, which must be revoked first: on loopback the service is then open to this machine again."""
    forgotten = _with_ring(database_url, lambda ring: ring.reset())
    if as_json:
        _print(json.dumps({"forgotten": forgotten}))


def _with_ring(database_url: str | None, work: Callable[[KeyRing], Awaitable[Result]]) -> Result:
    require_known(os.environ)
    url = database_url or os.environ.get("SKYFOLIO_DATABASE_URL") or default_database_url()
    if url == TEMPORARY:
        raise InvalidError("database_url: a temporary database keeps no keys")

    async def run() -> Result:
        database = await Database.open(url)
        try:
            return await work(KeyRing(database))
        finally:
            await database.close()

    return asyncio.run(run())


def _day(at: float | None) -> str:
    return "" if at is None else datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
