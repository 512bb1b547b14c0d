"""Webhooks and what they are told."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003_webhooks"
down_revision = "0002_api_keys"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "webhooks",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("url", sa.Text, nullable=False),
        sa.Column("description", sa.String(200), nullable=False),
        sa.Column("events", sa.JSON, nullable=False),
        sa.Column("secret", sa.String(100), nullable=False),
        sa.Column("created", sa.Double, nullable=False),
        sa.Column("failing_since", sa.Double),
        sa.Column("disabled", sa.Double),
        sa.Column("disabled_reason", sa.Text, nullable=False),
    )
    op.create_table(
        "webhook_messages",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("webhook_id", sa.String(32), sa.ForeignKey("webhooks.id", ondelete="CASCADE"), nullable=False),
        sa.Column("event", sa.String(32), nullable=False),
        sa.Column("body", sa.Text, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("created", sa.Double, nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("next_attempt", sa.Double),
        sa.Column("finished", sa.Double),
    )
    op.create_index("webhook_messages_due", "webhook_messages", ["state", "next_attempt"])
    op.create_index("webhook_messages_by_age", "webhook_messages", ["webhook_id", "created", "id"])
    op.create_table(
        "webhook_attempts",
        sa.Column(
            "message_id", sa.String(40), sa.ForeignKey("webhook_messages.id", ondelete="CASCADE"), primary_key=True
        ),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("at", sa.Double, nullable=False),
        sa.Column("seconds", sa.Double, nullable=False),
        sa.Column("status", sa.Integer),
        sa.Column("error", sa.Text, nullable=False),
        sa.Column("answer", sa.Text, nullable=False),
    )


def downgrade() -> None:
    for name in ("webhook_attempts", "webhook_messages", "webhooks"):
        op.drop_table(name)
