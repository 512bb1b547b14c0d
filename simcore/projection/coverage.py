"""Whether the breast's shadow lies on the detector."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.kernels import njit


@dataclass(frozen=True)
class Shadow:
    """Bounds of the breast's shadow in one view, mm in detector coordinates: y along the rows' step from the middle of
    the detector, x from its chest-wall edge."""

    y_min: float
    y_max: float
    x_max: float


def shadows(ends: NDArray[np.int32], grid: Grid, geometry: AcquisitionGeometry) -> list[Shadow]:
    """The shadow of every view; empty where there is no tissue.

    ends: of ``Borders.row_ends``; grid: the phantom's, in the detector frame.
    """
    if not ends.any():
        return []
    # Corners of voxels are shared: what ends at a corner is the longest of the four rows around it.
    padded = np.pad(ends, 1)
    pairs = np.maximum(padded[1:], padded[:-1])
    corners = np.maximum(pairs[:, 1:], pairs[:, :-1])
    of_views = []
    for view in range(geometry.views):
        origin, row = geometry.detector_frame(view)
        pose = np.stack([geometry.sources[view], origin, row, geometry.column_direction(view), geometry.normal(view)])
        of_views.append(Shadow(*map(float, _shadow(corners, np.array(grid.corner), np.array(grid.spacing), pose))))
    return of_views


@njit(cache=True, error_model="numpy")
def _shadow(
    corners: NDArray[np.int32], corner: NDArray[np.float64], spacing: NDArray[np.float64], pose: NDArray[np.float64]
) -> tuple[float, float, float]:
    """corners: (nz + 1, ny + 1), x end of the tissue along each line of voxel corners. pose: source, origin, directions
    of rows and columns, normal, (5, 3)."""
    y_min, y_max, x_max = np.inf, -np.inf, -np.inf
    source, origin, row, column, normal = pose
    height = 0.0
    for axis in range(3):
        height += normal[axis] * (origin[axis] - source[axis])
    # Where columns run along x, y on the detector is the same for all of a line.
    near_ends = 0 if column[0] == 1.0 else 1
    for k in range(corners.shape[0]):
        z = corner[2] + k * spacing[2] - source[2]
        for j in range(corners.shape[1]):
            if corners[k, j] == 0:
                continue
            y = corner[1] + j * spacing[1] - source[1]
            for near in range(near_ends + 1):
                x = corner[0] + (1 - near) * corners[k, j] * spacing[0] - source[0]
                t = height / (normal[0] * x + normal[1] * y + normal[2] * z)
                along_x = source[0] + t * x - origin[0]
                along_y = source[1] + t * y - origin[1]
                along_z = source[2] + t * z - origin[2]
                on_row = row[0] * along_x + row[1] * along_y + row[2] * along_z
                on_column = column[0] * along_x + column[1] * along_y + column[2] * along_z
                y_min, y_max = min(y_min, on_row), max(y_max, on_row)
                x_max = max(x_max, on_column)
    return y_min, y_max, x_max


def beyond_y(of_views: list[Shadow], geometry: AcquisitionGeometry) -> bool:
    """Whether shadows reach beyond the detector along the tube travel."""
    return _y_reach(of_views) > geometry.detector.ny * geometry.detector.pixel / 2


def _y_reach(of_views: list[Shadow]) -> float:
    return max((max(-s.y_min, s.y_max) for s in of_views), default=0.0)


def truncation(of_views: list[Shadow], geometry: AcquisitionGeometry) -> str:
    """Where shadows reach beyond the detector, in words; empty where they do not."""
    detector = geometry.detector
    half, depth = detector.ny * detector.pixel / 2, detector.nx * detector.pixel
    y_reach = _y_reach(of_views)
    x_reach = max((s.x_max for s in of_views), default=0.0)
    words = []
    if beyond_y(of_views, geometry):
        words.append(
            f"along the tube travel to {y_reach:.1f} mm from the middle, the detector to {half:.1f} mm "
            f"(pixels_y {detector.ny} x pixel_mm {detector.pixel:g} / 2; "
            f"{2 * math.ceil(y_reach / detector.pixel)} pixels would do)"
        )
    if x_reach > depth:
        words.append(
            f"towards the nipple to {x_reach:.1f} mm from the chest wall, the detector to {depth:.1f} mm "
            f"(pixels_x {detector.nx} x pixel_mm {detector.pixel:g}; "
            f"{math.ceil(x_reach / detector.pixel)} pixels would do)"
        )
    return " and ".join(words)
