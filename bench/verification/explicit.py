"""Explicit relaxation: the same equilibrium by damped motion, without tangent, Newton or active set.

Shares with simcore.fem only the weak form: linear tetrahedra, volume averaged at the nodes. Plain numpy.
Source: Joldes, Wittek, Miller, Computation of intra-operative brain shift using dynamic relaxation, Comput. Methods
Appl. Mech. Engrg. 198 (2009).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from bench.support.bodies import Floats
from simcore.core.artifacts import TetMesh
from simcore.fem.laws.law import Law

_RAMP = 3000
_MAX_STEPS = 60000
_DAMPING = 0.02
_SAFETY = 1.5
"""Masses are this much larger than stability of steps of one unit of time asks for."""


@dataclass(frozen=True, eq=False)
class Relaxed:
    """force_lower_N, force_upper_N: plate forces. displacement: (n, 3), mm. steps: of time."""

    force_lower_N: float
    force_upper_N: float
    displacement: Floats
    steps: int

    @property
    def force_N(self) -> float:
        return 0.5 * (self.force_lower_N + self.force_upper_N)


def relax(mesh: TetMesh, law: Law, percent: float, tolerance: float = 1e-4) -> Relaxed:
    """Plates close smoothly, then everything comes to rest.

    Nodes move with the masses that make one unit of time stable; behind a plate their velocity is cut to what takes
    them onto it, and the momentum that this takes away is the plate's force.
    tolerance: change of the plate force within 500 steps, and imbalance of the two, relative.
    raises: RuntimeError where it does not come to rest
    """
    body = _Body.of(mesh, law)
    low, high = mesh.nodes[:, 2].min(), mesh.nodes[:, 2].max()
    way = 0.5 * (high - low) * percent / 100
    on_skin = np.zeros(len(mesh.nodes), dtype=bool)
    on_skin[np.unique(mesh.skin)] = True
    u, velocity = np.zeros(mesh.nodes.shape), np.zeros(mesh.nodes.shape)
    before = np.inf
    for step in range(_MAX_STEPS):
        s = min(1.0, (step + 1) / _RAMP)
        closed = s**3 * (10 - 15 * s + 6 * s * s) * way
        velocity = ((1 - _DAMPING / 2) * velocity - body.force(u) / body.mass[:, None]) / (1 + _DAMPING / 2)
        velocity[mesh.wall, 0] = 0.0
        velocity[mesh.wall, 1] -= velocity[mesh.wall, 1].mean()
        z = mesh.nodes[:, 2] + u[:, 2]
        stopped = np.clip(z + velocity[:, 2], low + closed, high - closed) - z
        push = np.where(on_skin, stopped - velocity[:, 2], 0.0) * body.mass * (1 + _DAMPING / 2)
        velocity[on_skin, 2] = stopped[on_skin]
        u += velocity
        if step > _RAMP and step % 500 == 0:
            lower, upper = float(push[push > 0].sum()), float(-push[push < 0].sum())
            if abs(upper - before) < tolerance * upper and abs(upper - lower) < tolerance * upper:
                return Relaxed(lower, upper, u, step)
            before = upper
    raise RuntimeError(f"no rest within {_MAX_STEPS} steps")


@dataclass(frozen=True, eq=False)
class _Body:
    mesh: TetMesh
    gradients: Floats
    volumes: Floats
    scatter: csr_matrix
    node_volume: Floats
    mass: Floats
    shear: float
    bulk: float

    @classmethod
    def of(cls, mesh: TetMesh, law: Law) -> _Body:
        shear, bulk = law.shear * 1e-3, law.bulk * 1e-3
        corners = mesh.nodes[mesh.tets]
        edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        inner = np.linalg.inv(edges)
        gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
        volumes = np.linalg.det(edges) / 6
        count = len(mesh.tets)
        scatter = csr_matrix(
            (np.ones(4 * count), (mesh.tets.ravel(), np.arange(4 * count))), shape=(len(mesh.nodes), 4 * count)
        )
        stiffest = (bulk + 4 / 3 * shear) * volumes * (gradients**2).sum(axis=(1, 2))
        return cls(
            mesh=mesh,
            gradients=gradients,
            volumes=volumes,
            scatter=scatter,
            node_volume=scatter @ np.repeat(volumes / 4, 4),
            mass=_SAFETY * (scatter @ np.repeat(stiffest / 4, 4)),
            shear=shear,
            bulk=bulk,
        )

    def force(self, u: Floats) -> Floats:
        """Internal force, (n, 3), N."""
        tets = self.mesh.tets
        F = np.matmul(u[tets].transpose(0, 2, 1), self.gradients) + np.eye(3)
        cofactor = np.stack(
            [np.cross(F[:, 1], F[:, 2]), np.cross(F[:, 2], F[:, 0]), np.cross(F[:, 0], F[:, 1])], axis=1
        )
        J = (F[:, 0] * cofactor[:, 0]).sum(axis=1)
        node_ratio = self.scatter @ np.repeat(self.volumes * J / 4, 4) / self.node_volume
        pressure = (self.bulk / 2 * (node_ratio - 1 / node_ratio))[tets].mean(axis=1)
        shear = self.shear * J ** (-2 / 3)
        I1 = (F * F).sum(axis=(1, 2))
        stress = shear[:, None, None] * F + (pressure - shear * I1 / (3 * J))[:, None, None] * cofactor
        nodal = np.matmul(self.gradients, stress.transpose(0, 2, 1)) * self.volumes[:, None, None]
        force: Floats = self.scatter @ nodal.reshape(-1, 3)
        return force
