"""Which tissues each tetrahedron holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.fem.laws import MaterialSpec
from simcore.fem.laws.by_tissue import ByTissue
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.laws.published import Published
from simcore.kernels import njit

Array = NDArray[Any]

SUBDIVISIONS = 2
"""A tetrahedron is sampled at the centres of its 8^SUBDIVISIONS parts of equal volume."""


def element_laws(mesh: TetMesh, phantom: Phantom, material: MaterialSpec) -> ElementLaws:
    """The laws of ``material`` in the elements of ``mesh``.

    raises: SolverError, code "mixed-strains"
    """
    if not isinstance(material, ByTissue | Published):
        return ElementLaws.homogeneous(material.law(), len(mesh.tets))
    by_tissue = material.laws()
    laws = list(dict.fromkeys(by_tissue.values()))
    shares = tissue_fractions(mesh, phantom)
    fractions = np.zeros((len(mesh.tets), len(laws)))
    for tissue, law in by_tissue.items():
        fractions[:, laws.index(law)] += shares[:, tissue]
    return ElementLaws.of(laws, fractions)


def tissue_fractions(mesh: TetMesh, phantom: Phantom) -> NDArray[np.float64]:
    """Share of every tissue in the volume of each tetrahedron, (m, MAX_TISSUES); rows sum to 1.

    Air counts only where a tetrahedron holds nothing else: the mesh surface cuts corners of the outline.
    raises: ValueError where a label is no tissue
    """
    grid = phantom.grid
    if phantom.labels.max(initial=0) >= MAX_TISSUES:
        raise ValueError(f"label {phantom.labels.max()} is no tissue: {MAX_TISSUES - 1} is the largest")
    counts = _count_labels(
        mesh.nodes,
        mesh.tets,
        _sample_points(SUBDIVISIONS),
        phantom.labels,
        np.array(grid.corner),
        np.array(grid.spacing),
    )
    inside = counts[:, Tissue.AIR + 1 :].sum(axis=1)
    counts[inside > 0, Tissue.AIR] = 0
    shares: NDArray[np.float64] = counts / counts.sum(axis=1, keepdims=True)
    return shares


def _sample_points(subdivisions: int) -> NDArray[np.float64]:
    """Barycentric coordinates (8^subdivisions, 4) of the centres of a regular subdivision into equal volumes: four
    corner tetrahedra and four around a diagonal of the octahedron between them."""
    tets = np.eye(4)[None]
    for _ in range(subdivisions):
        a, b, c, d = (tets[:, k] for k in range(4))
        ab, ac, ad, bc, bd, cd = ((p + q) / 2 for p, q in ((a, b), (a, c), (a, d), (b, c), (b, d), (c, d)))
        parts = [
            (a, ab, ac, ad), (b, ab, bc, bd), (c, ac, bc, cd), (d, ad, bd, cd),
            (ab, cd, ac, ad), (ab, cd, ad, bd), (ab, cd, bd, bc), (ab, cd, bc, ac),
        ]  # fmt: skip
        tets = np.concatenate([np.stack(part, axis=1) for part in parts])
    centres: NDArray[np.float64] = tets.mean(axis=1)
    return centres


@njit(cache=True, nogil=True)
def _count_labels(nodes: Array, tets: Array, points: Array, labels: Array, corner: Array, spacing: Array) -> Array:
    """(m, MAX_TISSUES) samples of each label; beyond the grid is air."""
    counts = np.zeros((tets.shape[0], MAX_TISSUES))
    nz, ny, nx = labels.shape
    x = np.empty(3)
    for e in range(tets.shape[0]):
        for s in range(points.shape[0]):
            for i in range(3):
                x[i] = -corner[i]
                for a in range(4):
                    x[i] += points[s, a] * nodes[tets[e, a], i]
                x[i] = np.floor(x[i] / spacing[i])
            label = 0
            if 0 <= x[0] < nx and 0 <= x[1] < ny and 0 <= x[2] < nz:
                label = labels[int(x[2]), int(x[1]), int(x[0])]
            counts[e, label] += 1.0
    return counts
