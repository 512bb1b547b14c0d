"""Skin: membrane triangles on the surface, total Lagrangian. Numba kernels.

Plane stress of an incompressible neo-Hookean sheet, energy per undeformed area t mu/2 (tr C + 1/det C - 3) with the
metric C = F^T F of the surface. A sheet without bending stiffness cannot carry compression, it wrinkles: where a
principal stress would be negative the sheet is in uniaxial tension, t mu/2 (c + 2 c^(-1/2) - 3) with the larger
eigenvalue c of C, and slack where c <= 1. This relaxed energy is convex, so the result does not depend on the mesh.

Source: Pipkin, The relaxed energy density for isotropic elastic membranes, IMA J. Appl. Math. 36 (1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.fem.elements.geometry import Array
from simcore.kernels import njit

_PAIRS = [(a, b) for a in range(3) for b in range(a, 3)]


@dataclass(frozen=True, eq=False)
class Membrane:
    """Triangles that share the nodes of the body.

    triangles: int64 (f, 3), each row ascending. gradients: (f, 3, 2) of the shape functions in the plane of each
    triangle, 1/mm. areas: (f,), mm^2. block_of: int32 (f, 6), block of each pair a <= b in the body's pattern.
    tension: thickness times shear modulus, N/mm.
    """

    triangles: NDArray[np.int64]
    gradients: NDArray[np.float64]
    areas: NDArray[np.float64]
    block_of: NDArray[np.int32]
    tension: float

    @classmethod
    def of(
        cls,
        nodes: NDArray[np.float64],
        skin: NDArray[np.int64],
        row_start: NDArray[np.int32],
        column: NDArray[np.int32],
        tension: float,
    ) -> Membrane:
        """skin: int64 (f, 3), faces of tetrahedra of the pattern (row_start, column)."""
        triangles = np.sort(skin, axis=1)
        first, second, third = (nodes[triangles[:, k]] for k in range(3))
        along = second - first
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along /= length
        across = third - first
        x = (across * along).sum(axis=1, keepdims=True)
        y = np.linalg.norm(across - x * along, axis=1, keepdims=True)
        # Corners (0, 0), (length, 0), (x, y) in the plane of the triangle.
        gradients = np.empty((len(triangles), 3, 2))
        gradients[:, 1] = np.hstack([1 / length, -x / (length * y)])
        gradients[:, 2] = np.hstack([np.zeros_like(y), 1 / y])
        gradients[:, 0] = -gradients[:, 1] - gradients[:, 2]
        count = len(nodes)
        row = np.repeat(np.arange(count), np.diff(row_start))
        keys = row * count + column
        pairs = np.stack([triangles[:, a] * count + triangles[:, b] for a, b in _PAIRS], axis=1)
        return cls(
            triangles=triangles,
            gradients=gradients,
            areas=(0.5 * length * y)[:, 0],
            block_of=np.searchsorted(keys, pairs).astype(np.int32),
            tension=tension,
        )

    def add(
        self,
        displacement: NDArray[np.float64],
        nodes: NDArray[np.float64],
        with_tangent: bool,
        force: NDArray[np.float64],
        blocks: NDArray[Any],
    ) -> None:
        """Adds the membrane's nodal forces (n, 3), N, and its tangent to ``blocks`` (blocks, 4, 4), see
        simcore.fem.elements.model.System."""
        _add_membrane(
            displacement, nodes, self.triangles, self.gradients, self.areas * self.tension, self.block_of,
            with_tangent, force, blocks,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _add_membrane(
    displacement: Array,
    nodes: Array,
    triangles: Array,
    gradients: Array,
    weights: Array,
    block_of: Array,
    with_tangent: bool,
    force: Array,
    blocks: Array,
) -> None:
    F, S, f = np.empty((3, 2)), np.empty((2, 2)), np.empty((3, 3))
    dS = np.empty((2, 2, 2, 2))
    for e in range(triangles.shape[0]):
        gradient = gradients[e]
        for i in range(3):
            for j in range(2):
                F[i, j] = 0.0
                for a in range(3):
                    node = triangles[e, a]
                    F[i, j] += (nodes[node, i] + displacement[node, i]) * gradient[a, j]
        _sheet(F, S, dS)
        for a in range(3):
            for i in range(3):
                f[a, i] = 0.0
                for j in range(2):
                    f[a, i] += F[i, j] * (S[j, 0] * gradient[a, 0] + S[j, 1] * gradient[a, 1])
                force[triangles[e, a], i] += weights[e] * f[a, i]
        if with_tangent:
            _add_tangent(weights[e], F, S, dS, gradient, block_of[e], blocks)


@njit(cache=True, nogil=True)
def _sheet(F: Array, S: Array, dS: Array) -> None:
    """Second Piola-Kirchhoff stress S = 2 dW/dC and its derivative dS = dS_ij/dE_kl of the relaxed energy, for unit
    thickness and shear modulus."""
    c00 = F[0, 0] * F[0, 0] + F[1, 0] * F[1, 0] + F[2, 0] * F[2, 0]
    c11 = F[0, 1] * F[0, 1] + F[1, 1] * F[1, 1] + F[2, 1] * F[2, 1]
    c01 = F[0, 0] * F[0, 1] + F[1, 0] * F[1, 1] + F[2, 0] * F[2, 1]
    half, radius = 0.5 * (c00 + c11), np.sqrt(0.25 * (c00 - c11) ** 2 + c01 * c01)
    large, small = half + radius, half - radius
    S[:] = 0.0
    dS[:] = 0.0
    if small * small * large > 1.0:
        det = c00 * c11 - c01 * c01
        inverse = np.array([[c11 / det, -c01 / det], [-c01 / det, c00 / det]])
        for i in range(2):
            for j in range(2):
                S[i, j] = (1.0 if i == j else 0.0) - inverse[i, j] / det
                for k in range(2):
                    for m in range(2):
                        dS[i, j, k, m] = (
                            2.0 * inverse[i, j] * inverse[k, m]
                            + inverse[i, k] * inverse[j, m]
                            + inverse[i, m] * inverse[j, k]
                        ) / det
    elif large > 1.0:
        angle = 0.5 * np.arctan2(2.0 * c01, c00 - c11)
        n = np.array([np.cos(angle), np.sin(angle)])
        t = np.array([-n[1], n[0]])
        stress, slope = 1.0 - large**-1.5, 3.0 * large**-2.5
        turn = stress / (large - small)
        for i in range(2):
            for j in range(2):
                S[i, j] = stress * n[i] * n[j]
                for k in range(2):
                    for m in range(2):
                        dS[i, j, k, m] = slope * n[i] * n[j] * n[k] * n[m] + turn * (n[i] * t[j] + t[i] * n[j]) * (
                            n[k] * t[m] + t[k] * n[m]
                        )


@njit(cache=True, nogil=True)
def _add_tangent(weight: float, F: Array, S: Array, dS: Array, gradient: Array, block_of: Array, blocks: Array) -> None:
    pair = 0
    for a in range(3):
        for b in range(a, 3):
            block = blocks[block_of[pair]]
            pair += 1
            initial = 0.0
            for j in range(2):
                for k in range(2):
                    initial += gradient[a, j] * S[j, k] * gradient[b, k]
            for i in range(3):
                for m in range(3):
                    s = 0.0
                    for j in range(2):
                        for k in range(2):
                            c = 0.0
                            for p in range(2):
                                for r in range(2):
                                    c += gradient[a, p] * dS[j, p, k, r] * gradient[b, r]
                            s += F[i, j] * c * F[m, k]
                    block[i, m] += weight * s
                block[i, i] += weight * initial
