"""Indexes that searches for DICOM series and instances need alone."""

from __future__ import annotations

from alembic import op

revision = "0010_dicom_order"
down_revision = "0009_retention"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("dicom_series_in_order", "dicom_series", ["study", "number", "modality"])
    op.create_index("dicom_instances_in_order", "dicom_instances", ["series", "number"])
    op.drop_index("ix_dicom_series_study", "dicom_series")
    op.drop_index("ix_dicom_instances_series", "dicom_instances")


def downgrade() -> None:
    op.create_index("ix_dicom_series_study", "dicom_series", ["study"])
    op.create_index("ix_dicom_instances_series", "dicom_instances", ["series"])
    op.drop_index("dicom_series_in_order", "dicom_series")
    op.drop_index("dicom_instances_in_order", "dicom_instances")
