"""The warp stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, Report, TetMesh
from simcore.core.progress import Progress
from simcore.core.tissues import Tissue
from simcore.warp.carrying import Carried, carry
from simcore.warp.maps import TetMaps, tet_maps
from simcore.warp.objects import components
from simcore.warp.pieces import FACES, Pieces, interior, skirt
from simcore.warp.placing import BEYOND_MM, Placing, placing, trimmed, within_plates
from simcore.warp.points import ForwardMap
from simcore.warp.raster import census, count_holes, rasterise
from simcore.warp.spec import WarpSpec
from simcore.warp.truth import carried
from simcore.warp.volumes import squeezed


def deform_phantom(
    phantom: Phantom, mesh: TetMesh, compression: Compression, spec: WarpSpec, progress: Progress
) -> Phantom:
    """See simcore.warp.deform; does not look whether tissue is missing."""
    progress(0.0, "maps of the tetrahedra")
    deformed = mesh.nodes + compression.displacement - np.array([0.0, 0.0, compression.plate_z[0]])
    place = placing(deformed, compression.thickness, spec.skirt_mm, phantom.grid)
    maps = tet_maps(mesh, deformed, place.grid, phantom.grid)
    forward = ForwardMap.of(mesh, deformed)
    before = census(phantom.labels)
    labels = np.zeros(place.grid.shape, np.uint8)
    progress(0.2, "looking up labels")
    beyond = np.stack([deformed[:, 2] < -BEYOND_MM, deformed[:, 2] > compression.thickness + BEYOND_MM], axis=1)
    inner = within_plates(interior(maps, place.grid), place, np.asarray(beyond[mesh.tets].any(axis=1)))
    rasterise(inner, maps, phantom.labels, labels)
    added = 0
    if spec.skirt_mm > 0:
        progress(0.8, "skin outside the mesh")
        added = rasterise(_skirt(mesh, maps, place, beyond, spec.skirt_mm), maps, phantom.labels, labels)
    labels, place = trimmed(labels, place)
    lesions = carry(phantom, before, mesh, forward, labels, place.grid)
    after = census(labels)
    progress(1.0, f"{int(after[1:].sum())} voxels of tissue")
    voxel_ml, grid = phantom.grid.voxel_volume * 1e-3, place.grid
    return Phantom(
        labels=labels,
        grid=grid,
        truth=carried(phantom.truth, forward),
        report={
            "volume_before_ml": float(before[1:].sum()) * voxel_ml,
            "volume_after_ml": float(after[1:].sum()) * voxel_ml,
            "tissue_before_ml": _by_name(before * voxel_ml),
            "tissue_after_ml": _by_name(after * voxel_ml),
            "tissue_expected_ml": _by_name(before * voxel_ml * squeezed(phantom, mesh, forward.ratio)),
            "mesh_volume_ml": float(np.sum(1.0 / np.abs(np.linalg.det(maps.barycentric[:, 1:, 1:])))) / 6 * voxel_ml,
            "skirt_ml": int(added) * voxel_ml,
            "beyond_plates_mm": [place.below_mm, place.above_mm],
            "lesion_objects": _objects(lesions, labels),
            "holes": count_holes(labels),
            "grid": grid.to_dict(),
        },
    )


def _skirt(mesh: TetMesh, maps: TetMaps, place: Placing, beyond: NDArray[np.bool_], reach_mm: float) -> Pieces:
    """Cut at the plates, but for faces that lie beyond them. beyond: (n, 2) of the nodes."""
    pieces = skirt(mesh, maps, place.grid, reach_mm)
    faces = mesh.tets[pieces.tet[:, None], FACES[pieces.outside]]
    return within_plates(pieces, place, np.asarray(beyond[faces].any(axis=1)))


def _objects(lesions: Carried, labels: NDArray[np.uint8]) -> Report:
    """What became of connected lesions, by tissue: {"before", "after": how many there are, "placed": of them by the
    forward map, "merged": had to touch another one, "lost": found no place}."""
    facts: Report = {}
    for tissue, total in lesions.objects.total.items():
        _, number = components(labels, tissue)
        mine = lesions.objects.tissue == tissue
        facts[tissue.name.lower()] = {
            "before": total,
            "after": int(number.max(initial=-1)) + 1,
            "placed": int(lesions.placed[mine].sum()),
            "merged": int(lesions.merged[mine].sum()),
            "lost": int(lesions.lost[mine].sum()),
        }
    return facts


def _by_name(ml: NDArray[np.floating]) -> dict[str, float]:
    """Volume of every tissue that is there, ml."""
    return {t.name.lower(): float(ml[t]) for t in Tissue if t and ml[t]}
