"""Two rigid, frictionless plates as a primal-dual active set: a node is free or exactly on a plate, no penalty.

Source: Hueber, Wohlmuth, A primal-dual active set strategy for non-linear multibody contact problems, Comput.
Methods Appl. Mech. Engrg. 194 (2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.fem.model import Floats

FREE, UPPER, LOWER = 0, 1, 2
PENETRATION_MM = 1e-9
TENSION = 1e-6
"""Pull on a node, relative to the largest nodal force, at which it leaves a plate."""
MAX_RELEASES = 4
"""A node that leaves and returns more often waits on its plate until all the others have come to rest."""
MAX_PULL = 1e-3
"""Pull on a node, relative to the largest nodal force, that an equilibrium may not have."""


@dataclass(frozen=True)
class Plates:
    """z of the lower and the upper plate, mm."""

    lower: float
    upper: float

    @classmethod
    def at(cls, z: Floats, percent: float) -> Plates:
        """Plates that have taken ``percent`` of the extent of ``z``, each from its own side by the same distance."""
        low, high = float(z.min()), float(z.max())
        travel = 0.5 * (high - low) * percent / 100
        return cls(low + travel, high - travel)


@dataclass(frozen=True, eq=False)
class Contact:
    """Who is on which plate.

    candidates: int64 (c,), nodes that may touch. status: int8 (n,), FREE, UPPER or LOWER.
    releases: int16 (n,), how often each node has left a plate in this load step.
    """

    candidates: NDArray[np.int64]
    status: NDArray[np.int8]
    releases: NDArray[np.int16]

    @classmethod
    def none(cls, skin: NDArray[np.int64], node_count: int) -> Contact:
        """skin: boundary triangles (f, 3)."""
        return cls(np.unique(skin), np.zeros(node_count, np.int8), np.zeros(node_count, np.int16))

    def without(self, nodes: NDArray[np.int64]) -> Contact:
        """The same, but ``nodes`` may not touch."""
        return Contact(np.setdiff1d(self.candidates, nodes), self.status, self.releases)

    def new_load_step(self) -> Contact:
        return Contact(self.candidates, self.status, np.zeros_like(self.releases))

    def updated(self, z: Floats, force_z: Floats, plates: Plates, *, may_release: bool) -> Contact:
        """Nodes behind a plate are put on it, nodes it would have to pull are released.

        z: (n,) present height, mm. force_z: (n,) internal force along z, N: negative where the upper plate pushes.
        """
        c = self.candidates
        status, releases = self.status.copy(), self.releases.copy()
        free = self.status[c] == FREE
        status[c[free & (z[c] > plates.upper + PENETRATION_MM)]] = UPPER
        status[c[free & (z[c] < plates.lower - PENETRATION_MM)]] = LOWER
        if may_release:
            threshold = TENSION * np.abs(force_z[c]).max(initial=0.0)
            pulled = ((self.status[c] == UPPER) & (force_z[c] > threshold)) | (
                (self.status[c] == LOWER) & (force_z[c] < -threshold)
            )
            leaving = c[pulled & (releases[c] < MAX_RELEASES)]
            status[leaving] = FREE
            releases[leaving] += 1
        return Contact(c, status, releases)

    def gap(self, z: Floats, plates: Plates) -> Floats:
        """(n,) way along z that brings each node of the active set onto its plate, 0 for free nodes, mm."""
        return np.where(self.status == UPPER, plates.upper - z, np.where(self.status == LOWER, plates.lower - z, 0.0))

    def forces(self, force_z: Floats) -> tuple[float, float]:
        """(on the lower plate, on the upper plate), N, positive when pushed away."""
        return float(force_z[self.status == LOWER].sum()), float(-force_z[self.status == UPPER].sum())

    def relative_pull(self, force_z: Floats) -> float:
        """Largest force with which a plate would have to pull on a node, relative to the largest with which it
        pushes; 0 where all are pushed."""
        push = np.where(self.status == UPPER, -force_z, np.where(self.status == LOWER, force_z, 0.0))
        return float(max(-push.min(), 0.0) / max(push.max(), 1e-300))

    def penetration(self, z: Floats, plates: Plates) -> float:
        """Largest depth of a candidate node behind a plate, mm."""
        heights = z[self.candidates]
        return float(max((heights - plates.upper).max(), (plates.lower - heights).max(), 0.0))
