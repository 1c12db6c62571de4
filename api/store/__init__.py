"""The database: SQLite (WAL) by default, PostgreSQL by URL (`pip install skyfolio[postgres]`).

    tables, migrations/, migrate  what is stored, and how a database gets there (Alembic, run at start)
    database                     opens, claims and reads it
    backend                      the engines behind it
    writer, spill                writes: durable on return, grouped commits, held in a file while the database is down
    event_log                    numbered events and their streams
    retention                    what is deleted, and when
    errors                       `StoreError`

It may import `common`. Times are UTC seconds since 1970; documents are JSON text, so that both databases hold the same
bytes. A table changes together with a new file in `migrations/versions`; released files are never edited. What a flight
stores goes through `Database.keep`, which does not fail while the database is down.
"""

from skyfolio.api.store.database import Database
from skyfolio.api.store.errors import StoreError
from skyfolio.api.store.tables import metadata

__all__ = ["Database", "StoreError", "metadata"]
