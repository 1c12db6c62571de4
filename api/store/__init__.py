"""What the service knows, on disk: SQLite (WAL) by default, PostgreSQL by URL.

`tables.py` says what is kept, `migrations/` how a database gets there (alembic, run at start), `database.py` opens it
and reads, `writer.py` writes: every write is durable when it returns, and writes that come together share one commit.
Times are UTC seconds since 1970; documents are JSON text, so that both databases hold the same bytes.
"""

from skyfolio.api.store.database import Database
from skyfolio.api.store.errors import StoreError
from skyfolio.api.store.tables import metadata

__all__ = ["Database", "StoreError", "metadata"]
