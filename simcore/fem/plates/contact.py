"""Two plates as a primal-dual active set: a node is free or exactly on a plate, no penalty.

Source: Hueber, Wohlmuth, A primal-dual active set strategy for non-linear multibody contact problems, Comput.
Methods Appl. Mech. Engrg. 194 (2005).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simcore.fem.elements.model import Floats

FREE, UPPER, LOWER = 0, 1, 2
PENETRATION_MM = 1e-9
TENSION = 1e-6
"""Pull on a node, relative to the largest nodal force, at which it leaves a plate."""
MAX_RELEASES = 4
"""A node that leaves and returns more often waits on its plate until all the others have come to rest."""
MAX_PULL = 1e-3
"""Pull on a node, relative to the largest nodal force, that an equilibrium may not have."""


@dataclass(frozen=True, eq=False)
class Plates:
    """Where the plates are.

    lower, upper: z of the plates, mm; of a tilted upper plate at x = pivot. slope: dz/dx of the upper plate.
    lower_bend, upper_bend: (n,) z that bending adds at the nodes, mm; none for rigid plates.
    lower_rise, upper_rise: (n,) z that an edge at a fixed chest wall adds at the nodes, mm; none for flat plates.
    """

    lower: float
    upper: float
    slope: float = 0.0
    pivot: float = 0.0
    lower_bend: Floats | None = None
    upper_bend: Floats | None = None
    lower_rise: Floats | None = None
    upper_rise: Floats | None = None

    @classmethod
    def at(cls, z: Floats, percent: float, slope: float = 0.0, pivot: float = 0.0) -> Plates:
        """Plates that have taken ``percent`` of the extent of ``z``, each from its own side by the same distance."""
        low, high = float(z.min()), float(z.max())
        travel = 0.5 * (high - low) * percent / 100
        return cls(low + travel, high - travel, slope, pivot)

    @property
    def upper_normal(self) -> Floats:
        """(3,), away from the breast."""
        normal: Floats = np.array([-self.slope, 0.0, 1.0]) / np.hypot(1.0, self.slope)
        return normal

    @property
    def level(self) -> bool:
        """Whether both are planes z = constant, but for an edge."""
        return self.slope == 0.0 and self.lower_bend is None and self.upper_bend is None

    def bounds(self, points: Floats) -> tuple[float, float]:
        """(lowest, highest) z between the plates, mm: theirs where they are level, else that of the breast there."""
        if self.level:
            return self.lower, self.upper
        return float(points[:, 2].min()), float(points[:, 2].max())

    def heights(self, points: Floats) -> tuple[Floats | float, Floats | float]:
        """z of the lower and the upper plate where the nodes are, mm. points: (n, 3), of all nodes."""
        lower: Floats | float = self.lower
        upper: Floats | float = self.upper
        if self.slope != 0.0:
            upper = upper + self.slope * (points[:, 0] - self.pivot)
        for added in (self.lower_bend, self.lower_rise):
            lower = lower if added is None else lower + added
        for added in (self.upper_bend, self.upper_rise):
            upper = upper if added is None else upper + added
        return lower, upper


@dataclass(frozen=True, eq=False)
class Contact:
    """Who is on which plate.

    candidates: int64 (c,), nodes that may touch. status: int8 (n,), FREE, UPPER or LOWER.
    releases: int16 (n,), how often each node has left a plate in this load step.
    wall: int64 (w,), nodes whose x the chest wall holds, so that a tilted plate is not all that acts along x.
    """

    candidates: NDArray[np.int64]
    status: NDArray[np.int8]
    releases: NDArray[np.int16]
    wall: NDArray[np.int64] | None = None

    @classmethod
    def none(cls, skin: NDArray[np.int64], node_count: int) -> Contact:
        """skin: boundary triangles (f, 3)."""
        return cls(np.unique(skin), np.zeros(node_count, np.int8), np.zeros(node_count, np.int16))

    def without(self, nodes: NDArray[np.int64]) -> Contact:
        """The same, but ``nodes`` may not touch."""
        return replace(self, candidates=np.setdiff1d(self.candidates, nodes))

    def holding(self, nodes: NDArray[np.int64]) -> Contact:
        """The same with ``nodes`` on the chest wall."""
        return replace(self, wall=nodes)

    def new_load_step(self) -> Contact:
        return replace(self, releases=np.zeros_like(self.releases))

    def updated(self, points: Floats, force: Floats, plates: Plates, *, may_release: bool) -> Contact:
        """Nodes behind a plate are put on it, nodes it would have to pull are released.

        points: (n, 3), present, mm. force: (n, 3) internal force, N.
        """
        c = self.candidates
        status, releases = self.status.copy(), self.releases.copy()
        free = self.status[c] == FREE
        below, above = (points[:, 2] - height for height in plates.heights(points))
        status[c[free & (above[c] > PENETRATION_MM)]] = UPPER
        status[c[free & (below[c] < -PENETRATION_MM)]] = LOWER
        if may_release:
            threshold = TENSION * np.abs(force[c, 2]).max(initial=0.0)
            leaving = c[(self.push(force, plates)[c] < -threshold) & (releases[c] < MAX_RELEASES)]
            status[leaving] = FREE
            releases[leaving] += 1
        return replace(self, status=status, releases=releases)

    def push(self, force: Floats, plates: Plates) -> Floats:
        """(n,) force with which a plate pushes each node along its normal, N; 0 for free nodes."""
        upper = -force[:, 2]
        if plates.slope != 0.0:
            normal = plates.upper_normal
            upper = -(force @ normal)
            if self.wall is not None:
                upper[self.wall] = -force[self.wall, 2] / normal[2]
        return np.where(self.status == UPPER, upper, np.where(self.status == LOWER, force[:, 2], 0.0))

    def reaction(self, force: Floats, plates: Plates) -> Floats:
        """(n, 3) normal forces of the plates on the nodes, N."""
        push = self.push(force, plates)[:, None]
        status = self.status[:, None]
        return np.where(
            status == UPPER, -push * plates.upper_normal, np.where(status == LOWER, push * [0, 0, 1.0], 0.0)
        )

    def gap(self, points: Floats, plates: Plates) -> Floats:
        """(n,) way along z that brings each node of the active set onto its plate, 0 for free nodes, mm."""
        lower, upper = plates.heights(points)
        z = points[:, 2]
        return np.where(self.status == UPPER, upper - z, np.where(self.status == LOWER, lower - z, 0.0))

    def forces(self, force_z: Floats) -> tuple[float, float]:
        """(on the lower plate, on the upper plate) along z, N, positive when pushed away."""
        return float(force_z[self.status == LOWER].sum()), float(-force_z[self.status == UPPER].sum())

    def relative_pull(self, force: Floats, plates: Plates) -> float:
        """Largest force with which a plate would have to pull on a node, relative to the largest with which it
        pushes; 0 where all are pushed."""
        push = self.push(force, plates)
        return float(max(-push.min(), 0.0) / max(push.max(), 1e-300))

    def penetration(self, points: Floats, plates: Plates) -> float:
        """Largest depth of a candidate node behind a plate, mm."""
        below, above = (points[:, 2] - height for height in plates.heights(points))
        return float(max(above[self.candidates].max(), -below[self.candidates].min(), 0.0))
