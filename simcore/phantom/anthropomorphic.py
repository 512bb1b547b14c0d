"""The anthropomorphic phantom: outline, skin, compartments, ligaments, fibroglandular region.

After Zhang, Bakic et al. (the phantom of the reference paper, section 2): quarters of two ellipsoids under a skin,
adipose compartments with Cooper's ligaments between them around a central fibroglandular region that encloses small
adipose compartments, all grown from oriented seeds.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, Report
from simcore.core.errors import PhantomError
from simcore.core.progress import Progress, silent
from simcore.core.rng import stream
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.phantom import glandularity
from simcore.phantom.cells import label_voxels
from simcore.phantom.glandularity import Compartment, Compartments
from simcore.phantom.outline import Outline, outline
from simcore.phantom.seeds import Layers, layers, plant
from simcore.phantom.spec import AnthropomorphicPhantom

GLANDULARITY_TOLERANCE = 0.02
"""Largest difference between the glandularity asked for and the one counted in voxels."""
LARGEST_LIGAMENT = 0.4
"""Largest ligament thickness over the diameter of the average compartment."""


def generate(spec: AnthropomorphicPhantom, seed: int, progress: Progress = silent) -> Phantom:
    """Grows the phantom of ``spec``; the same bytes for any number of threads.

    seed: of the random streams, any non-negative integer.
    raises: PhantomError where volume, glandularity or compartments cannot be had as asked.
    """
    progress(0.0, "outline")
    _check_ligaments(spec)
    shape = outline(spec)
    progress(0.1, "compartments")
    border = layers(spec, shape.axes, glandularity.layer_scale(spec, shape))
    enclosed = glandularity.enclosed_share(spec, shape, border)
    seeds = plant(spec, shape.axes, border, enclosed, stream(seed, "phantom", "compartments"))
    compartments = glandularity.settle(spec, shape, seeds)
    progress(0.3, "voxels")
    labels = np.zeros(shape.grid.shape, dtype=np.uint8)
    _, corner_y, corner_z = shape.grid.corner
    label_voxels(
        compartments.table, compartments.gland_seeds, spec.compartments.ligament_mm, shape.tissue_rows,
        shape.breast_rows, spec.voxel_mm, corner_y, corner_z, labels,
    )  # fmt: skip
    progress(0.95, "counting")
    report = _report(spec, shape, border, compartments, count_tissues(labels, shape.breast_rows))
    progress(1.0, "phantom ready")
    return Phantom(labels, shape.grid, (), report)


def count_tissues(labels: NDArray[np.uint8], breast_rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """Voxels of each tissue (MAX_TISSUES,) in the first ``breast_rows`` (nz, ny) voxels of each row."""
    counts = np.zeros((labels.shape[0], MAX_TISSUES), dtype=np.int64)
    _count(labels, breast_rows, counts)
    result: NDArray[np.int64] = counts.sum(axis=0)
    return result


_ADIPOSE, _GLAND, _SKIN, _LIGAMENT = Tissue.ADIPOSE.value, Tissue.GLAND.value, Tissue.SKIN.value, Tissue.LIGAMENT.value


@njit(cache=True, parallel=True)  # type: ignore[misc]
def _count(labels: NDArray[np.uint8], rows: NDArray[np.int32], counts: NDArray[np.int64]) -> None:
    for k in prange(labels.shape[0]):
        for j in range(labels.shape[1]):
            gland, skin, ligament = 0, 0, 0
            for i in range(rows[k, j]):
                gland += labels[k, j, i] == _GLAND
                skin += labels[k, j, i] == _SKIN
                ligament += labels[k, j, i] == _LIGAMENT
            counts[k, _GLAND] += gland
            counts[k, _SKIN] += skin
            counts[k, _LIGAMENT] += ligament
            counts[k, _ADIPOSE] += rows[k, j] - gland - skin - ligament


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


def _report(
    spec: AnthropomorphicPhantom, shape: Outline, border: Layers, compartments: Compartments,
    counts: NDArray[np.int64],
) -> Report:  # fmt: skip
    met = float(counts[Tissue.GLAND]) / shape.tissue_voxels
    if abs(met - spec.glandularity) > GLANDULARITY_TOLERANCE:
        raise PhantomError(
            f"glandularity = {spec.glandularity:g} was met only as {met:.3f} with "
            f"{spec.compartments.count} compartments (allowed: {GLANDULARITY_TOLERANCE:g} off): "
            "take more compartments, thinner ligaments or smaller voxels"
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
        "tissue_ml": {t.name.lower(): float(counts[t]) * voxel_ml for t in Tissue if counts[t]},
        "compartments": {name: len(ml) for name, ml in volumes.items()},
        "compartment_volume_cm3": {name: _spread(ml) for name, ml in volumes.items() if len(ml)},
        "compartment_lattice_mm": compartments.lattice_mm,
        "voxels": shape.grid.size,
        "semi_axes_mm": list(shape.axes),
        "subcutaneous_fraction": border.outer - border.inner,
        "retromammary_mm": border.retromammary,
    }


def _spread(volumes_ml: NDArray[np.float64]) -> dict[str, float]:
    low, median, high = np.percentile(volumes_ml, [5, 50, 95])
    return {"percentile_5": float(low), "median": float(median), "percentile_95": float(high)}
