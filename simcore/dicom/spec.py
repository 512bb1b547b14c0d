"""What to ask of the export: identity and description, nothing that changes an image."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from simcore.core.spec_base import Spec, quantity


class ExportSpec(Spec):
    """Identity of the synthetic patient and the study. All of it is plainly invented."""

    patient_id: str = Field(
        "",
        max_length=48,
        pattern=r"^[A-Za-z0-9._-]*$",
        description="patient identifier after SIM-; made from the specification where empty",
    )
    laterality: Literal["L", "R"] = Field("L", description="left or right breast")
    view: Literal["CC", "MLO"] = Field("CC", description="view position")
    oblique_angle_degrees: float = quantity(
        "turn of the gantry from the vertical in an MLO view", unit="degree", default=45.0, gt=0.0, le=90.0
    )
    date: str = Field(
        "20260101",
        pattern=r"^[12][0-9]{3}(0[1-9]|1[0-2])(0[1-9]|[12][0-9]|3[01])$",
        description="study date, YYYYMMDD; part of the specification so that two runs give the same bytes",
    )
    time: str = Field("120000", pattern=r"^([01][0-9]|2[0-3])[0-5][0-9][0-5][0-9]$", description="study time, HHMMSS")
    study_description: str = Field(
        "SYNTHETIC digital breast tomosynthesis", max_length=64, description="study description"
    )
