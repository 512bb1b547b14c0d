"""Studies and their cases, idempotency keys."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004_studies"
down_revision = "0003_webhooks"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "idempotency_keys",
        sa.Column("principal", sa.String(64), primary_key=True),
        sa.Column("key", sa.String(255), primary_key=True),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("identifier", sa.String(32), nullable=False),
        sa.Column("answer", sa.JSON),
        sa.Column("claim", sa.String(32), nullable=False),
        sa.Column("claimed_until", sa.Double, nullable=False),
        sa.Column("expires", sa.Double, nullable=False),
    )
    op.create_index("idempotency_keys_by_age", "idempotency_keys", ["expires"])
    op.create_table(
        "studies",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("document", sa.JSON, nullable=False),
        sa.Column("columns", sa.JSON, nullable=False),
        sa.Column("estimate", sa.JSON, nullable=False),
        sa.Column("cases", sa.Integer, nullable=False),
        sa.Column("created", sa.Double, nullable=False),
        sa.Column("submitted_by", sa.String(32)),
    )
    op.create_index("studies_by_age", "studies", ["created", "id"])
    with op.batch_alter_table("simulations") as table:
        table.add_column(sa.Column("study_id", sa.String(32)))
        table.add_column(sa.Column("study_number", sa.Integer))
        table.add_column(sa.Column("coordinates", sa.JSON))
        table.create_index("simulations_by_study", ["study_id", "study_number"])
        table.create_foreign_key("simulations_of_study", "studies", ["study_id"], ["id"], ondelete="CASCADE")


def downgrade() -> None:
    with op.batch_alter_table("simulations") as table:
        table.drop_constraint("simulations_of_study", type_="foreignkey")
        table.drop_index("simulations_by_study")
        for column in ("coordinates", "study_number", "study_id"):
            table.drop_column(column)
    op.drop_table("studies")
    op.drop_table("idempotency_keys")
