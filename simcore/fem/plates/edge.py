"""Plates that rise towards the rim of what holds the breast: a fixed chest wall, or muscle.

Where flat plates reach a wall that is held altogether, skin at the wall's full height and skin on a plate meet at one
line. No displacement of finite energy has such a jump on its boundary: the force grows as the logarithm of the element
size, and with an exponential law without bounds. So plates have an edge: within ``edge`` of the wall they rise as a
parabola. It is laid along the undeformed skin: a node keeps its place on the edge, and is pushed along z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simcore.fem.elements.model import Floats
from simcore.fem.plates.contact import Plates

RISE = 1.5
"""Rise of a plate at the wall, relative to the height of the wall's rim above the flat part: skin leaves the plate
before it comes to the corner."""


@dataclass(frozen=True, eq=False)
class PlateEdge:
    """share: (n,) of the rise that a node has, 0 on the flat part, 1 at the rim. rim: z of the lowest and highest node
    that is held, mm."""

    share: Floats
    rim: tuple[float, float]

    @classmethod
    def of(cls, nodes: Floats, wall: NDArray[np.int64], width: float) -> PlateEdge:
        """nodes: (n, 3), undeformed. wall: those of the skin that cannot move. width: distance from them, along x where
        they lie in a plane, at which the plates are flat, mm."""
        if (nodes[wall, 0] == nodes[wall[0], 0]).all():
            distance = nodes[:, 0] - nodes[wall[0], 0]
        else:
            distance = cKDTree(nodes[wall]).query(nodes)[0]
        share = np.maximum(1 - distance / width, 0.0) ** 2
        return cls(share, (float(nodes[wall, 2].min()), float(nodes[wall, 2].max())))

    def on(self, plates: Plates) -> Plates:
        """``plates`` with this edge; none as long as they stand outside the rim."""
        low, high = self.rim
        return replace(
            plates,
            lower_rise=RISE * min(low - plates.lower, 0.0) * self.share,
            upper_rise=RISE * max(high - plates.upper, 0.0) * self.share,
        )
