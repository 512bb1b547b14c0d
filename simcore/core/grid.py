"""A regular voxel grid in a right-handed frame, mm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Grid:
    """Where the voxels of an array (z, y, x) lie.

    shape:   (nz, ny, nx), array order.
    spacing: voxel edge along (x, y, z), mm. Points and vectors are always (x, y, z).
    corner:  (x, y, z) of the outer corner of voxel [0, 0, 0], mm (not its centre): a chest wall at x = 0 is exact.
    """

    shape: tuple[int, int, int]
    spacing: Point
    corner: Point

    def centres(self, axis: str) -> NDArray[np.float64]:
        """Voxel centres along "x", "y" or "z", mm."""
        i = "xyz".index(axis)
        return self.corner[i] + (np.arange(self.shape[2 - i], dtype=np.float64) + 0.5) * self.spacing[i]

    @property
    def upper(self) -> Point:
        """The outer corner opposite to ``corner``, mm."""
        nz, ny, nx = self.shape
        return tuple(  # type: ignore[return-value]
            c + n * s for c, n, s in zip(self.corner, (nx, ny, nz), self.spacing, strict=True)
        )

    @property
    def voxel_volume(self) -> float:
        """mm^3"""
        return float(np.prod(self.spacing))

    @property
    def size(self) -> int:
        """Number of voxels."""
        return int(np.prod(self.shape, dtype=np.int64))

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Grid:
        """The same grid displaced by (x, y, z) mm."""
        cx, cy, cz = self.corner
        return Grid(self.shape, self.spacing, (cx + x, cy + y, cz + z))

    def to_dict(self) -> dict[str, Any]:
        return {"shape": list(self.shape), "spacing": list(self.spacing), "corner": list(self.corner)}

    @classmethod
    def from_dict(cls, d: dict[str, Any]) -> Grid:
        return cls(tuple(d["shape"]), tuple(d["spacing"]), tuple(d["corner"]))
