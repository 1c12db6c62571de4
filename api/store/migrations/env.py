"""Alembic's entry point; it runs on the connection that `api/store/migrate.py` passes."""

from alembic import context

from skyfolio.api.store.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite alters a table by copying it
)
with context.begin_transaction():
    context.run_migrations()
