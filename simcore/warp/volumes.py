"""What became of the volume of every tissue: nothing may be lost but what the compression itself takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of, where
from simcore.core.artifacts import Phantom, Report, TetMesh
from simcore.core.errors import SolverError
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES
from simcore.kernels import njit, prange
from simcore.warp.spec import MOST_SKIRT_MM, WarpSpec

SAMPLES = 4
"""Samples along an edge of a tetrahedron, 20 in each: a tissue of 1 % of a breast is met by thousands of them."""
MOST_LOST = 0.01
"""Volume that may be missing of the breast, or of one of its tissues, as a share of the breast, beyond what voxels
counted by their centres can miss. 0.2 % of the breast is usual; skin of a voxel or two comes near 1 % of it."""


def squeezed(phantom: Phantom, mesh: TetMesh, ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Volume after over volume before of every tissue, by the compression alone, (MAX_TISSUES,); the mean of the breast
    for tissues that no sample meets.

    ratio: (m,) of the tetrahedra.
    """
    corners = mesh.nodes[mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    grid = phantom.grid
    shares = _shares(
        (corners - np.array(grid.corner)) / np.array(grid.spacing), _sample_weights(SAMPLES), phantom.labels
    )  # (m, MAX_TISSUES)
    before, after = volume @ shares, (volume * ratio) @ shares
    mean = float((volume * ratio).sum() / volume.sum())
    return np.where(before > 0, after / np.where(before > 0, before, 1.0), mean)


def _sample_weights(edge: int) -> NDArray[np.float64]:
    """Barycentric weights of points spread evenly over a tetrahedron, (s, 4)."""
    a, b, c = np.meshgrid(*[np.arange(edge)] * 3, indexing="ij")
    inside = a + b + c < edge
    first = np.stack([a[inside], b[inside], c[inside]], axis=1)
    return (np.concatenate([first, edge - 1 - first.sum(axis=1, keepdims=True)], axis=1) + 0.25) / edge


@njit(parallel=True, cache=True, error_model="numpy")
def _shares(cells: NDArray[np.float64], weights: NDArray[np.float64], labels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Share of every label among the samples of each tetrahedron. cells: (m, 4, 3) nodes in voxels from the corner."""
    nz, ny, nx = labels.shape
    shares = np.zeros((len(cells), MAX_TISSUES))
    for m in prange(len(cells)):
        for s in range(len(weights)):
            x = y = z = 0.0
            for n in range(4):
                x += weights[s, n] * cells[m, n, 0]
                y += weights[s, n] * cells[m, n, 1]
                z += weights[s, n] * cells[m, n, 2]
            i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                shares[m, labels[k, j, i]] += 1.0 / len(weights)
    return shares


def counting_error(grid: Grid) -> float:
    """How much smaller a body that fills ``grid`` may seem where voxels are counted by their centres: by half a voxel
    along each axis."""
    return 0.5 * sum(1 / cells for cells in grid.shape)


def require_whole(report: Report, spec: WarpSpec) -> None:
    """report: of a warp. raises: SolverError (code "tissue-lost") where more is missing than voxels explain."""
    expected, after = report["tissue_expected_ml"], report["tissue_after_ml"]
    whole = sum(expected.values())
    allowed = (MOST_LOST + counting_error(Grid.from_dict(report["grid"]))) * whole
    parts = {"the breast": (whole, report["volume_after_ml"])}
    parts |= {f"the {name}": (ml, after.get(name, 0.0)) for name, ml in expected.items()}
    for name, (ml, there) in parts.items():
        if there < ml - allowed:
            remedy = one_of(
                "a smaller mesh.edge_length_mm",
                "smaller voxels",
                where(spec.skirt_mm < MOST_SKIRT_MM, f"a warp.skirt_mm above {spec.skirt_mm:g}"),
                "less compression",
            )
            raise SolverError(
                f"{name} has {there:.4g} ml after compression where {ml:.4g} ml belong there; of a breast of "
                f"{whole:.4g} ml at most {allowed:.2g} ml may be missing; take {remedy}",
                code="tissue-lost",
            )
