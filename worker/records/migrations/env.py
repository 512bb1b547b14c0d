"""Run by Alembic for every command; ``worker.records.schema`` hands over the connection."""

from alembic import context

from worker.records.migrations.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,  # SQLite alters a table by copying it
    compare_type=True,
)
with context.begin_transaction():
    context.run_migrations()
