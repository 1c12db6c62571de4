"""Alembic's entry: it runs on the connection it is given (see `api/store/migrate.py`)."""

from alembic import context

from skyfolio.api.store.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite alters a table by copying it
)
with context.begin_transaction():
    context.run_migrations()
