"""What to ask of an uploaded phantom."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from simcore.core.spec_base import Spec
from simcore.core.tissues import Tissue
from simcore.phantom.upload.tissue_maps import TissueMap, has_tissue

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Count = Annotated[int, Field(ge=1, le=20_000)]
MIN_EDGE_MM, MAX_EDGE_MM = 0.01, 10.0
Edge = Annotated[float, Field(ge=MIN_EDGE_MM, le=MAX_EDGE_MM)]
Extent = Annotated[float, Field(gt=0.0, le=2000.0)]


def _every_axis_once(axes: tuple[Axis, Axis, Axis]) -> tuple[Axis, Axis, Axis]:
    if sorted(axis[1] for axis in axes) != ["x", "y", "z"]:
        raise ValueError(f"{list(axes)}: each of x, y and z once, such as {list(OWN_AXES)}")
    return axes


Axes = Annotated[tuple[Axis, Axis, Axis], AfterValidator(_every_axis_once)]
"""Where the axes of an array lead, slowest first."""
OWN_AXES: Axes = ("+z", "+y", "+x")
"""Those of tomosim."""


def along(axes: Axes, name: str) -> int:
    """Which axis of an array leads along "x", "y" or "z"."""
    return next(n for n, axis in enumerate(axes) if axis[1] == name)


def kept_handed(proposed: Sequence[str], axes: Axes) -> list[str]:
    """``proposed``, with y turned where it would mirror what ``axes`` make: a left breast stays a left one."""
    if _handedness(proposed) == _handedness(axes):
        return list(proposed)
    return [("-" if axis[0] == "+" else "+") + "y" if axis[1] == "y" else axis for axis in proposed]


def _handedness(axes: Sequence[str]) -> int:
    """1 or -1: whether the axes, each once, are (x, y, z) turned, or turned and mirrored."""
    order = "".join(axis[1] for axis in axes)
    odd = order not in ("xyz", "yzx", "zxy")
    mirrors = odd + sum(axis[0] == "-" for axis in axes)
    return -1 if mirrors % 2 else 1


class UploadedPhantom(Spec):
    """A label volume that was added to the store (`tomosim phantom add`, `POST /v1/phantoms`; both print this part of
    a specification). It is cut to its tissue; x = 0 is its first plane of tissue, which must be a flat chest wall."""

    kind: Literal["uploaded"] = "uploaded"
    sha256: str = Field(pattern="^[0-9a-f]{64}$", description="digest of the uploaded file")
    shape: tuple[Count, Count, Count] = Field(
        strict=False, description="voxels along the axes of the array, slowest first [1]"
    )
    spacing_mm: tuple[Edge, Edge, Edge] = Field(
        strict=False,
        json_schema_extra={"unit": "mm"},
        description="voxel edges along the axes of the array, slowest first [mm]",
    )
    axes: Axes = Field(
        OWN_AXES,
        strict=False,
        description="where each axis of the array, slowest first, leads: x from the chest wall to the nipple, y along "
        "the tube travel, z from the breast support to the source",
    )
    tissues: TissueMap = Field(
        "victre", description="tissue of every value: a known table, or an object such as {'0': 'air', '1': 'adipose'}"
    )
    compressed: bool = Field(False, description="already compressed along z: neither meshed nor compressed again")
    thickness_mm: float | None = Field(
        None,
        gt=0.0,
        le=500.0,
        json_schema_extra={"unit": "mm"},
        description="distance of the plates of a compressed phantom; the height of its tissue where not given [mm]",
    )
    force_N: float | None = Field(
        None,
        ge=0.0,
        le=10000.0,
        json_schema_extra={"unit": "N"},
        description="force on a plate of a compressed phantom, where it is known [N]",
    )
    extent_mm: tuple[Extent, Extent, Extent] | None = Field(
        None,
        strict=False,
        json_schema_extra={"unit": "mm"},
        description="size of the tissue along (x, y, z), from which the needs are predicted; the whole array where "
        "not given [mm]",
    )

    @model_validator(mode="after")
    def _plates_only_where_compressed(self) -> Self:
        if not self.compressed and (self.thickness_mm is not None or self.force_N is not None):
            raise ValueError("thickness_mm and force_N are those of a phantom with compressed = true")
        return self

    @classmethod
    def example(cls) -> UploadedPhantom:
        return cls(sha256=64 * "0", shape=(300, 400, 350), spacing_mm=(0.4, 0.4, 0.4))

    def parameters(self, seed: int) -> dict[str, Any]:
        """What its labels depend on: not on the seed."""
        return {"spec": self.model_dump(exclude={"force_N", "extent_mm"})}

    def plates(self) -> dict[str, Any] | None:
        """What its compression depends on, where it is compressed already."""
        return {"thickness_mm": self.thickness_mm, "force_N": self.force_N} if self.compressed else None

    def possible_tissues(self) -> set[Tissue]:
        """Tissues that it may hold."""
        return {tissue for tissue in Tissue if has_tissue(self.tissues, tissue)}

    @property
    def voxels(self) -> int:
        """Voxels of the array."""
        a, b, c = self.shape
        return a * b * c

    @property
    def voxels_held(self) -> int:
        """Voxels that are held: those of the tissue, to which it is cut as it is read; the whole array where its extent
        is not known."""
        if self.extent_mm is None:
            return self.voxels
        x, y, z = self.extent_mm
        return min(self.voxels, round(x * y * z / self.voxel_volume_mm3))

    @property
    def voxel_volume_mm3(self) -> float:
        """Volume of a voxel."""
        a, b, c = self.spacing_mm
        return a * b * c

    @property
    def edges_mm(self) -> tuple[float, float, float]:
        """Voxel edges, mm."""
        return self.spacing_mm

    @property
    def coarsest(self) -> float:
        """How many times larger its voxels can be."""
        return MAX_EDGE_MM / max(self.spacing_mm)

    def with_coarser_voxels(self, factor: float) -> UploadedPhantom:
        """The same breast in voxels whose edges are ``factor`` times as long, as if the file were resampled."""
        a, b, c = self.shape
        return self.with_(
            shape=(math.ceil(a / factor), math.ceil(b / factor), math.ceil(c / factor)),
            spacing_mm=tuple(min(edge * factor, MAX_EDGE_MM) for edge in self.spacing_mm),
        )

    @property
    def size_in_words(self) -> str:
        """What makes it large, for messages."""
        return f"phantom.shape = {list(self.shape)}"

    def size_mm(self) -> tuple[float, float, float]:
        """Size of the tissue, or of the array where that is not known, along (x, y, z), mm; along z the distance of the
        plates of a compressed breast, where that is larger."""
        x, y, z = self.extent_mm or self._array_mm()
        return x, y, max(z, self.thickness_mm or 0.0)

    def edge_mm(self, name: str) -> float:
        """Voxel edge along "x", "y" or "z", mm."""
        return self.spacing_mm[along(self.axes, name)]

    def _array_mm(self) -> tuple[float, float, float]:
        x, y, z = (self.shape[along(self.axes, name)] * self.edge_mm(name) for name in "xyz")
        return x, y, z

    def planes_used(self) -> tuple[float, float, float]:
        """``size_mm`` in voxels along the axes of the array."""
        size = dict(zip("xyz", self.size_mm(), strict=True))
        a, b, c = (size[axis[1]] / edge for axis, edge in zip(self.axes, self.spacing_mm, strict=True))
        return a, b, c

    def semi_axes(self) -> tuple[float, float, float, float]:
        """(depth along x, half width along y, upper and lower half height along z), mm."""
        x, y, z = self.size_mm()
        return x, y / 2, z / 2, z / 2
