"""What to ask of an acquisition and of its physics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from simcore.core.spec_base import Spec, quantity

ORTHONORMAL = 1e-6
HIGHEST_OPEN_FIELD = 65535.0


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
        le=HIGHEST_OPEN_FIELD,
    )


def _vector(description: str, default: Any = ...) -> Any:
    return Field(default, min_length=3, max_length=3, description=f"{description}, [x, y, z]")


class DetectorPoseSpec(Spec):
    """Where the detector stands in one view, in the frame of the detector at rest (docs/conventions.md)."""

    origin_mm: list[float] = _vector("middle of the chest-wall edge [mm]")
    row_direction: list[float] = _vector(
        "unit vector along which rows are counted: y, the tube travel, at rest", [0.0, 1.0, 0.0]
    )
    column_direction: list[float] = _vector(
        "unit vector along which columns are counted: x, chest wall to nipple, at rest", [1.0, 0.0, 0.0]
    )

    @model_validator(mode="after")
    def _orthonormal(self) -> Self:
        for name, vector in (("row_direction", self.row_direction), ("column_direction", self.column_direction)):
            if abs((length := math.hypot(*vector)) - 1.0) > ORTHONORMAL:
                raise ValueError(f"{name} = {vector} has length {length:g}; it must be 1")
        product = math.fsum(a * b for a, b in zip(self.row_direction, self.column_direction, strict=True))
        if abs(product) > ORTHONORMAL:
            raise ValueError(f"row_direction and column_direction must be perpendicular; their product is {product:g}")
        return self


class ViewSpec(Spec):
    """One view of a trajectory."""

    source_mm: list[float] = _vector("focal spot in the detector frame [mm]")
    detector: DetectorPoseSpec | None = Field(None, description="pose of the detector; at rest where not given")

    @field_validator("source_mm")
    @classmethod
    def _above(cls, spot: list[float]) -> list[float]:
        if spot[2] <= 0:
            raise ValueError(
                f"the focal spot must stand above the detector at rest: z = {spot[2]:g} mm is not above 0 mm"
            )
        return spot


class SlabSpec(Spec):
    """A plate without edges, parallel to the breast support."""

    material: Literal["pmma", "polycarbonate", "carbon-fibre", "other"] = Field(
        "pmma", description="material; other: attenuation_per_mm tells"
    )
    thickness_mm: float = quantity("thickness", unit="mm", default=2.5, gt=0.0, le=50.0)
    attenuation_per_mm: float | None = Field(
        None,
        ge=0.0,
        le=10.0,
        json_schema_extra={"unit": "1/mm"},
        description="linear attenuation coefficient of the material 'other' [1/mm]",
    )

    @model_validator(mode="after")
    def _one_coefficient(self) -> Self:
        if (self.material == "other") != (self.attenuation_per_mm is not None):
            raise ValueError(
                f"attenuation_per_mm = {self.attenuation_per_mm} and material = {self.material!r}: the material "
                "'other' needs attenuation_per_mm, the others have theirs"
            )
        return self


class AcquisitionSpec(Spec):
    """Tube angles, distances, detector. The tube turns about the isocenter in the plane of the chest wall, or its focal
    spots are listed."""

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
    trajectory: list[ViewSpec] | None = Field(
        None,
        min_length=1,
        max_length=101,
        description="focal spot, and where it moves the detector, of every view, instead of the turn about the "
        "isocenter; views, angular_range_degrees and source_to_detector_mm then follow from it",
    )
    air_gap_mm: float = quantity(
        "top of the breast support above the detector surface", unit="mm", default=20.0, ge=0.0, le=300.0
    )
    support: SlabSpec | None = Field(
        None,
        description="breast support as a plate of a material, its top air_gap_mm above the detector; nothing "
        "where not given",
    )
    paddle: SlabSpec | None = Field(
        None, description="compression paddle as a plate of a material on the breast; nothing where not given"
    )
    detector: DetectorSpec = DetectorSpec()
    truncation: Literal["refuse", "allow"] = Field(
        "refuse", description="what to do where the breast does not project wholly onto the detector in every view"
    )

    @model_validator(mode="before")
    @classmethod
    def _follow_the_trajectory(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        return {**_of_trajectory(data.get("trajectory"), data.get("isocenter_height_mm", 40.0)), **data}

    @model_validator(mode="after")
    def _agrees_with_the_trajectory(self) -> Self:
        if self.trajectory is None:
            return self
        if self.detector_range_degrees != 0.0:
            raise ValueError(
                f"detector_range_degrees = {self.detector_range_degrees:g}: in a trajectory each view has its own "
                "detector; leave it out"
            )
        for name, value in _of_trajectory(self.trajectory, self.isocenter_height_mm).items():
            if abs(getattr(self, name) - value) > 1e-6:
                raise ValueError(
                    f"{name} = {getattr(self, name):g}, but that of the trajectory is {value:g}; leave it out"
                )
        return self

    @model_validator(mode="after")
    def _support_fits(self) -> Self:
        if self.support is not None and self.support.thickness_mm > self.air_gap_mm:
            raise ValueError(
                f"support.thickness_mm = {self.support.thickness_mm:g} does not fit below the top of the support at "
                f"air_gap_mm = {self.air_gap_mm:g}"
            )
        return self

    @property
    def turns(self) -> bool:
        """Whether views stand at different angles of an arc (not where their poses are listed)."""
        return self.trajectory is None and self.angular_range_degrees > 0

    def parameters(self) -> dict[str, Any]:
        """What results depend on: an option that is not used is left out, so that later ones leave old keys as they
        were."""
        return self.model_dump(exclude_none=True)

    @property
    def paddle_mm(self) -> float:
        """Thickness of the paddle; 0 where it is not modelled."""
        return 0.0 if self.paddle is None else self.paddle.thickness_mm

    @property
    def slabs(self) -> list[SlabSpec]:
        """The plates in the beam."""
        return [slab for slab in (self.support, self.paddle) if slab is not None]


def tube_angle(source: Sequence[float], isocenter_height: float) -> float:
    """Angle of a focal spot about the isocenter in the y-z plane, degrees, positive towards +y."""
    return math.degrees(math.atan2(source[1], source[2] - isocenter_height))


def _of_trajectory(trajectory: Any, isocenter_height: Any) -> dict[str, Any]:
    """Number of views, angular range and central distance of listed views; nothing where they are not well formed."""
    spots = []
    for view in trajectory if isinstance(trajectory, list) else []:
        fields = dict(view) if isinstance(view, dict | ViewSpec) else {}
        spot = fields.get("source_mm")
        if not (isinstance(spot, list) and len(spot) == 3 and all(type(c) in (int, float) for c in spot)):
            return {}
        if spot[2] <= 0:
            return {}
        spots.append(spot)
    if not spots or type(isocenter_height) not in (int, float):
        return {}
    angles = [tube_angle(spot, isocenter_height) for spot in spots]
    middle = min(range(len(spots)), key=lambda k: abs(angles[k]))
    return {
        "views": len(spots),
        "angular_range_degrees": max(angles) - min(angles),
        "source_to_detector_mm": float(spots[middle][2]),
    }


class PhysicsSpec(Spec):
    """Monoenergetic primary radiation: I = I0 exp(-sum mu dr)."""

    kind: Literal["monoenergetic"] = "monoenergetic"
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
    rays_per_pixel_edge: int = Field(
        1,
        ge=1,
        le=8,
        description="n x n rays meet each pixel, whose signal is the mean of their intensities [1]",
    )

    def parameters(self) -> dict[str, Any]:
        """What results depend on; see AcquisitionSpec.parameters."""
        return self.model_dump(exclude={"kind"} | ({"rays_per_pixel_edge"} if self.rays_per_pixel_edge == 1 else set()))

    @classmethod
    def example(cls) -> PhysicsSpec:
        return cls()

    @property
    def energy_keV(self) -> float:
        """Photon energy, keV; the tables are named after it."""
        return float(self.attenuation.rsplit("-", 1)[1].removesuffix("keV"))
