"""Numbers that only grow, for metrics: kept in the database, so that they survive restarts and forgotten cases, and
are the same whichever process is asked."""

from __future__ import annotations

from collections.abc import Mapping

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from worker.records.database import metadata, reading

ENDED = "simulations_ended"
STAGES_COMPUTED = "stages_computed"
STAGES_CACHED = "stages_cached"
STAGE_SECONDS = "stage_seconds"
DELIVERIES_ENDED = "deliveries_ended"
LEASE_EXPIRIES = "lease_expiries"

table = sa.Table(
    "counters",
    metadata,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("label", sa.String(64), primary_key=True),
    sa.Column("value", sa.Double, nullable=False),
)

Counts = Mapping[tuple[str, str], float]
"""(name, label) -> how much it grows."""


def add(connection: sa.Connection, counts: Counts) -> None:
    """Lets counters grow, as the last thing of a transaction: others who count the same wait for its end."""
    insert = postgresql.insert if connection.dialect.name == "postgresql" else sqlite.insert
    # Always in the same order: two transactions never wait for each other.
    for (name, label), value in sorted(counts.items()):
        row = insert(table).values(name=name, label=label, value=value)
        grown = {"value": table.c.value + row.excluded.value}
        connection.execute(row.on_conflict_do_update(index_elements=["name", "label"], set_=grown))


def values(engine: sa.Engine, name: str) -> dict[str, float]:
    """The counters of a name by label."""
    query = sa.select(table.c.label, table.c.value).where(table.c.name == name).order_by(table.c.label)
    with reading(engine) as connection:
        return {str(label): float(value) for label, value in connection.execute(query)}
