"""When the end of a study was told to webhooks."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008_study_announced"
down_revision = "0007_counters"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("studies") as table:
        table.add_column(sa.Column("announced", sa.Double))
    # Nobody waits to be told of studies that were there before.
    op.execute("UPDATE studies SET announced = created")


def downgrade() -> None:
    with op.batch_alter_table("studies") as table:
        table.drop_column("announced")
