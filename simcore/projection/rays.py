"""Line integrals one ray at a time: any pose of the detector, and the reference for the faster plane-prefix method.

exact:     J. Amanatides, A. Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987; the lengths
           are those of R. L. Siddon, Med. Phys. 12 (1985) 252-255.
trilinear: samples at equidistant radii from the source, trilinear interpolation of the attenuation coefficient.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.kernels import njit, prange
from simcore.projection.schedule import spread

Vector = tuple[float, float, float]
FAR = 1e300


def project_rays(
    labels: NDArray[np.uint8],
    grid: Grid,
    geometry: AcquisitionGeometry,
    view: int,
    mu: NDArray[np.float64],
    *,
    step_mm: float = 0.0,
    out: NDArray[np.float32] | NDArray[np.float64],
) -> None:
    """Line integrals of one view, in double precision until they are stored.

    labels: uint8 (nz, ny, nx) on ``grid``, detector frame.
    mu: (MAX_TISSUES,), 1/mm.
    step_mm: distance of the trilinear samples; 0 for exact intersection lengths.
    out: (detector.ny, detector.nx), overwritten; dimensionless.
    """
    box = _occupied(labels, grid, mu, margin=0 if step_mm == 0.0 else 1)
    if box is None:
        out[:] = 0.0
        return
    origin = geometry.pixel_position(view, 0, 0)
    row_step = geometry.detector_frame(view)[1] * geometry.detector.pixel
    column_step = geometry.column_direction(view) * geometry.detector.pixel
    source = geometry.sources[view]
    _project(
        labels, mu, np.array(grid.corner), np.array(grid.spacing), box, source, origin, row_step,
        column_step, step_mm, spread(geometry.detector.ny), out,
    )  # fmt: skip


def _occupied(
    labels: NDArray[np.uint8], grid: Grid, mu: NDArray[np.float64], margin: int
) -> NDArray[np.float64] | None:
    """(2, 3) lower and upper corner, mm, of the voxels with mu > 0 and ``margin`` more voxels, within the grid."""
    first, last = _occupied_indices(labels, mu)
    if last[0] < 0:
        return None
    size = np.array(grid.shape[::-1])
    low = np.maximum(first - margin, 0)
    high = np.minimum(last + 1 + margin, size)
    spacing = np.array(grid.spacing)
    box: NDArray[np.float64] = np.stack([low * spacing, high * spacing]) + np.array(grid.corner)
    return box


@njit(cache=True)
def _occupied_indices(
    labels: NDArray[np.uint8], mu: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last index (x, y, z) of the voxels with mu > 0; last = -1 where there are none."""
    nz, ny, nx = labels.shape
    first = np.array([nx, ny, nz])
    last = np.array([-1, -1, -1])
    for k in range(nz):
        for j in range(ny):
            row = labels[k, j]
            start = 0
            while start < nx and mu[row[start]] == 0.0:
                start += 1
            if start == nx:
                continue
            end = nx - 1
            while mu[row[end]] == 0.0:
                end -= 1
            first[0], last[0] = min(first[0], start), max(last[0], end)
            first[1], last[1] = min(first[1], j), max(last[1], j)
            first[2], last[2] = min(first[2], k), max(last[2], k)
    return first, last


@njit(parallel=True, cache=True)
def _project(
    labels: NDArray[np.uint8],
    mu: NDArray[np.float64],
    corner: NDArray[np.float64],
    spacing: NDArray[np.float64],
    box: NDArray[np.float64],
    source: NDArray[np.float64],
    origin: NDArray[np.float64],
    row_step: NDArray[np.float64],
    column_step: NDArray[np.float64],
    step_mm: float,
    order: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    for task in prange(len(order)):
        row = order[task]
        start = (source[0], source[1], source[2])
        low = (corner[0], corner[1], corner[2])
        edge = (spacing[0], spacing[1], spacing[2])
        box_low = (box[0, 0], box[0, 1], box[0, 2])
        box_high = (box[1, 0], box[1, 1], box[1, 2])
        for column in range(out.shape[1]):
            direction = (
                origin[0] + column * column_step[0] + row * row_step[0] - source[0],
                origin[1] + column * column_step[1] + row * row_step[1] - source[1],
                origin[2] + column * column_step[2] + row * row_step[2] - source[2],
            )
            enter, leave = _clip(start, direction, box_low, box_high)
            if leave <= enter:
                out[row, column] = 0.0
            elif step_mm > 0.0:
                out[row, column] = _trilinear(labels, mu, low, edge, start, direction, enter, leave, step_mm)
            else:
                out[row, column] = _siddon(labels, mu, low, edge, start, direction, enter, leave)


@njit(cache=True)
def _clip(source: Vector, direction: Vector, low: Vector, high: Vector) -> tuple[float, float]:
    """Parameters t in [0, 1] at which source + t direction enters and leaves the box; enter >= leave: a miss."""
    enter = 0.0
    leave = 1.0
    for axis in range(3):
        if direction[axis] == 0.0:
            if source[axis] < low[axis] or source[axis] >= high[axis]:
                return 1.0, 0.0
        else:
            first = (low[axis] - source[axis]) / direction[axis]
            second = (high[axis] - source[axis]) / direction[axis]
            enter = max(enter, min(first, second))
            leave = min(leave, max(first, second))
    return enter, leave


@njit(cache=True)
def _first_cell(position: float, direction: float, low: float, edge: float, size: int) -> tuple[int, int, int]:
    """(cell that holds the position, next plane, step) along one axis; on a plane: the cell that the ray runs into."""
    cells = (position - low) / edge
    index = math.floor(cells)
    if direction < 0.0 and index == cells:
        index -= 1
    index = min(max(index, 0), size - 1)
    if direction > 0.0:
        return index, index + 1, 1
    if direction < 0.0:
        return index, index, -1
    return index, index, 0


@njit(cache=True)
def _plane(plane: int, step: int, source: float, direction: float, low: float, edge: float) -> float:
    """t of a plane. From its index, not by adding steps, so that no error builds up along the ray."""
    if step == 0:
        return FAR
    return (low + plane * edge - source) / direction


@njit(cache=True)
def _siddon(
    labels: NDArray[np.uint8],
    mu: NDArray[np.float64],
    low: Vector,
    edge: Vector,
    source: Vector,
    direction: Vector,
    enter: float,
    leave: float,
) -> float:
    """Sum of mu times intersection length over t in [enter, leave]."""
    nz, ny, nx = labels.shape
    dx, dy, dz = direction
    i, plane_x, step_x = _first_cell(source[0] + enter * dx, dx, low[0], edge[0], nx)
    j, plane_y, step_y = _first_cell(source[1] + enter * dy, dy, low[1], edge[1], ny)
    k, plane_z, step_z = _first_cell(source[2] + enter * dz, dz, low[2], edge[2], nz)
    next_x = _plane(plane_x, step_x, source[0], dx, low[0], edge[0])
    next_y = _plane(plane_y, step_y, source[1], dy, low[1], edge[1])
    next_z = _plane(plane_z, step_z, source[2], dz, low[2], edge[2])
    t = enter
    total = 0.0
    while t < leave:
        upto = max(t, min(min(next_x, next_y), min(next_z, leave)))
        total += mu[labels[k, j, i]] * (upto - t)
        t = upto
        if next_x <= t:
            i += step_x
            plane_x += step_x
            next_x = _plane(plane_x, step_x, source[0], dx, low[0], edge[0])
        if next_y <= t:
            j += step_y
            plane_y += step_y
            next_y = _plane(plane_y, step_y, source[1], dy, low[1], edge[1])
        if next_z <= t:
            k += step_z
            plane_z += step_z
            next_z = _plane(plane_z, step_z, source[2], dz, low[2], edge[2])
        if i < 0 or i >= nx or j < 0 or j >= ny or k < 0 or k >= nz:
            break
    return total * math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True)
def _trilinear(
    labels: NDArray[np.uint8],
    mu: NDArray[np.float64],
    low: Vector,
    edge: Vector,
    source: Vector,
    direction: Vector,
    enter: float,
    leave: float,
    step_mm: float,
) -> float:
    """Sum of mu times step over the radii (m + 1/2) step within [enter, leave].

    Voxels at the border of the volume go on outwards, so that the chest wall does not fade."""
    nz, ny, nx = labels.shape
    dx, dy, dz = direction
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    # Positions in voxel units at radius 0, and their change from sample to sample; voxel centres are integers.
    x, step_x = (source[0] - low[0]) / edge[0] - 0.5, dx / length * step_mm / edge[0]
    y, step_y = (source[1] - low[1]) / edge[1] - 0.5, dy / length * step_mm / edge[1]
    z, step_z = (source[2] - low[2]) / edge[2] - 0.5, dz / length * step_mm / edge[2]
    total = 0.0
    for m in range(math.ceil(enter * length / step_mm - 0.5), math.ceil(leave * length / step_mm - 0.5)):
        i0, i1, a = _neighbours(x + (m + 0.5) * step_x, nx)
        j0, j1, b = _neighbours(y + (m + 0.5) * step_y, ny)
        k0, k1, c = _neighbours(z + (m + 0.5) * step_z, nz)
        l000, l001 = labels[k0, j0, i0], labels[k0, j0, i1]
        l010, l011 = labels[k0, j1, i0], labels[k0, j1, i1]
        l100, l101 = labels[k1, j0, i0], labels[k1, j0, i1]
        l110, l111 = labels[k1, j1, i0], labels[k1, j1, i1]
        # Most samples lie within one tissue.
        differ = (l000 ^ l001) | (l000 ^ l010) | (l000 ^ l011) | (l000 ^ l100)
        if (differ | (l000 ^ l101) | (l000 ^ l110) | (l000 ^ l111)) == 0:
            total += mu[l000]
            continue
        lower = (1.0 - b) * ((1.0 - a) * mu[l000] + a * mu[l001]) + b * ((1.0 - a) * mu[l010] + a * mu[l011])
        upper = (1.0 - b) * ((1.0 - a) * mu[l100] + a * mu[l101]) + b * ((1.0 - a) * mu[l110] + a * mu[l111])
        total += (1.0 - c) * lower + c * upper
    return total * step_mm


@njit(cache=True)
def _neighbours(cells: float, size: int) -> tuple[np.uint64, np.uint64, float]:
    """The two voxel centres around a position >= -0.5 in voxel units, and the weight of the second."""
    index = int(cells + 1.0) - 1
    # Unsigned: an index that cannot be negative needs no check for counting from the end.
    return np.uint64(max(index, 0)), np.uint64(min(index + 1, size - 1)), cells - index
