"""What to ask of the export: identity, description, encoding and further objects; nothing that changes an image."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import Spec, quantity

ExtraObject = Literal["presentation", "synthetic-2d", "ct", "attenuation", "report"]
"""Objects that are written on request; simcore.dicom.extras has what writes each."""


class ExportSpec(Spec):
    """Identity of the synthetic patient and the study, all of it plainly invented, and what the study holds."""

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
    encoding: Literal["none", "jpeg-ls", "rle"] = Field(
        "none",
        description="how the pixels of images are stored, always without loss: none (explicit VR little endian), "
        "jpeg-ls (about half the size) or rle (every reader knows it)",
    )
    extra_objects: list[ExtraObject] = Field(
        [],
        description="objects beside projections, volume, labels and lesions: presentation (every view processed for "
        "reading), synthetic-2d (one image of the volume), ct (slices as CT images, in HU), attenuation (the true "
        "coefficients, 1/mm, 4 bytes a voxel), report (structured report of the lesions)",
    )

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if len(set(self.extra_objects)) < len(self.extra_objects):
            raise ValueError(f"extra_objects = {self.extra_objects}: each may stand once")
        return self
