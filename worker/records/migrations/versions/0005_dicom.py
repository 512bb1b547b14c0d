"""Index of the DICOM objects."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005_dicom"
down_revision = "0004_studies"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "dicom_indexed",
        sa.Column("simulation_id", sa.String(32), nullable=False),
        sa.Column("problem", sa.Text),
        sa.ForeignKeyConstraint(["simulation_id"], ["simulations.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("simulation_id"),
    )
    op.create_table(
        "dicom_studies",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("simulation_id", sa.String(32), nullable=False),
        sa.Column("uid", sa.String(64), nullable=False),
        sa.Column("patient_id", sa.String(64), nullable=False),
        sa.Column("patient_name", sa.String(324), nullable=False),
        sa.Column("patient_birth_date", sa.String(8), nullable=False),
        sa.Column("patient_sex", sa.String(16), nullable=False),
        sa.Column("date", sa.String(8), nullable=False),
        sa.Column("time", sa.String(16), nullable=False),
        sa.Column("accession_number", sa.String(16), nullable=False),
        sa.Column("study_id", sa.String(16), nullable=False),
        sa.Column("referring_physician", sa.String(324), nullable=False),
        sa.Column("description", sa.String(64), nullable=False),
        sa.Column("modalities", sa.JSON, nullable=False),
        sa.Column("series_count", sa.Integer, nullable=False),
        sa.Column("instance_count", sa.Integer, nullable=False),
        sa.Column("attributes", sa.JSON, nullable=False),
        sa.ForeignKeyConstraint(["simulation_id"], ["simulations.id"], ondelete="CASCADE"),
    )
    op.create_index("ix_dicom_studies_simulation_id", "dicom_studies", ["simulation_id"])
    op.create_index("ix_dicom_studies_uid", "dicom_studies", ["uid"])

    op.create_table(
        "dicom_series",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("study", sa.Integer, nullable=False),
        sa.Column("uid", sa.String(64), nullable=False),
        sa.Column("modality", sa.String(16), nullable=False),
        sa.Column("number", sa.Integer),
        sa.Column("description", sa.String(64), nullable=False),
        sa.Column("instance_count", sa.Integer, nullable=False),
        sa.Column("attributes", sa.JSON, nullable=False),
        sa.ForeignKeyConstraint(["study"], ["dicom_studies.id"], ondelete="CASCADE"),
    )
    op.create_index("ix_dicom_series_study", "dicom_series", ["study"])
    op.create_index("ix_dicom_series_uid", "dicom_series", ["uid"])

    op.create_table(
        "dicom_instances",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("series", sa.Integer, nullable=False),
        sa.Column("uid", sa.String(64), nullable=False),
        sa.Column("sop_class", sa.String(64), nullable=False),
        sa.Column("number", sa.Integer),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("size", sa.BigInteger, nullable=False),
        sa.Column("transfer_syntax", sa.String(64), nullable=False),
        sa.Column("pixels", sa.JSON(none_as_null=True)),
        sa.Column("attributes", sa.JSON, nullable=False),
        sa.ForeignKeyConstraint(["series"], ["dicom_series.id"], ondelete="CASCADE"),
    )
    op.create_index("ix_dicom_instances_series", "dicom_instances", ["series"])
    op.create_index("ix_dicom_instances_uid", "dicom_instances", ["uid"])


def downgrade() -> None:
    for table in ("dicom_instances", "dicom_series", "dicom_studies", "dicom_indexed"):
        op.drop_table(table)
