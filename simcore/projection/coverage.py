"""Which tissues and rows of voxels matter, and whether the breast's shadow lies on the detector."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid


@dataclass(frozen=True)
class Shadow:
    """Bounds of the breast's shadow in one view, mm in detector coordinates: y along the rows' step from the middle of
    the detector, x from its chest-wall edge."""

    y_min: float
    y_max: float
    x_max: float


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
        pose = np.stack([geometry.sources[view], origin, row, geometry.column_direction(view), geometry.normal(view)])
        found.append(Shadow(*map(float, _shadow(ends, np.array(grid.corner), np.array(grid.spacing), pose))))
    return found


@numba.njit(cache=True)
def _shadow(
    ends: NDArray[np.int32], corner: NDArray[np.float64], spacing: NDArray[np.float64], pose: NDArray[np.float64]
) -> tuple[float, float, float]:
    """pose: source, origin, directions of rows and columns, normal, (5, 3)."""
    y_min, y_max, x_max = np.inf, -np.inf, -np.inf
    source, origin, row, column, normal = pose
    height = 0.0
    for axis in range(3):
        height += normal[axis] * (origin[axis] - source[axis])
    # Where columns run along x, y on the detector is the same for all of a row of voxels.
    near_ends = 0 if column[0] == 1.0 else 1
    nz, ny = ends.shape
    for k in range(nz):
        for j in range(ny):
            if ends[k, j] == 0:
                continue
            for near in range(near_ends + 1):
                x = corner[0] + (1 - near) * ends[k, j] * spacing[0] - source[0]
                for upper_z in range(2):
                    z = corner[2] + (k + upper_z) * spacing[2] - source[2]
                    for upper_y in range(2):
                        y = corner[1] + (j + upper_y) * spacing[1] - source[1]
                        t = height / (normal[0] * x + normal[1] * y + normal[2] * z)
                        along_x = source[0] + t * x - origin[0]
                        along_y = source[1] + t * y - origin[1]
                        along_z = source[2] + t * z - origin[2]
                        on_row = row[0] * along_x + row[1] * along_y + row[2] * along_z
                        on_column = column[0] * along_x + column[1] * along_y + column[2] * along_z
                        y_min, y_max = min(y_min, on_row), max(y_max, on_row)
                        x_max = max(x_max, on_column)
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
