"""Where the mesh is to be denser: edge lengths on a coarse grid, shorter at borders of tissues.

The share of gland and the share of body are averaged over blocks and smoothed over an edge length; a border is where
one of them is as steep as a smoothed step. Source: the paper, section 3.3 (elements denser at tissue borders); the
formula is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simcore.core.artifacts import Phantom
from simcore.core.tissues import Tissue
from simcore.kernels import njit, prange
from simcore.mesh.structured import cube_tets
from simcore.mesh.surface import in_front_of_wall

GLANDULAR = (Tissue.GLAND, Tissue.MASS, Tissue.CALCIFICATION, Tissue.NIPPLE, Tissue.DUCT)
"""What counts as gland; ligaments are thinner than any element and no border."""
_SMOOTHING = 0.5
"""Standard deviation of the smoothing over the edge length ..."""
_STEEPEST = 0.8 / (_SMOOTHING * np.sqrt(2 * np.pi))
"""... and slope of a flat step after it (less what the blocks take away) times the edge length."""


@dataclass(frozen=True, eq=False)
class SizingField:
    """Wanted edge lengths, linear in the tetrahedra of a background mesh.

    points: float64 (n, 3) (x, y, z), mm; tets: int32 (m, 4); lengths: float64 (n,), mm.
    """

    points: NDArray[np.float64]
    tets: NDArray[np.int32]
    lengths: NDArray[np.float64]


@njit(cache=True, parallel=True, nogil=True)
def _count_tissues(labels: Any, is_gland: Any, block: Any, body: Any, gland: Any) -> None:
    """Voxels that are not air, and those of gland, of every block."""
    nz, ny, nx = labels.shape
    for k in prange(body.shape[0]):
        for z in range(k * block[0], min((k + 1) * block[0], nz)):
            for y in range(ny):
                j = y // block[1]
                for x in range(nx):
                    tissue = labels[z, y, x]
                    if tissue != 0:
                        body[k, j, x // block[2]] += 1
                        gland[k, j, x // block[2]] += is_gland[tissue]


def sizing_field(phantom: Phantom, edge_length: float, refinement: float) -> SizingField:
    """``edge_length`` far from borders, ``edge_length / refinement`` on them.

    edge_length: mm; refinement: above 1. The field ends an edge length or more outside the body.
    """
    labels = in_front_of_wall(phantom)
    spacing = np.array(phantom.grid.spacing)[::-1]
    block = np.maximum(1, np.round(0.5 * edge_length / spacing)).astype(np.int64)
    shape = tuple(-(-n // b) for n, b in zip(labels.shape, block.tolist(), strict=True))
    body, gland = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    _count_tissues(labels, np.isin(np.arange(256), GLANDULAR), block, body, gland)

    step = spacing * block
    border = np.zeros(tuple(n + m for n, m in zip(shape, (6, 6, 4), strict=True)))
    for count in (body, gland):
        # Mirrored at the wall, which is no border.
        share = np.pad(count / np.prod(block), [(3, 3), (3, 3), (0, 3)])
        share = np.pad(share, [(0, 0), (0, 0), (1, 0)], mode="edge")
        smooth = gaussian_filter(share, _SMOOTHING * edge_length / step, mode=["constant", "constant", "nearest"])
        slope = np.sqrt(sum(g * g for g in np.gradient(smooth, *step)))
        border = np.maximum(border, slope / _STEEPEST * edge_length)
    lengths = edge_length / (1 + (refinement - 1) * np.minimum(border, 1))

    first = np.array([0.0, phantom.grid.corner[1], phantom.grid.corner[2]])[::-1] - np.array([3, 3, 1]) * step
    z, y, x = (first[i] + (np.arange(lengths.shape[i]) + 0.5) * step[i] for i in range(3))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    nz, ny, nx = lengths.shape
    tets = cube_tets((nx - 1, ny - 1, nz - 1)).astype(np.int32)
    return SizingField(points, tets, np.ascontiguousarray(lengths.transpose(2, 1, 0)).ravel())
