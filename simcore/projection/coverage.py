"""Whether a geometry can be served, and whether the breast's shadow lies on the detector."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid


@dataclass(frozen=True)
class Shadow:
    """Bounds of the breast's shadow in one view, mm in detector coordinates: y along the rows' step from the middle of
    the detector, x from its chest-wall edge."""

    y_min: float
    y_max: float
    x_max: float


def check_geometry(geometry: AcquisitionGeometry, grid: Grid) -> None:
    """The source must lie above the phantom and the detector below it, in every view.

    grid: the phantom's, in the detector frame.
    raises: GeometryError
    """
    top, bottom = grid.upper[2], grid.corner[2]
    half = geometry.detector.ny * geometry.detector.pixel / 2
    for view in range(geometry.views):
        source_z = float(geometry.sources[view, 2])
        if source_z <= top:
            raise GeometryError(
                f"view {view} at {geometry.angles[view]:g} degrees: the source stands {source_z:.1f} mm above the "
                f"detector, not above the top of the phantom at {top:.1f} mm; raise source_to_detector_mm "
                f"({geometry.source_to_detector:g}) or lower angular_range_degrees"
            )
        origin, row = geometry.detector_frame(view)
        highest = float(origin[2] + half * abs(row[2]))
        if highest > bottom + 1e-9:
            raise GeometryError(
                f"view {view}: the edge of the detector, turned by {geometry.detector_angles[view]:g} degrees, rises "
                f"to {highest:.2f} mm, above the bottom of the phantom at {bottom:.2f} mm; raise air_gap_mm "
                f"({geometry.support_height:g}) or lower detector_range_degrees"
            )


def present(labels: NDArray[np.uint8], mu: NDArray[np.float64]) -> NDArray[np.float64]:
    """The table of coefficients with 0 for tissues that no voxel has: kernels spend time on every one that is not 0."""
    bits = int(np.bitwise_or.reduce(_label_bits(labels)))
    return np.where((bits >> np.arange(len(mu))) & 1, mu, 0.0)


@numba.njit(parallel=True, cache=True)
def _label_bits(labels: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(nz,): bit n is set where a voxel of the slice has label n."""
    nz, ny, nx = labels.shape
    bits = np.zeros(nz, np.uint32)
    for k in numba.prange(nz):
        for j in range(ny):
            found = np.uint32(0)
            for i in range(nx):
                found |= np.uint32(1) << np.uint32(labels[k, j, i])
            bits[k] |= found
    return bits


def row_ends(labels: NDArray[np.uint8], mu: NDArray[np.float64]) -> NDArray[np.int32]:
    """(nz, ny): one more than the last x index with mu > 0 in every row of voxels, 0 where there is none."""
    ends: NDArray[np.int32] = _row_ends(labels, mu)
    return ends


@numba.njit(parallel=True, cache=True)
def _row_ends(labels: NDArray[np.uint8], mu: NDArray[np.float64]) -> NDArray[np.int32]:
    nz, ny, nx = labels.shape
    ends = np.zeros((nz, ny), np.int32)
    for k in numba.prange(nz):
        for j in range(ny):
            end = nx
            while end > 0 and mu[labels[k, j, end - 1]] == 0.0:
                end -= 1
            ends[k, j] = end
    return ends


def shadows(ends: NDArray[np.int32], grid: Grid, geometry: AcquisitionGeometry) -> list[Shadow]:
    """The shadow of every view; empty where there is no tissue.

    ends: of ``row_ends``; grid: the phantom's, in the detector frame.
    """
    if not ends.any():
        return []
    found = []
    for view in range(geometry.views):
        origin, row = geometry.detector_frame(view)
        bounds = _shadow(ends, np.array(grid.corner), np.array(grid.spacing), geometry.sources[view], origin, row)
        found.append(Shadow(*map(float, bounds)))
    return found


@numba.njit(cache=True)
def _shadow(
    ends: NDArray[np.int32],
    corner: NDArray[np.float64],
    spacing: NDArray[np.float64],
    source: NDArray[np.float64],
    origin: NDArray[np.float64],
    row: NDArray[np.float64],
) -> tuple[float, float, float]:
    y_min, y_max, x_max = np.inf, -np.inf, -np.inf
    # The normal of the detector is (1, 0, 0) x row.
    normal_y, normal_z = -row[2], row[1]
    height = normal_y * (origin[1] - source[1]) + normal_z * (origin[2] - source[2])
    nz, ny = ends.shape
    for k in range(nz):
        for j in range(ny):
            if ends[k, j] == 0:
                continue
            x = corner[0] + ends[k, j] * spacing[0] - source[0]
            for upper_z in range(2):
                z = corner[2] + (k + upper_z) * spacing[2] - source[2]
                for upper_y in range(2):
                    y = corner[1] + (j + upper_y) * spacing[1] - source[1]
                    t = height / (normal_y * y + normal_z * z)
                    along = row[1] * (source[1] + t * y - origin[1]) + row[2] * (source[2] + t * z - origin[2])
                    y_min, y_max = min(y_min, along), max(y_max, along)
                    x_max = max(x_max, source[0] + t * x)
    return y_min, y_max, x_max


def truncation(found: list[Shadow], geometry: AcquisitionGeometry) -> str:
    """Where shadows reach beyond the detector, in words; empty where they do not."""
    detector = geometry.detector
    half, depth = detector.ny * detector.pixel / 2, detector.nx * detector.pixel
    y_reach = max((max(-s.y_min, s.y_max) for s in found), default=0.0)
    x_reach = max((s.x_max for s in found), default=0.0)
    words = []
    if y_reach > half:
        words.append(
            f"along the tube travel to {y_reach:.1f} mm from the middle, the detector to {half:.1f} mm "
            f"(pixels_y {detector.ny} x pixel_mm {detector.pixel:g} / 2)"
        )
    if x_reach > depth:
        words.append(
            f"towards the nipple to {x_reach:.1f} mm from the chest wall, the detector to {depth:.1f} mm "
            f"(pixels_x {detector.nx} x pixel_mm {detector.pixel:g})"
        )
    return " and ".join(words)
