"""The anthropomorphic phantom: outline, skin, compartments, ligaments, fibroglandular region.

After the software phantom of Bakic and Zhang, with the region growing of compartments computed as in cells.py.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom, Report
from simcore.core.errors import PhantomError
from simcore.core.progress import Progress, silent
from simcore.core.rng import stream
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.phantom.cells import START, Float32, label_voxels, seed_table
from simcore.phantom.outline import Outline, outline
from simcore.phantom.seeds import Layers, Region, Seeds, layers, plant
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.phantom.survey import Survey, survey

GLANDULARITY_TOLERANCE = 0.02
GLANDULARITY_DEFINITION = "gland voxels / (all voxels but air and skin); ligaments count as tissue, not as gland"

_FILLING = 0.78
"""Share of gland in the interior from which on the adipose layers are made thinner."""


class Compartment(IntEnum):
    """What a seed has become."""

    SUBCUTANEOUS = 0
    RETROMAMMARY = 1
    INTERIOR = 2
    ENCLOSED = 3
    GLANDULAR = 4


def generate(spec: AnthropomorphicPhantom, seed: int, progress: Progress = silent) -> Phantom:
    """Grows the phantom of ``spec``; the same bytes for any number of threads.

    seed: of the random streams, any non-negative integer.
    raises: PhantomError where volume, glandularity or compartments cannot be had as asked.
    """
    progress(0.0, "outline")
    shape = outline(spec)
    _check_compartments(spec)
    progress(0.05, "compartments")
    scale = _layer_scale(spec, shape)
    border = layers(spec, shape.axes, scale)
    seeds = plant(spec, shape.axes, border, stream(seed, "phantom", "compartments"))
    kinds, table, gland_seeds, territory = _settle(spec, shape, seeds)
    progress(0.2, "voxels")
    labels = np.zeros(shape.grid.shape, dtype=np.uint8)
    ligament = spec.compartments.ligament_mm
    _, corner_y, corner_z = shape.grid.corner
    label_voxels(
        table, gland_seeds, ligament, shape.tissue_rows, shape.breast_rows, spec.voxel_mm, corner_y, corner_z, labels
    )
    progress(0.95, "counting")
    report = _report(spec, shape, labels, kinds, territory, border, scale)
    progress(1.0, "phantom ready")
    return Phantom(labels, shape.grid, (), report)


def _check_compartments(spec: AnthropomorphicPhantom) -> None:
    mean_mm3 = spec.volume_ml * 1e3 / spec.compartments.count
    diameter = 2 * math.cbrt(3 * mean_mm3 / (4 * math.pi)) if hasattr(math, "cbrt") else 0.0
    if spec.compartments.ligament_mm > 0.4 * diameter:
        most = int(spec.volume_ml * 1e3 / (math.pi / 6 * (spec.compartments.ligament_mm / 0.4) ** 3))
        raise PhantomError(
            f"compartments.ligament_mm = {spec.compartments.ligament_mm:g} mm leaves no room inside "
            f"{spec.compartments.count} compartments of {diameter:.2f} mm: take ligaments below {0.4 * diameter:.2f} mm "
            f"or at most {most} compartments"
        )


def _layer_scale(spec: AnthropomorphicPhantom, shape: Outline) -> float:
    """1, or less where the layers leave too little room for the gland that is asked for."""
    needed = spec.glandularity * shape.tissue_voxels * shape.grid.voxel_volume / _FILLING
    for scale in np.linspace(1.0, 0.1, 91):
        border = layers(spec, shape.axes, float(scale))
        fits = border.retromammary < 0.4 * shape.axes[0]
        if fits and border.volumes(shape.axes)[Region.INTERIOR] >= needed:
            return float(scale)
    return 0.1


def _settle(
    spec: AnthropomorphicPhantom, shape: Outline, seeds: Seeds
) -> tuple[NDArray[np.int64], Float32, int, NDArray[np.float64]]:
    """Which seeds become glandular, so that the glandularity is met.

    Seeds turn glandular in order, as many as come nearest to the volume; then all of them start earlier or later by
    one common delay that gives the volume at the lattice points.

    returns: (Compartment of every seed (n,), table with the glandular seeds first, their number, ml of every seed);
    all in the order of the table.
    """
    thickness = spec.compartments.ligament_mm
    order = np.lexsort((seeds.rank, seeds.small, seeds.region != Region.INTERIOR))
    first = survey(shape, seed_table(seeds.centres, seeds.metrics, np.zeros(len(seeds))), 0, thickness)
    gland_seeds = _count_glandular(first, order, spec.glandularity)

    glandular = np.zeros(len(seeds), dtype=bool)
    glandular[order[:gland_seeds]] = True
    largest_rank = seeds.rank[glandular].max(initial=-np.inf)
    kinds = seeds.region.copy()  # The first three kinds are the regions.
    kinds[seeds.small & (seeds.rank < largest_rank) & (seeds.region == Region.INTERIOR)] = Compartment.ENCLOSED
    kinds[glandular] = Compartment.GLANDULAR
    sort = np.argsort(~glandular, kind="stable")
    table = seed_table(seeds.centres[sort], seeds.metrics[sort], np.zeros(len(seeds)))
    last = _balance(spec, shape, table, gland_seeds)
    return kinds[sort], table, gland_seeds, np.bincount(last.first, minlength=len(seeds)) * last.point_ml


def _count_glandular(cells: Survey, order: NDArray[np.int64], glandularity: float) -> int:
    """How many seeds of ``order`` must be glandular.

    A point is gland as soon as its own seed and the one across the ligament are.
    """
    if glandularity == 0:
        return 0
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    turns = np.where(cells.rival >= 0, np.maximum(place[cells.first], place[cells.rival]), place[cells.first])
    share = np.cumsum(np.bincount(turns, minlength=len(order))) / len(turns)
    return 1 + int(np.argmin(np.abs(share - glandularity)))


def _balance(spec: AnthropomorphicPhantom, shape: Outline, table: Float32, gland_seeds: int) -> Survey:
    """Sets the common start of the glandular seeds in ``table``; returns the last survey."""
    slack, thickness = 0.3, spec.compartments.ligament_mm
    for _ in range(10):
        cells = survey(shape, table, gland_seeds, thickness, slack)
        wanted = round(spec.glandularity * len(cells.margin))
        have = int(np.count_nonzero(cells.margin > 0))
        if gland_seeds == 0 or abs(have - wanted) <= 1e-3 * len(cells.margin):
            break
        threshold = float(np.partition(cells.margin, len(cells.margin) - wanted)[len(cells.margin) - wanted])
        table[START, :gland_seeds] += np.float32(np.clip(threshold, -slack, slack))
    return cells


def _report(
    spec: AnthropomorphicPhantom, shape: Outline, labels: NDArray[np.uint8], kinds: NDArray[np.int64],
    territory: NDArray[np.float64], border: Layers, scale: float,
) -> Report:  # fmt: skip
    counts = count_labels(labels, shape.breast_rows)
    voxel_ml = shape.grid.voxel_volume * 1e-3
    glandularity = float(counts[Tissue.GLAND]) / shape.tissue_voxels
    if abs(glandularity - spec.glandularity) > GLANDULARITY_TOLERANCE:
        raise PhantomError(
            f"glandularity = {spec.glandularity:g} was met only as {glandularity:.3f} with "
            f"{spec.compartments.count} compartments (allowed: 0.02 off): take more compartments or smaller voxels"
        )
    held = {kind.name.lower(): territory[(kinds == kind) & (territory > 0)] for kind in Compartment}
    return {
        "volume_ml": shape.breast_voxels * voxel_ml,
        "glandularity": glandularity,
        "glandularity_definition": GLANDULARITY_DEFINITION,
        "tissue_ml": {t.name.lower(): float(counts[t]) * voxel_ml for t in Tissue if t and counts[t]},
        "compartments": {name: len(ml) for name, ml in held.items()},
        "compartment_volume_cm3": {
            name: dict(zip(("p05", "median", "p95"), np.percentile(ml, [5, 50, 95]).tolist(), strict=True))
            for name, ml in held.items()
            if len(ml)
        },
        "voxels": shape.grid.size,
        "semi_axes_mm": list(shape.axes),
        "skin_mm": spec.skin_mm,
        "layer_scale": scale,
        "retromammary_mm": border.retromammary,
    }


def count_labels(labels: NDArray[np.uint8], breast_rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """Voxels of each tissue inside the breast, (MAX_TISSUES,)."""
    counts = np.zeros((labels.shape[0], MAX_TISSUES), dtype=np.int64)
    _count(labels, breast_rows, counts)
    return counts.sum(axis=0)


@njit(cache=True, parallel=True)  # type: ignore[misc]
def _count(labels: NDArray[np.uint8], rows: NDArray[np.int32], counts: NDArray[np.int64]) -> None:
    for k in prange(labels.shape[0]):
        for j in range(labels.shape[1]):
            gland, ligament, skin = 0, 0, 0
            for i in range(rows[k, j]):
                gland += labels[k, j, i] == 2
                ligament += labels[k, j, i] == 4
                skin += labels[k, j, i] == 3
            counts[k, 2] += gland
            counts[k, 3] += skin
            counts[k, 4] += ligament
            counts[k, 1] += rows[k, j] - gland - ligament - skin
