"""Which displacements are free: supports along the axes, and nodes that glide along a tilted plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.fem.plates.contact import FREE, UPPER, Contact, Plates

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Constraints:
    """free: bool (n, 3), per component. gliding: bool (n,), nodes that may moreover not move along ``normal`` (3,)."""

    free: NDArray[np.bool_]
    gliding: NDArray[np.bool_]
    normal: Floats

    @classmethod
    def of(cls, fixed: NDArray[np.bool_], contact: Contact, plates: Plates) -> Constraints:
        """fixed: bool (n, 3), supports."""
        free = ~fixed
        if plates.slope == 0.0:
            free[contact.status != FREE, 2] = False
            return cls(free, np.zeros(len(free), dtype=bool), plates.upper_normal)
        gliding = contact.status == UPPER
        free[(contact.status != FREE) & ~gliding, 2] = False
        return cls(free, gliding, plates.upper_normal)

    def project(self, v: Floats) -> None:
        """Takes what is not free out of v (n, 3), in place."""
        v *= self.free
        if self.gliding.any():
            normals = self.normal * self.free[self.gliding]
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
            v[self.gliding] -= normals * (v[self.gliding] * normals).sum(axis=1, keepdims=True)
