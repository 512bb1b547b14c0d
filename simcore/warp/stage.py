"""The warp stage."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.core.progress import Progress
from simcore.core.tissues import Tissue
from simcore.warp.maps import tet_maps
from simcore.warp.pieces import interior, skirt
from simcore.warp.raster import census, count_holes, rasterise
from simcore.warp.spec import WarpSpec
from simcore.warp.truth import carried


def deform_phantom(
    phantom: Phantom, mesh: TetMesh, compression: Compression, spec: WarpSpec, progress: Progress
) -> Phantom:
    """See simcore.warp.deform."""
    progress(0.0, "maps of the tetrahedra")
    deformed = mesh.nodes + compression.displacement - np.array([0.0, 0.0, compression.plate_z[0]])
    grid = output_grid(deformed, compression.thickness, spec.skirt_mm, phantom.grid)
    # A voxel belongs to the breast only if its centre is below the upper plate.
    levels = math.floor(compression.thickness / grid.spacing[2] + 0.5 + 1e-9)
    maps = tet_maps(mesh, deformed, grid, phantom.grid)
    labels = np.zeros(grid.shape, np.uint8)
    progress(0.2, "looking up labels")
    rasterise(interior(maps, grid, levels), maps, phantom.labels, labels)
    added = 0
    if spec.skirt_mm > 0:
        progress(0.8, "skin outside the mesh")
        added = rasterise(skirt(mesh, maps, grid, spec.skirt_mm, levels), maps, phantom.labels, labels)
    counts, before = census(labels), census(phantom.labels)
    progress(1.0, f"{int(counts[1:].sum())} voxels of tissue")
    voxel_ml = grid.voxel_volume * 1e-3
    return Phantom(
        labels=labels,
        grid=grid,
        truth=carried(phantom.truth, mesh, deformed),
        report={
            "volume_before_ml": float(before[1:].sum()) * phantom.grid.voxel_volume * 1e-3,
            "volume_after_ml": float(counts[1:].sum()) * voxel_ml,
            "tissue_before_ml": _by_name(before, phantom.grid.voxel_volume * 1e-3),
            "tissue_after_ml": _by_name(counts, voxel_ml),
            "mesh_volume_ml": float(np.sum(1.0 / np.abs(np.linalg.det(maps.barycentric[:, 1:, 1:])))) / 6 * voxel_ml,
            "skirt_ml": int(added) * voxel_ml,
            "holes": count_holes(labels),
            "grid": grid.to_dict(),
        },
    )


def output_grid(deformed: NDArray[np.float64], thickness: float, margin_mm: float, source: Grid) -> Grid:
    """The grid of the compressed phantom, support frame, with the voxel edges of ``source``.

    Its corner is x = 0, z = 0; it is symmetric about y = 0 and reaches from plate to plate. A grid whose voxel centres
    lie on y = 0 keeps them there.
    """
    edge_x, edge_y, edge_z = source.spacing
    slack = 1e-6
    nx = max(1, math.ceil((deformed[:, 0].max() + margin_mm) / edge_x - slack))
    half = (np.abs(deformed[:, 1]).max() + margin_mm) / edge_y - slack
    centred = abs((source.corner[1] / edge_y) % 1.0 - 0.5) < 0.25
    ny = 2 * math.ceil(half - 0.5) + 1 if centred else 2 * math.ceil(half)
    nz = max(1, math.ceil(thickness / edge_z - slack))
    return Grid((nz, ny, nx), source.spacing, (0.0, -ny * edge_y / 2, 0.0))


def _by_name(counts: NDArray[np.int64], voxel_ml: float) -> dict[str, float]:
    """Volume of every tissue that is there, ml."""
    return {t.name.lower(): float(counts[t]) * voxel_ml for t in Tissue if t and counts[t]}
