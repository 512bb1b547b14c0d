"""What to ask of the compression."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws import MaterialSpec
from simcore.fem.laws.neo_hookean import NeoHookean

MOST_PERCENT = 75.0
MOST_LOAD_STEPS = 100
_N_PER_KPA_MM2 = 1e-3
_STANDARD_GRAVITY = 9.80665
_DIRECTIONS = {"-x": (-1, 0, 0), "+x": (1, 0, 0), "-y": (0, -1, 0), "+y": (0, 1, 0), "-z": (0, 0, -1), "+z": (0, 0, 1)}


class SkinMembrane(Spec):
    """Skin as an incompressible neo-Hookean membrane on the surface; it wrinkles instead of carrying compression."""

    thickness_mm: float = quantity("thickness", unit="mm", default=1.5, gt=0.0, le=5.0)
    youngs_modulus_kPa: float = quantity("Young's modulus at small strain", unit="kPa", gt=0.0, le=20000.0)

    def tension(self) -> float:
        """Thickness times shear modulus, N/mm."""
        return self.thickness_mm * self.youngs_modulus_kPa / 3 * _N_PER_KPA_MM2


class Gravity(Spec):
    """Weight of the tissue; the shape of the phantom is taken as free of stress."""

    density_g_ml: float = quantity("density", unit="g/ml", default=0.98, gt=0.0, le=2.0)
    direction: Literal["-x", "+x", "-y", "+y", "-z", "+z"] = Field(
        "-z", description="where it pulls; -z is towards the breast support"
    )

    def weight(self) -> tuple[float, float, float]:
        """(x, y, z), N/mm^3."""
        size = self.density_g_ml * 1e-6 * _STANDARD_GRAVITY
        x, y, z = _DIRECTIONS[self.direction]
        return size * x, size * y, size * z


class SpringPaddle(Spec):
    """An upper plate that turns about a line along y until its spring holds the moment of the breast."""

    stiffness_Nmm_per_degree: float = quantity("moment for a turn", unit="N mm/degree", gt=0.0, le=1e7)
    pivot_mm: float = quantity(
        "x of the line about which it turns; percent is the travel there", unit="mm", default=200.0, ge=-500.0, le=500.0
    )


class ElasticPlates(Spec):
    """Plates that bend, Plexiglas by default: simply supported along three edges, free along the chest wall."""

    thickness_mm: float = quantity("thickness of either plate", unit="mm", gt=0.0, le=50.0)
    depth_mm: float = quantity("extent along x, from the chest wall", unit="mm", default=240.0, gt=0.0, le=500.0)
    width_mm: float = quantity("extent along y", unit="mm", default=300.0, gt=0.0, le=600.0)
    youngs_modulus_MPa: float = quantity("Young's modulus", unit="MPa", default=3000.0, gt=0.0, le=1e6)
    poissons_ratio: float = quantity("Poisson's ratio", unit="1", default=0.37, ge=0.0, lt=0.5)


class CompressionSpec(Spec):
    """Two rigid, parallel plates move towards the middle of the breast by the same distance, until it is
    compressed by ``percent``; or, where one of them is given, to ``thickness_mm`` or to ``force_N``, and then
    ``percent`` is the most that is allowed."""

    percent: float = quantity(
        "reduction of the uncompressed thickness", unit="%", default=50.0, gt=0.0, le=MOST_PERCENT
    )
    thickness_mm: float | None = Field(
        None,
        gt=0.0,
        le=500.0,
        json_schema_extra={"unit": "mm"},
        description="distance of the plates at the end; refused where percent does not allow it [mm]",
    )
    force_N: float | None = Field(
        None,
        gt=0.0,
        le=10000.0,
        json_schema_extra={"unit": "N"},
        description="force on a plate at the end, met within 0.1 %; refused where percent does not allow it [N]",
    )
    force_limit_N: float | None = Field(
        None,
        gt=0.0,
        le=10000.0,
        json_schema_extra={"unit": "N"},
        description="force on a plate beyond which the compression is refused [N]",
    )
    material: MaterialSpec = NeoHookean()
    skin: SkinMembrane | None = Field(None, description="membrane on the surface; none where not given")
    gravity: Gravity | None = Field(None, description="weight of the tissue; none where not given")
    friction: float = quantity(
        "Coulomb's coefficient of skin on the plates; with friction a load step is a tenth of the way at most",
        unit="1",
        default=0.0,
        ge=0.0,
        le=1.0,
    )
    paddle_angle_degrees: float = quantity(
        "tilt of the upper plate about the chest wall; positive opens it towards the nipple, percent is its travel at "
        "the chest wall",
        unit="degree",
        default=0.0,
        ge=-20.0,
        le=20.0,
    )
    spring_paddle: SpringPaddle | None = Field(None, description="an upper plate that turns on a spring")
    elastic_plates: ElasticPlates | None = Field(None, description="plates that bend; rigid ones where not given")
    chest_wall: Literal["free_in_plane", "fixed", "fixed_muscle"] = Field(
        "free_in_plane",
        description="free_in_plane: held along x, free along y and z, without drift and roll. fixed: held altogether, "
        "so that the breast stays thicker there than the plates are apart; their edge is plate_edge_mm. fixed_muscle: "
        "the muscle of the phantom is held altogether, as VICTRE does, and the rest of the wall along x",
    )
    plate_edge_mm: float = quantity(
        "with a fixed chest wall or muscle alone: distance from it, on the undeformed breast, at which the plates "
        "become flat; nearer they rise as a parabola to clear its rim",
        unit="mm",
        default=40.0,
        ge=1.0,
        le=200.0,
    )
    load_steps: int = Field(
        1, ge=1, le=MOST_LOAD_STEPS, description="load steps to begin with; halved by itself where one fails [1]"
    )
    tolerance: float = quantity(
        "residual force relative to the plate force at which a load step has converged",
        unit="1",
        default=1e-5,
        ge=1e-10,
        le=1e-2,
    )

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if self.thickness_mm is not None and self.force_N is not None:
            raise ValueError("give thickness_mm or force_N, not both")
        kinds = (self.paddle_angle_degrees != 0.0, self.spring_paddle is not None, self.elastic_plates is not None)
        if sum(kinds) > 1:
            raise ValueError("give one of paddle_angle_degrees, spring_paddle and elastic_plates")
        return self
