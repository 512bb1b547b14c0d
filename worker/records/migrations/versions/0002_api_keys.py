"""API keys; who posted a simulation, with which request."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002_api_keys"
down_revision = "0001_baseline"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(12), primary_key=True),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("scopes", sa.JSON, nullable=False),
        sa.Column("created", sa.Double, nullable=False),
        sa.Column("expires", sa.Double),
        sa.Column("revoked", sa.Double),
        sa.Column("last_used", sa.Double),
        sa.Column("active_cases", sa.Integer),
        sa.Column("cases_per_day", sa.Integer),
    )
    with op.batch_alter_table("simulations") as table:
        table.add_column(sa.Column("submitted_by", sa.String(32)))
        table.add_column(sa.Column("request_id", sa.String(128)))
        table.create_index("simulations_by_key", ["submitted_by", "created"])


def downgrade() -> None:
    with op.batch_alter_table("simulations") as table:
        table.drop_index("simulations_by_key")
        table.drop_column("request_id")
        table.drop_column("submitted_by")
    op.drop_table("api_keys")
