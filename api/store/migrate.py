"""Migration of a database to the tables of this version, with the Alembic files of this package."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Connection, inspect, text

if TYPE_CHECKING:
    from alembic.config import Config

_LOCK = 0x5C1F0111
"""Number of the advisory lock under which a database is migrated."""
_FOLDER = Path(__file__).parent / "migrations"
_REVISION = re.compile(r'^(revision|down_revision) = "(\w+)"$', re.MULTILINE)


def upgrade(connection: Connection) -> None:
    """Run every migration that this database has not seen, on an open connection in a transaction.

    Services that start together on one PostgreSQL do so one after the other.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(text("SET LOCAL idle_in_transaction_session_timeout = 0"))  # it waits, and nobody for it
        connection.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
    if current_revisions(connection) == newest_revisions():
        return  # as at nearly every start, which need not wait for Alembic to be imported
    from alembic import command  # noqa: PLC0415

    command.upgrade(configuration(connection), "head")


def current_revisions(connection: Connection) -> set[str]:
    """Return the revisions that the database is at: none in a new one."""
    if not inspect(connection).has_table("alembic_version"):
        return set()
    return set(connection.execute(text("SELECT version_num FROM alembic_version")).scalars())


def newest_revisions() -> set[str]:
    """Return the revisions that no other one follows, as the migration files declare them."""
    declared: dict[str, set[str]] = {"revision": set(), "down_revision": set()}
    for file in (_FOLDER / "versions").glob("*.py"):
        for kind, revision in _REVISION.findall(file.read_text(encoding="utf-8")):
            declared[kind].add(revision)
    return declared["revision"] - declared["down_revision"]


def configuration(connection: Connection) -> Config:
    """Return Alembic's configuration for this package; `alembic revision` and the tests use it too."""
    from alembic.config import Config  # noqa: PLC0415

    config = Config()
    config.set_main_option("script_location", str(_FOLDER))
    config.attributes["connection"] = connection
    return config
