"""The anthropomorphic phantom: outline, skin, compartments, ligaments, fibroglandular region.

After Zhang, Bakic et al. (the phantom of the reference paper, section 2): quarters of two ellipsoids under a skin,
adipose compartments with Cooper's ligaments between them around a central fibroglandular region that encloses small
adipose compartments, all grown from oriented seeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.advice import one_of, where
from simcore.core.artifacts import Phantom, Report
from simcore.core.errors import PhantomError
from simcore.core.grid import Grid
from simcore.core.progress import Progress, silent
from simcore.core.rng import stream
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.kernels import njit, prange
from simcore.phantom import glandularity
from simcore.phantom.ducts import carve, grow_ducts
from simcore.phantom.glandularity import Compartment, Compartments
from simcore.phantom.outline import Outline, outline
from simcore.phantom.placement import PlacedLesion, place_lesions, stamp, truth
from simcore.phantom.raster import COLUMN, label_voxels
from simcore.phantom.seeds import Layers, layers, plant
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.phantom.texture import Texture, texture

GLANDULARITY_TOLERANCE = 0.02
"""Largest difference between the glandularity asked for and the one counted in voxels."""
LARGEST_LIGAMENT = 0.4
"""Largest ligament thickness over the diameter of the average compartment."""


@dataclass(frozen=True, eq=False)
class Breast:
    """All that is settled before the first voxel is labelled."""

    spec: AnthropomorphicPhantom
    shape: Outline
    border: Layers
    compartments: Compartments
    texture: Texture
    ducts: NDArray[np.float32]
    lesions: tuple[PlacedLesion, ...]

    def fill(self, labels: NDArray[np.uint8], first_slice: int = 0) -> Census:
        """Labels a slab (n, ny, nx) of the grid, all air, that begins at ``first_slice``, a multiple of COLUMN."""
        shape, cells = self.shape, self.compartments
        part = slice(first_slice, first_slice + len(labels))
        step = self.spec.voxel_mm
        _, corner_y, corner_z = shape.grid.corner
        label_voxels(
            cells.table, cells.gland_seeds, self.spec.compartments.ligament_mm, self.texture, shape.tissue_rows[part],
            shape.breast_rows[part], shape.cover[part], step, corner_y, corner_z, first_slice, labels,
        )  # fmt: skip
        tissues = count_tissues(labels, shape.tissue_rows[part], shape.breast_rows[part], shape.cover[part])
        to_duct = carve(self.ducts, step, corner_y, corner_z, first_slice, labels)
        tissues -= to_duct
        tissues[Tissue.DUCT] += to_duct.sum()
        gland = int(tissues[Tissue.GLAND] + tissues[Tissue.DUCT])
        grid = slab_grid(shape.grid, first_slice, len(labels))
        return Census(gland, stamp(self.lesions, grid, labels, tissues), tissues)


@dataclass(frozen=True, eq=False)
class Census:
    """What stands in the voxels of a slab.

    gland:   voxels of gland and ducts before lesions took their place.
    lesions: voxels of every body of every lesion.
    tissues: int64 (MAX_TISSUES,), without air.
    """

    gland: int
    lesions: list[list[int]]
    tissues: NDArray[np.int64]


def generate(spec: AnthropomorphicPhantom, seed: int, progress: Progress = silent) -> Phantom:
    """Grows the phantom of ``spec``; the same bytes for any number of threads.

    seed: of the random streams, any non-negative integer.
    raises: PhantomError where volume, glandularity or compartments cannot be had as asked.
    """
    breast = settle(spec, seed, progress)
    progress(0.3, "voxels")
    grid = breast.shape.grid
    labels = np.zeros(grid.shape, dtype=np.uint8)
    census = breast.fill(labels)
    progress(0.95, "counting")
    report = _report(breast, census)
    known = truth(breast.lesions, census.lesions, grid.voxel_volume)
    progress(1.0, "phantom ready")
    return Phantom(labels, grid, tuple(known), report)


def slabs(
    spec: AnthropomorphicPhantom, seed: int, slices: int = 4 * COLUMN
) -> Iterator[tuple[Grid, NDArray[np.uint8]]]:
    """The phantom of ``generate`` slab by slab from the lowest z, byte for byte, without ever holding the whole.

    slices: of a slab, a multiple of COLUMN; the last has what is left. Each array is a new one.
    """
    if slices < 1 or slices % COLUMN:
        raise ValueError(f"slices = {slices}: a multiple of {COLUMN}")
    breast = settle(spec, seed)
    grid = breast.shape.grid
    for first in range(0, grid.shape[0], slices):
        part = slab_grid(grid, first, min(slices, grid.shape[0] - first))
        labels = np.zeros(part.shape, dtype=np.uint8)
        breast.fill(labels, first)
        yield part, labels


def slab_grid(grid: Grid, first: int, slices: int) -> Grid:
    """The slices of ``grid`` from ``first`` on."""
    _, ny, nx = grid.shape
    return Grid((slices, ny, nx), grid.spacing, grid.corner).moved(z=first * grid.spacing[2])


def settle(spec: AnthropomorphicPhantom, seed: int, progress: Progress = silent) -> Breast:
    """Everything but the voxels. raises: PhantomError, as ``generate``"""
    progress(0.0, "outline")
    _check_ligaments(spec)
    shape = outline(spec)
    progress(0.1, "compartments")
    border = layers(spec, shape.axes, glandularity.layer_scale(spec, shape))
    enclosed = glandularity.enclosed_share(spec, shape, border)
    seeds = plant(spec, shape.axes, border, enclosed, stream(seed, "phantom", "compartments"))
    modulation = texture(spec.texture, shape.axes, stream(seed, "phantom", "texture"))
    compartments = glandularity.settle(spec, shape, modulation, seeds)
    ducts = grow_ducts(spec, shape, compartments, modulation, stream(seed, "phantom", "ducts"))
    lesions = place_lesions(spec, shape, compartments, modulation, seed)
    return Breast(spec, shape, border, compartments, modulation, ducts, lesions)


def count_tissues(
    labels: NDArray[np.uint8], tissue_rows: NDArray[np.int32], breast_rows: NDArray[np.int32],
    cover: NDArray[np.uint8],
) -> NDArray[np.int64]:  # fmt: skip
    """Voxels (MAX_TISSUES,) of adipose, gland, ligament and cover; labels hold no others yet."""
    inside = np.zeros((labels.shape[0], MAX_TISSUES), dtype=np.int64)
    _count(labels, tissue_rows, inside)
    counts: NDArray[np.int64] = inside.sum(axis=0)
    for tissue in (Tissue.SKIN, Tissue.NIPPLE):
        counts[tissue] = np.sum((breast_rows - tissue_rows) * (cover == tissue), dtype=np.int64)
    return counts


_ADIPOSE, _GLAND, _LIGAMENT = Tissue.ADIPOSE.value, Tissue.GLAND.value, Tissue.LIGAMENT.value


@njit(cache=True, parallel=True)  # type: ignore[misc]
def _count(labels: NDArray[np.uint8], rows: NDArray[np.int32], counts: NDArray[np.int64]) -> None:
    for k in prange(labels.shape[0]):
        for j in range(labels.shape[1]):
            gland, ligament = 0, 0
            for i in range(rows[k, j]):
                gland += labels[k, j, i] == _GLAND
                ligament += labels[k, j, i] == _LIGAMENT
            counts[k, _GLAND] += gland
            counts[k, _LIGAMENT] += ligament
            counts[k, _ADIPOSE] += rows[k, j] - gland - ligament


def _check_ligaments(spec: AnthropomorphicPhantom) -> None:
    """raises: PhantomError where the average compartment is little more than its ligaments."""
    thickness, count = spec.compartments.ligament_mm, spec.compartments.count
    diameter = math.cbrt(6 / math.pi * spec.volume_ml * 1e3 / count)
    if thickness > LARGEST_LIGAMENT * diameter:
        most = int(6 / math.pi * spec.volume_ml * 1e3 * (LARGEST_LIGAMENT / thickness) ** 3)
        raise PhantomError(
            f"compartments.ligament_mm = {thickness:g} mm is too thick for compartments.count = {count} in "
            f"{spec.volume_ml:g} ml, {diameter:.2f} mm each: take at most {LARGEST_LIGAMENT * diameter:.2f} mm"
            + (f" or at most {most} compartments" if most >= 20 else "")
        )


def _report(breast: Breast, census: Census) -> Report:
    spec, shape, compartments = breast.spec, breast.shape, breast.compartments
    met = census.gland / shape.tissue_voxels
    if abs(met - spec.glandularity) > GLANDULARITY_TOLERANCE:
        raise PhantomError(
            f"glandularity = {spec.glandularity:g} was met only as {met:.3f} with "
            f"{spec.compartments.count} compartments (allowed: {GLANDULARITY_TOLERANCE:g} off): "
            + "take "
            + one_of(
                "more compartments",
                where(spec.compartments.ligament_mm > 0, "thinner ligaments"),
                "smaller voxels",
                where(spec.ducts is not None, "fewer or thinner ducts"),
            )
        )
    voxel_ml = shape.grid.voxel_volume * 1e-3
    volumes = {
        kind.name.lower(): compartments.volume_ml[(compartments.kinds == kind) & (compartments.volume_ml > 0)]
        for kind in Compartment
    }
    return {
        "volume_ml": shape.breast_voxels * voxel_ml,
        "glandularity": met,
        "glandularity_definition": glandularity.DEFINITION,
        "tissue_ml": {t.name.lower(): float(census.tissues[t]) * voxel_ml for t in Tissue if census.tissues[t]},
        "compartments": {name: len(ml) for name, ml in volumes.items()},
        "compartment_volume_cm3": {name: _spread(ml) for name, ml in volumes.items() if len(ml)},
        "compartment_lattice_mm": compartments.lattice_mm,
        "voxels": shape.grid.size,
        "semi_axes_mm": list(shape.axes),
        "subcutaneous_fraction": breast.border.outer - breast.border.inner,
        "retromammary_mm": breast.border.retromammary,
    }


def _spread(volumes_ml: NDArray[np.float64]) -> dict[str, float]:
    low, median, high = np.percentile(volumes_ml, [5, 50, 95])
    return {"percentile_5": float(low), "median": float(median), "percentile_95": float(high)}
