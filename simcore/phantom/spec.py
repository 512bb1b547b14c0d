"""What to ask of a phantom."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from simcore.core.spec_base import Spec, quantity
from simcore.core.tissues import Tissue
from simcore.phantom.lesions import LesionSpec, Mass
from simcore.phantom.upload.spec import UploadedPhantom

MAX_VOXEL_MM = 5.0


class OutlineSpec(Spec):
    """Quarters of two ellipsoids behind one another's equator: (x/a)^2 + (y/b)^2 + (z/c)^2 <= 1, x >= 0, with c_upper
    above and c_lower below. Only the ratios are given; the volume sets the scale: V = pi/3 a b (c_upper + c_lower).
    """

    depth: float = quantity("chest wall to nipple, relative", unit="1", default=1.30, gt=0.2, le=3)
    half_width: float = quantity("half width along y, relative", unit="1", default=0.85, gt=0.2, le=3)
    upper: float = quantity("upper half height along z, relative", unit="1", default=0.95, gt=0.2, le=3)
    lower: float = quantity("lower half height along z, relative", unit="1", default=0.75, gt=0.2, le=3)


class CompartmentSpec(Spec):
    """Adipose and glandular compartments and the Cooper's ligaments between them."""

    count: int = Field(450, ge=20, le=5000, description="number of compartments, all kinds together [1]")
    subcutaneous_fraction: float = quantity(
        "thickness of the subcutaneous adipose layer, as a fraction of the local radius; both adipose layers are "
        "made thinner where the gland that is asked for needs the room",
        unit="1",
        default=0.20,
        ge=0.0,
        le=0.6,
    )
    retromammary_mm: float = quantity(
        "mean thickness of the retromammary adipose layer in front of the chest wall",
        unit="mm",
        default=8.0,
        ge=0.0,
        le=40.0,
    )
    max_axis_ratio: float = quantity("largest axis ratio of a compartment", unit="1", default=3.0, ge=1.0, le=4.0)
    ligament_mm: float = quantity("thickness of the Cooper's ligaments", unit="mm", default=0.4, ge=0.0, le=2.0)


class TextureSpec(Spec):
    """Fractal modulation (fBm) of the borders of compartments, so that breasts differ in texture: each octave has half
    the wavelength and half the strength of the one before."""

    amplitude_mm: float = quantity(
        "largest displacement of a border along each axis; its standard deviation is 0.4 of it; 0 is none",
        unit="mm",
        default=0.0,
        ge=0.0,
        le=10.0,
    )
    scale_mm: float = quantity("size of the coarsest bumps", unit="mm", default=8.0, ge=1.0, le=100.0)
    octaves: int = Field(3, ge=1, le=5, description="number of octaves; the finest bumps are at least 1 mm [1]")

    @model_validator(mode="after")
    def _neither_folded_nor_too_fine(self) -> Self:
        if self.amplitude_mm > 0.5 * self.scale_mm:
            raise ValueError(
                f"amplitude_mm = {self.amplitude_mm:g} would fold borders over: at most half of scale_mm, "
                f"{0.5 * self.scale_mm:g}"
            )
        finest = self.scale_mm / 2 ** (self.octaves - 1)
        if finest < 1.0:
            raise ValueError(
                f"octaves = {self.octaves} gives bumps of {finest:g} mm, below 1 mm: take fewer, or a larger scale_mm"
            )
        return self


class NippleSpec(Spec):
    """A rounded cylinder at the foremost point; its tissue also takes the place of the skin under it."""

    diameter_mm: float = quantity("diameter", unit="mm", default=10.0, ge=2.0, le=30.0)
    height_mm: float = quantity("how far it stands out of the skin", unit="mm", default=5.0, ge=0.0, le=20.0)


class DuctSpec(Spec):
    """Branching trees of ducts from the nipple into the fibroglandular region. They count as gland in the
    glandularity."""

    trees: int = Field(12, ge=1, le=30, description="number of trees, one a lobe [1]")
    generations: int = Field(6, ge=1, le=9, description="times a duct branches [1]")
    main_diameter_mm: float = quantity("diameter at the nipple", unit="mm", default=1.5, ge=0.2, le=6.0)
    terminal_diameter_mm: float = quantity("diameter where they end", unit="mm", default=0.4, ge=0.1, le=6.0)


class AnthropomorphicPhantom(Spec):
    """The phantom of the paper: outline, skin, adipose compartments, ligaments, fibroglandular region."""

    kind: Literal["anthropomorphic"] = "anthropomorphic"
    volume_ml: float = quantity(
        "volume of the breast with its skin, met within 1 %", unit="ml", default=700.0, ge=1.0, le=4000.0
    )
    glandularity: float = quantity(
        "volume of fibroglandular tissue (with the ligaments left out) over the volume of all tissue but the skin; "
        "met within 0.02",
        unit="1",
        default=0.30,
        ge=0.0,
        le=0.9,
    )
    voxel_mm: float = quantity("voxel edge", unit="mm", default=0.2, ge=0.05, le=MAX_VOXEL_MM)
    skin_mm: float = quantity("skin thickness", unit="mm", default=1.45, ge=0.0, le=5.0)
    outline: OutlineSpec = OutlineSpec()
    compartments: CompartmentSpec = CompartmentSpec()
    texture: TextureSpec = TextureSpec()
    nipple: NippleSpec | None = Field(None, description="nipple; none where not given")
    ducts: DuctSpec | None = Field(None, description="ducts; none where not given")
    lesions: tuple[LesionSpec, ...] = Field(
        (), max_length=100, strict=False, description="known objects; a later one takes the place of an earlier one"
    )

    @classmethod
    def example(cls) -> AnthropomorphicPhantom:
        return cls()

    @property
    def voxels(self) -> int:
        """About how many voxels its box has."""
        depth, half_width, upper, lower = self.semi_axes()
        return int(depth * 2 * half_width * (upper + lower) / self.voxel_volume_mm3)

    @property
    def voxels_held(self) -> int:
        """About how many voxels are held while it is made."""
        return self.voxels

    @property
    def voxel_volume_mm3(self) -> float:
        """Volume of a voxel."""
        return self.voxel_mm**3

    @property
    def compressed(self) -> bool:
        """Whether it is already compressed: never."""
        return False

    @property
    def thickness_mm(self) -> None:
        """Distance of the plates, where it is known before it is compressed: never."""

    def parameters(self, seed: int) -> dict[str, Any]:
        """What its labels depend on."""
        return {"spec": self.model_dump(), "seed": seed}

    def plates(self) -> None:
        """What its compression depends on, where it is compressed already: nothing."""

    def possible_tissues(self) -> set[Tissue]:
        """Tissues that it may hold."""
        tissues = {Tissue.AIR, Tissue.ADIPOSE, Tissue.GLAND, Tissue.SKIN, Tissue.LIGAMENT}
        tissues |= {Tissue.MASS if isinstance(lesion, Mass) else Tissue.CALCIFICATION for lesion in self.lesions}
        tissues |= {Tissue.NIPPLE} if self.nipple is not None else set()
        return tissues | ({Tissue.DUCT} if self.ducts is not None else set())

    @property
    def edges_mm(self) -> tuple[float, ...]:
        """Voxel edges, mm."""
        return (self.voxel_mm,)

    @property
    def coarsest(self) -> float:
        """How many times larger its voxels can be."""
        return MAX_VOXEL_MM / self.voxel_mm

    def with_coarser_voxels(self, factor: float) -> AnthropomorphicPhantom:
        """The same breast in voxels whose edges are ``factor`` times as long."""
        return self.with_(voxel_mm=min(self.voxel_mm * factor, MAX_VOXEL_MM))

    @property
    def size_in_words(self) -> str:
        """What makes it large, for messages."""
        return f"phantom.voxel_mm = {self.voxel_mm:g} with a breast of {self.volume_ml:g} ml"

    def semi_axes(self) -> tuple[float, float, float, float]:
        """(depth a along x, half width b along y, upper c, lower c), mm."""
        o = self.outline
        unit = 3.14159265358979 / 3 * o.depth * o.half_width * (o.upper + o.lower)
        s = (self.volume_ml * 1e3 / unit) ** (1 / 3)
        return o.depth * s, o.half_width * s, o.upper * s, o.lower * s


def _with_kind(data: Any) -> Any:
    """Specifications written when there was one phantom name no kind."""
    return {"kind": "anthropomorphic", **data} if isinstance(data, dict) else data


PhantomSpec = Annotated[
    AnthropomorphicPhantom | UploadedPhantom,
    Field(discriminator="kind", description="how the breast is made"),
    BeforeValidator(_with_kind),
]
"""Union by ``kind``: a new phantom is one file and one more member here."""
