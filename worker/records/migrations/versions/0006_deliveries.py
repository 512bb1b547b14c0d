"""Destinations, deliveries with their instances and events; where a simulation goes when it has succeeded."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006_deliveries"
down_revision = "0005_dicom"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "destinations",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("name", sa.String(64), nullable=False, unique=True),
        sa.Column("definition", sa.JSON, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("created", sa.Double, nullable=False),
    )
    op.create_table(
        "deliveries",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("destination_id", sa.String(32), nullable=False),
        sa.Column("destination_name", sa.String(64), nullable=False),
        sa.Column("simulation_id", sa.String(32)),
        sa.Column("study_id", sa.String(32)),
        sa.Column("automatic", sa.Boolean, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("created", sa.Double, nullable=False),
        sa.Column("started", sa.Double),
        sa.Column("finished", sa.Double),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("failures", sa.Integer, nullable=False),
        sa.Column("not_before", sa.Double),
        sa.Column("sent", sa.Double),
        sa.Column("owner", sa.String(200)),
        sa.Column("lease_until", sa.Double),
        sa.Column("message", sa.Text, nullable=False),
        sa.Column("error", sa.JSON),
        sa.Column("instances", sa.Integer, nullable=False),
        sa.Column("instances_stored", sa.Integer, nullable=False),
        sa.Column("instances_failed", sa.Integer, nullable=False),
        sa.Column("bytes", sa.BigInteger, nullable=False),
        sa.Column("bytes_stored", sa.BigInteger, nullable=False),
    )
    op.create_index("deliveries_by_age", "deliveries", ["created", "id"])
    op.create_index("deliveries_by_destination", "deliveries", ["destination_id", "state"])
    op.create_index("deliveries_by_simulation", "deliveries", ["simulation_id"])
    op.create_table(
        "delivery_instances",
        sa.Column("delivery_id", sa.String(32), sa.ForeignKey("deliveries.id", ondelete="CASCADE")),
        sa.Column("number", sa.Integer),
        sa.Column("destination_id", sa.String(32), nullable=False),
        sa.Column("simulation_id", sa.String(32), nullable=False),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("size", sa.BigInteger, nullable=False),
        sa.Column("sop_instance", sa.String(64)),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("status", sa.Integer),
        sa.Column("code", sa.String(64)),
        sa.Column("message", sa.Text, nullable=False),
        sa.Column("finished", sa.Double),
        sa.PrimaryKeyConstraint("delivery_id", "number"),
    )
    op.create_index("delivery_instances_by_uid", "delivery_instances", ["sop_instance", "destination_id"])
    op.create_table(
        "delivery_events",
        sa.Column("delivery_id", sa.String(32), sa.ForeignKey("deliveries.id", ondelete="CASCADE")),
        sa.Column("sequence", sa.Integer),
        sa.Column("at", sa.Double, nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("data", sa.JSON, nullable=False),
        sa.PrimaryKeyConstraint("delivery_id", "sequence"),
    )
    with op.batch_alter_table("simulations") as table:
        table.add_column(sa.Column("deliver", sa.JSON))


def downgrade() -> None:
    with op.batch_alter_table("simulations") as table:
        table.drop_column("deliver")
    for name in ("delivery_events", "delivery_instances", "deliveries", "destinations"):
        op.drop_table(name)
