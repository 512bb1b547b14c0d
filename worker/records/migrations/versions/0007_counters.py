"""Numbers that only grow, for metrics."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007_counters"
down_revision = "0006_deliveries"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "counters",
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("label", sa.String(64), primary_key=True),
        sa.Column("value", sa.Double, nullable=False),
    )


def downgrade() -> None:
    op.drop_table("counters")
