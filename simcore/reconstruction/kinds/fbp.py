"""Filtered back-projection."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from simcore.core.spec_base import quantity
from simcore.reconstruction.kinds.common import VolumeSpec


class FilteredBackprojection(VolumeSpec):
    """Filtered back-projection: ramp x window x slice-thickness filter along the tube travel (Mertelmeier 2006)."""

    # How DICOM names it: a defined term of Algorithm Type (0018,9527), and words.
    dicom_algorithm: ClassVar[str] = "FILTER_BACK_PROJ"
    title: ClassVar[str] = "filtered back-projection"

    kind: Literal["fbp"] = "fbp"
    filter: Literal["hann", "hamming", "ramp", "none"] = Field(
        "hann",
        description="hann, hamming: the ramp times this window; ramp: without a window; none: no ramp either, the "
        "values are means over the thickness of the breast",
    )
    hann_cutoff: float = quantity(
        "frequency at which the window (Hann or Hamming) ends, relative to the Nyquist frequency of the detector",
        unit="1",
        default=1.0,
        gt=0.0,
        le=1.0,
    )
    regularisation_mm: float = quantity(
        "Tikhonov regularisation: the ramp |f| becomes |f| / (1 + (this x f)^2), which damps frequencies above its "
        "inverse; 0: none",
        unit="mm",
        default=0.0,
        ge=0.0,
        le=50.0,
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
    detector_edge: Literal["zero", "extend"] = Field(
        "zero",
        description="what the filter meets beyond the detector along the tube travel: nothing, or the values of the "
        "edge, fading out (for a breast that reaches beyond the detector)",
    )
    breast_edge: Literal["keep", "flatten"] = Field(
        "keep",
        description="flatten: the slow variation of the breast's thickness is taken out of the projections before they "
        "are filtered, so that its outline casts no shadows into other slices",
    )

    @classmethod
    def example(cls) -> FilteredBackprojection:
        return cls(filter="hamming", field="breast")
