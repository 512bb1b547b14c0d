"""Tables of the index of DICOM objects, and which attribute stands in which column.

One study row a case and study, with its series and instances below it; the rows of a case go with the case.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import sqlalchemy as sa

from worker.records.database import metadata

Level = Literal["study", "series", "instance"]
Kind = Literal["uid", "text", "date", "time", "number"]

indexed = sa.Table(
    "dicom_indexed",
    metadata,
    sa.Column("simulation_id", sa.ForeignKey("simulations.id", ondelete="CASCADE"), primary_key=True),
    # Why files of it are not in the index; NULL where all are.
    sa.Column("problem", sa.Text),
)

studies = sa.Table(
    "dicom_studies",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("simulation_id", sa.ForeignKey("simulations.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("uid", sa.String(64), nullable=False, index=True),
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
    # Attributes of the level in the DICOM JSON model.
    sa.Column("attributes", sa.JSON, nullable=False),
)

series = sa.Table(
    "dicom_series",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("study", sa.ForeignKey("dicom_studies.id", ondelete="CASCADE"), nullable=False),
    sa.Column("uid", sa.String(64), nullable=False, index=True),
    sa.Column("modality", sa.String(16), nullable=False),
    sa.Column("number", sa.Integer),
    sa.Column("description", sa.String(64), nullable=False),
    sa.Column("instance_count", sa.Integer, nullable=False),
    sa.Column("attributes", sa.JSON, nullable=False),
    sa.Index("dicom_series_in_order", "study", "number", "modality"),
)

instances = sa.Table(
    "dicom_instances",
    metadata,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("series", sa.ForeignKey("dicom_series.id", ondelete="CASCADE"), nullable=False),
    sa.Column("uid", sa.String(64), nullable=False, index=True),
    sa.Column("sop_class", sa.String(64), nullable=False),
    sa.Column("number", sa.Integer),
    sa.Column("name", sa.String(200), nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    sa.Column("transfer_syntax", sa.String(64), nullable=False),
    sa.Column("pixels", sa.JSON(none_as_null=True)),
    sa.Column("attributes", sa.JSON, nullable=False),
    sa.Index("dicom_instances_in_order", "series", "number"),
)


@dataclass(frozen=True)
class Key:
    """A column that is searched."""

    level: Level
    column: sa.Column[Any]
    kind: Kind


KEYS: dict[str, Key] = {
    "StudyInstanceUID": Key("study", studies.c.uid, "uid"),
    "PatientID": Key("study", studies.c.patient_id, "text"),
    "PatientName": Key("study", studies.c.patient_name, "text"),
    "PatientBirthDate": Key("study", studies.c.patient_birth_date, "date"),
    "PatientSex": Key("study", studies.c.patient_sex, "text"),
    "StudyDate": Key("study", studies.c.date, "date"),
    "StudyTime": Key("study", studies.c.time, "time"),
    "AccessionNumber": Key("study", studies.c.accession_number, "text"),
    "StudyID": Key("study", studies.c.study_id, "text"),
    "ReferringPhysicianName": Key("study", studies.c.referring_physician, "text"),
    "StudyDescription": Key("study", studies.c.description, "text"),
    "ModalitiesInStudy": Key("study", series.c.modality, "text"),
    "SeriesInstanceUID": Key("series", series.c.uid, "uid"),
    "Modality": Key("series", series.c.modality, "text"),
    "SeriesNumber": Key("series", series.c.number, "number"),
    "SeriesDescription": Key("series", series.c.description, "text"),
    "SOPInstanceUID": Key("instance", instances.c.uid, "uid"),
    "SOPClassUID": Key("instance", instances.c.sop_class, "uid"),
    "InstanceNumber": Key("instance", instances.c.number, "number"),
}
"""What can be searched for, by keyword."""

TABLES: dict[Level, sa.Table] = {"study": studies, "series": series, "instance": instances}
