"""What to ask of a reconstruction."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import Spec, quantity


class FilteredBackprojection(Spec):
    """Filtered back-projection: ramp x Hann x slice-thickness filter along the tube travel (Mertelmeier 2006)."""

    # How DICOM names it: a defined term of Reconstruction Algorithm Type, and words.
    dicom_algorithm: ClassVar[str] = "FILTER_BACK_PROJ"
    title: ClassVar[str] = "filtered back-projection"

    kind: Literal["fbp"] = "fbp"
    slice_mm: float = quantity("distance of the slices", unit="mm", default=1.0, ge=0.1, le=20.0)
    pixel_mm: float | None = Field(
        None,
        ge=0.02,
        le=5.0,
        json_schema_extra={"unit": "mm"},
        description="in-plane pixel edge; that of the detector where not given [mm]",
    )
    hann_cutoff: float = quantity(
        "frequency at which the Hann window reaches zero, relative to the Nyquist frequency of the detector",
        unit="1",
        default=1.0,
        gt=0.0,
        le=1.0,
    )
    slice_thickness_filter: bool = Field(True, description="whether the slice-thickness filter is applied")
    slice_cutoff: float = quantity(
        "frequency at which the Hann window of the slice thickness filter reaches zero, relative to the Nyquist "
        "frequency of the slices",
        unit="1",
        default=1.0,
        gt=0.0,
        le=10.0,
    )
    value_slope: float = quantity(
        "attenuation per step of the stored 16-bit values", unit="1/mm", default=1e-5, ge=1e-8, le=1e-2
    )
    value_intercept: float = quantity("attenuation of the stored value 0", unit="1/mm", default=-0.2, ge=-100.0, le=0.0)

    @classmethod
    def example(cls) -> FilteredBackprojection:
        return cls()


ReconstructionSpec = Annotated[FilteredBackprojection, Field(description="how the volume is reconstructed")]
"""Union by ``kind``: a new reconstruction is one file and one more member here."""
