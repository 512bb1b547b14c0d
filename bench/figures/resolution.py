"""Transfer of the chain: a slanted edge on the detector, small beads in a slice."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.figures.insertion import attenuation, slab
from simcore import projection
from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, PhysicsSpec
from simcore.quality.mtf import frequency_at, line_spread_mtf, peak_normalised, slanted_edge_mtf
from simcore.reconstruction.spec import FilteredBackprojection

VOXEL = 0.1
BEAD = 0.1
"""Edge of the cubic beads, mm."""
HEIGHT = 48.0
"""Of the beads above the breast support, mm: mid height of the cup C at 20 %."""
REACH = 6.0
"""Half length of the profiles, mm."""
FREQUENCIES = np.arange(0.0, 5.5, 0.05)
"""1/mm, up to the Nyquist frequency of the pixels' rays in the slice; the beads' first zero is at 10."""


def detector_edge() -> dict[str, Any]:
    """Modulation of a slanted edge of 0.1 mm voxels in one projection at 1, 2 and 4 per mm, and what a square voxel
    lets pass: |sinc| of its shadow. Rays end at pixel centres, so the pixels themselves do not blur."""
    grid = Grid((5, 400, 400), (VOXEL, VOXEL, VOXEL), (0.0, -20.0, 0.0))
    x, y = grid.centres("x"), grid.centres("y")
    beyond = x >= 20.0 + np.tan(np.deg2rad(3.0)) * y[:, None]
    labels = np.broadcast_to(np.where(beyond, Tissue.CALCIFICATION, Tissue.AIR).astype(np.uint8), grid.shape)
    detector = DetectorSpec(pixels_y=400, pixels_x=400)
    acquisition = AcquisitionSpec(views=1, angular_range_degrees=0.0, detector=detector, truncation="allow")
    stack = projection.project(Phantom(labels.copy(), grid), acquisition, PhysicsSpec())
    integrals = np.log(stack.open_field / stack.data[0, 50:350, 130:290])
    frequency, mtf = slanted_edge_mtf(integrals, detector.pixel_mm)
    source = float(stack.geometry.sources[0, 2])
    voxel = VOXEL * source / (source - acquisition.air_gap_mm)
    return {
        f"{f:g}_per_mm": {
            "measured": round(float(np.interp(f, frequency, mtf)), 3),
            "voxel": round(np.sinc(f * voxel), 3),
        }
        for f in (1.0, 2.0, 4.0)
    }


def slice_beads(acquisition: AcquisitionSpec) -> dict[str, float | None]:
    """Frequencies, 1/mm, where the modulation in the beads' slice falls to a half: along y of the spread integrated
    over x, over its maximum (a limited angle has no value at 0); along x of the profile through the bead. Both are
    divided by the transform of the bead and averaged over beads at several positions between the pixels.
    None: beyond FREQUENCIES."""
    across = np.arange(6.0, 60.0, 7.3)
    grid = Grid((4, 100, 700), (VOXEL, VOXEL, VOXEL), (0.0, -5.0, HEIGHT))
    labels = np.zeros(grid.shape, np.uint8)
    centres: list[tuple[float, float]] = []
    for x in across:
        i, j = round(x / VOXEL), 40 + len(centres)
        labels[1, j, i] = Tissue.CALCIFICATION
        centres.append(((i + 0.5) * VOXEL, grid.corner[1] + (j + 0.5) * VOXEL))
    small = acquisition.with_(detector=DetectorSpec(pixels_y=1000, pixels_x=800), truncation="allow")
    stack = projection.project(Phantom(labels, grid), small, PhysicsSpec())
    z = HEIGHT + 1.5 * VOXEL + acquisition.air_gap_mm
    volume = slab(stack, FilteredBackprojection(pixel_mm=0.05, value_intercept=-0.3), z - 0.5, z + 0.5)
    values, step = attenuation(volume)[0], volume.grid.spacing[0]
    along_x, along_y = [], []
    for x, y in centres:
        rows = np.abs(volume.grid.centres("y") - y) <= REACH
        columns = np.abs(volume.grid.centres("x") - x) <= 3.0
        cut = values[np.ix_(rows, columns)]
        peak = int(np.argmax(cut.max(axis=1)))
        along_y.append(_on_common(*peak_normalised(cut.sum(axis=1), step)))
        along_x.append(_on_common(*line_spread_mtf(cut[peak], step)))
    y_mean = np.mean(along_y, axis=0)
    halves = {
        "half_along_y_per_mm": frequency_at(FREQUENCIES, y_mean / y_mean.max()),
        "half_along_x_per_mm": frequency_at(FREQUENCIES, np.mean(along_x, axis=0)),
    }
    return {name: round(half, 2) if np.isfinite(half) else None for name, half in halves.items()}


def _on_common(frequency: NDArray[np.float64], modulation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Modulation at FREQUENCIES, divided by the transform of the bead."""
    return np.asarray(np.interp(FREQUENCIES, frequency, modulation) / np.sinc(FREQUENCIES * BEAD))
