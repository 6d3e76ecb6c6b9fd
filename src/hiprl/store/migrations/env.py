"""Run by Alembic: applies migrations in the transaction that `hiprl.store.migrate` opened."""

from __future__ import annotations

from alembic import context

from hiprl.store.schema import VERSION_TABLE, metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    version_table=VERSION_TABLE,
    render_as_batch=True,  # SQLite alters a table by copying it
)
with context.begin_transaction():
    context.run_migrations()
