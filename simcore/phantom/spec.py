"""What to ask of a phantom."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simcore.core.spec_base import Spec, quantity


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
    voxel_mm: float = quantity("voxel edge", unit="mm", default=0.2, ge=0.05, le=5.0)
    skin_mm: float = quantity("skin thickness", unit="mm", default=1.45, ge=0.0, le=5.0)
    outline: OutlineSpec = OutlineSpec()
    compartments: CompartmentSpec = CompartmentSpec()

    @classmethod
    def example(cls) -> AnthropomorphicPhantom:
        return cls()

    def semi_axes(self) -> tuple[float, float, float, float]:
        """(depth a along x, half width b along y, upper c, lower c), mm."""
        o = self.outline
        unit = 3.14159265358979 / 3 * o.depth * o.half_width * (o.upper + o.lower)
        s = (self.volume_ml * 1e3 / unit) ** (1 / 3)
        return o.depth * s, o.half_width * s, o.upper * s, o.lower * s


PhantomSpec = Annotated[AnthropomorphicPhantom, Field(description="how the breast is grown")]
"""Union by ``kind``: a new phantom is one file and one more member here."""
