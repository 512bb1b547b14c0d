"""How long files are kept, and chores that one of many processes does."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009_retention"
down_revision = "0008_study_announced"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("simulations") as table:
        table.add_column(sa.Column("retention", sa.Double))
        table.add_column(sa.Column("expires_at", sa.Double))
        table.add_column(sa.Column("pinned", sa.Boolean, nullable=False, server_default=sa.false()))
    op.create_table(
        "chores",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("due", sa.Double, nullable=False),
    )


def downgrade() -> None:
    op.drop_table("chores")
    with op.batch_alter_table("simulations") as table:
        for column in ("pinned", "expires_at", "retention"):
            table.drop_column(column)
