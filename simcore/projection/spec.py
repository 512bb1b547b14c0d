"""What to ask of an acquisition and of its physics."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simcore.core.spec_base import Spec, quantity


class DetectorSpec(Spec):
    """A flat energy-integrating detector without blur and noise."""

    pixels_y: int = Field(2304, ge=8, le=8192, description="pixels along the tube travel [1]")
    pixels_x: int = Field(1920, ge=8, le=8192, description="pixels from chest wall to nipple [1]")
    pixel_mm: float = quantity("pixel edge", unit="mm", default=0.1, ge=0.02, le=5.0)
    bits: int = Field(16, ge=10, le=16, description="bits stored of a pixel value [1]")
    open_field_value: float = quantity(
        "pixel value where nothing is in the beam; pixel value = open_field_value x I / I0, rounded",
        unit="1",
        default=60000.0,
        ge=100.0,
        le=65535.0,
    )


class AcquisitionSpec(Spec):
    """Tube angles, distances, detector. The tube turns about the isocenter in the plane of the chest wall."""

    source_to_detector_mm: float = quantity(
        "source-to-image distance of the central view", unit="mm", default=660.0, ge=200.0, le=2000.0
    )
    isocenter_height_mm: float = quantity(
        "height of the isocenter (pivot) above the detector surface", unit="mm", default=40.0, ge=0.0, le=500.0
    )
    angular_range_degrees: float = quantity(
        "angle between the first and the last view", unit="degree", default=40.0, ge=0.0, le=120.0
    )
    views: int = Field(15, ge=1, le=101, description="number of views, equiangular over the range [1]")
    detector_range_degrees: float = quantity(
        "angle the detector turns through in all, in the sense of the tube; 0 for a stationary detector",
        unit="degree",
        default=0.0,
        ge=0.0,
        le=60.0,
    )
    air_gap_mm: float = quantity(
        "top of the breast support above the detector surface", unit="mm", default=20.0, ge=0.0, le=300.0
    )
    detector: DetectorSpec = DetectorSpec()
    truncation: Literal["refuse", "allow"] = Field(
        "refuse", description="what to do where the breast does not project wholly onto the detector in every view"
    )


class PhysicsSpec(Spec):
    """Monoenergetic primary radiation: I = I0 exp(-sum mu dr)."""

    attenuation: Literal["johns-yaffe-20keV", "icru-20keV"] = Field(
        "johns-yaffe-20keV",
        description="table of attenuation coefficients: johns-yaffe-20keV is the paper's (Johns and Yaffe 1987)",
    )
    sampling: Literal["exact", "trilinear"] = Field(
        "exact",
        description="exact: intersection length of ray and voxel; trilinear: the paper's interpolated samples",
    )
    step_voxels: Annotated[
        float,
        Field(
            gt=0.0,
            lt=0.5,
            json_schema_extra={"unit": "1"},
            description="distance of the samples of the trilinear sampling in voxel edges (Shannon: below 0.5) [1]",
        ),
    ] = 0.45

    @property
    def energy_keV(self) -> float:
        """Photon energy, keV; the tables are named after it."""
        return float(self.attenuation.rsplit("-", 1)[1].removesuffix("keV"))
