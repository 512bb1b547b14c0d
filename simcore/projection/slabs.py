"""Breast support and paddle: plates without edges, parallel to the slices.

A ray that falls by h over its length l passes a plate of thickness t on t l / h, wherever the plate lies. So one number
tells all about the plates of an acquisition: their line integral along the z axis, the sum of mu t.
"""

from __future__ import annotations

import csv
import math
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.kernels import njit, prange
from simcore.projection.spec import SlabSpec

FloatArray = NDArray[np.float32]


def material_table() -> dict[str, float]:
    """Linear attenuation coefficient at 20 keV of every material that plates are made of, 1/mm."""
    with resources.files("simcore.data").joinpath("plates-20keV.csv").open(encoding="utf-8") as lines:
        return {row["material"]: float(row["mu_per_mm"]) for row in csv.DictReader(lines)}


def upright_integral(slabs: list[SlabSpec]) -> float:
    """Line integral of all plates along z, dimensionless."""
    table = material_table()
    return math.fsum(
        slab.thickness_mm * (table[slab.material] if slab.attenuation_per_mm is None else slab.attenuation_per_mm)
        for slab in slabs
    )


def add_slabs(upright: float, geometry: AcquisitionGeometry, view: int, integrals: FloatArray) -> None:
    """Adds the line integrals of plates to those of a view, float32 (ny, nx), dimensionless.

    upright: of ``upright_integral``.
    """
    pixel = geometry.detector.pixel
    _add(
        upright,
        geometry.pixel_position(view, 0, 0) - geometry.sources[view],
        geometry.detector_frame(view)[1] * pixel,
        geometry.column_direction(view) * pixel,
        integrals,
    )


@njit(parallel=True, cache=True)
def _add(
    upright: float,
    first_ray: NDArray[np.float64],
    row_step: NDArray[np.float64],
    column_step: NDArray[np.float64],
    integrals: FloatArray,
) -> None:
    ny, nx = integrals.shape
    for j in prange(ny):
        for i in range(nx):
            x = first_ray[0] + j * row_step[0] + i * column_step[0]
            y = first_ray[1] + j * row_step[1] + i * column_step[1]
            z = first_ray[2] + j * row_step[2] + i * column_step[2]
            integrals[j, i] += upright * math.sqrt(x * x + y * y + z * z) / abs(z)
