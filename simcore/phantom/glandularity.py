"""Which compartments are glandular, so that the glandularity is met by construction."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simcore.phantom.cells import START, Float32, seed_table
from simcore.phantom.outline import Outline
from simcore.phantom.seeds import Layers, Region, Seeds, layers
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.phantom.survey import Survey, survey
from simcore.phantom.texture import Texture

DEFINITION = (
    "gland and duct voxels / (all voxels but air, skin and nipple); ligaments count as tissue, not as gland; "
    "as before lesions were put in"
)

_ENCLOSED = (0.08, 0.35)
"""Least and largest share of enclosed fat in the fibroglandular region."""
_LIGAMENT_SHARE = 0.08
"""Rough share of ligaments in the fibroglandular region; only the choice between the two limits above uses it."""
_SLACK = 0.3
"""How far the common start of the glandular compartments may move between two surveys (delay: the border of a
compartment of nominal size lies at 1)."""


class Compartment(IntEnum):
    """What a seed becomes. The first three are its Region where it stays adipose."""

    SUBCUTANEOUS = 0
    RETROMAMMARY = 1
    INTERIOR = 2
    ENCLOSED = 3
    GLANDULAR = 4


@dataclass(frozen=True)
class Compartments:
    """Seeds with their tissue settled, glandular ones first.

    table:       float32 (ROWS, n), for the kernels of cells.py.
    gland_seeds: number of glandular seeds.
    kinds:       (n,) Compartment.
    volume_ml:   (n,) volume up to the middle of the ligaments, from a survey.
    lattice_mm:  spacing of that survey.
    """

    table: Float32
    gland_seeds: int
    kinds: NDArray[np.int64]
    volume_ml: NDArray[np.float64]
    lattice_mm: float


def layer_scale(spec: AnthropomorphicPhantom, shape: Outline) -> float:
    """Factor on the thickness of both adipose layers: 1, or less where they leave the gland too little room."""
    # The denser the breast, the less fat its glandular region encloses.
    filling = float(np.clip(0.7 + 0.5 * (spec.glandularity - 0.3), 0.7, 0.87))
    needed = spec.glandularity * shape.tissue_voxels * shape.grid.voxel_volume / filling
    for scale in np.linspace(1.0, 0.1, 91):
        border = layers(spec, shape.axes, float(scale))
        fits = border.retromammary < 0.4 * shape.axes[0]
        if fits and border.volumes(shape.axes)[Region.INTERIOR] >= needed:
            return float(scale)
    return 0.1


def enclosed_share(spec: AnthropomorphicPhantom, shape: Outline, border: Layers) -> float:
    """Share of enclosed fat with which the fibroglandular region fills the interior, within limits."""
    gland = spec.glandularity * shape.tissue_voxels * shape.grid.voxel_volume
    interior = border.volumes(shape.axes)[Region.INTERIOR]
    return float(np.clip(1.0 - gland / interior - _LIGAMENT_SHARE, *_ENCLOSED))


def settle(spec: AnthropomorphicPhantom, shape: Outline, texture: Texture, seeds: Seeds) -> Compartments:
    """Makes the seeds glandular that come first, as many as come nearest to the volume of gland; then lets all of
    them start earlier or later by one common delay that meets it at the lattice points.

    Large interior seeds come first, in the order of their rank; small ones and the layers follow only where those
    are not enough.
    """
    thickness = spec.compartments.ligament_mm
    order = np.lexsort((seeds.rank, seeds.small, seeds.region != Region.INTERIOR))
    cells = survey(shape, texture, seed_table(seeds.centres, seeds.metrics), 0, thickness)
    gland_seeds = _count_glandular(cells, order, spec.glandularity)

    glandular = np.zeros(len(seeds), dtype=bool)
    glandular[order[:gland_seeds]] = True
    inside = seeds.rank < seeds.rank[glandular].max(initial=-np.inf)
    kinds = seeds.region.copy()
    kinds[seeds.small & inside & (seeds.region == Region.INTERIOR)] = Compartment.ENCLOSED
    kinds[glandular] = Compartment.GLANDULAR

    sort = np.argsort(~glandular, kind="stable")
    table = seed_table(seeds.centres[sort], seeds.metrics[sort])
    cells = _balance(spec, shape, texture, table, gland_seeds)
    volume_ml = np.bincount(cells.first, minlength=len(seeds)).astype(np.float64) * cells.point_ml
    return Compartments(table, gland_seeds, kinds[sort], volume_ml, cells.stride * spec.voxel_mm)


def _count_glandular(cells: Survey, order: NDArray[np.int64], glandularity: float) -> int:
    """How many seeds of ``order`` must be glandular.

    A point is gland as soon as its own seed and the one across the ligament are.
    """
    if glandularity == 0:
        return 0
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    own = place[cells.first]
    turn = np.where(cells.rival >= 0, np.maximum(own, place[cells.rival]), own)
    share = np.cumsum(np.bincount(turn, minlength=len(order))) / len(turn)
    return 1 + int(np.argmin(np.abs(share - glandularity)))


def _balance(
    spec: AnthropomorphicPhantom, shape: Outline, texture: Texture, table: Float32, gland_seeds: int
) -> Survey:
    """Sets the common start of the glandular seeds in ``table``; returns the last survey.

    The volume of gland as a function of that start is the distribution of the margins, so one step is exact at the
    lattice points unless it exceeds the slack.
    """
    for _ in range(10):
        cells = survey(shape, texture, table, gland_seeds, spec.compartments.ligament_mm, _SLACK)
        points = len(cells.margin)
        goal = round(spec.glandularity * points)
        have = int(np.count_nonzero(cells.margin > 0))
        if gland_seeds == 0 or abs(have - goal) <= 1e-3 * points:
            break
        threshold = float(np.partition(cells.margin, points - goal)[points - goal])
        table[START, :gland_seeds] += np.float32(np.clip(threshold, -_SLACK, _SLACK))
    return cells
