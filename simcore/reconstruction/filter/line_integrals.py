"""From detector signal to line integrals of attenuation, on the plane of the slices."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack, frozen
from simcore.core.geometry import AcquisitionGeometry
from simcore.kernels import njit
from simcore.reconstruction.filter.filters import chord_weights

FloatArray = NDArray[np.float32]


@cache
def attenuation_table(open_field: float) -> FloatArray:
    """Line integral of every 16-bit pixel value: -ln(max(value, 1) / open_field), float32 (65536,).

    The signal has 16 bits, so a table is exact and faster than a logarithm per pixel.
    """
    values = np.maximum(np.arange(65536, dtype=np.float64), 1.0)
    return np.asarray(frozen((-np.log(values / open_field)).astype(np.float32)))


def lit_columns(stack: ProjectionStack) -> int:
    """Number of detector columns from the chest wall on that hold all signal: every pixel beyond, in every view,
    has a line integral of exactly 0 and adds nothing to the volume."""
    table = attenuation_table(stack.open_field)
    if not np.any(table == 0.0):
        return stack.geometry.detector.nx
    return int(max(_last_attenuated_column(view, table) for view in stack.data)) + 1


@njit(cache=True, nogil=True)
def _last_attenuated_column(view: NDArray[np.uint16], table: FloatArray) -> int:
    """Index of the last column of uint16 (ny, nx) with a nonzero line integral; -1 where there is none."""
    last = -1
    for j in range(view.shape[0]):
        i = view.shape[1] - 1
        while i > last and table[view[j, i]] == 0.0:
            i -= 1
        last = max(last, i)
    return last


def line_integrals(stack: ProjectionStack, view: int, columns: slice) -> FloatArray:
    """Line integrals of the breast for some columns of a view on the plane z = 0, float32 (ny, columns).

    Where the detector is not at rest, each pixel of a virtual detector at rest is joined to the source, and the line
    integrals of the real one are interpolated bilinearly where that ray meets it; zero where it misses. Those of
    plates in the beam are subtracted.
    """
    table = attenuation_table(stack.open_field)
    geometry = stack.geometry
    if geometry.at_rest(view):
        values = np.asarray(_look_up(stack.data[view, :, columns], table))
    elif geometry.detector_poses is None:
        rows, scale = _rows_on_turned_detector(geometry, view)
        values = np.asarray(_resample_turned(stack.data[view], table, rows, scale, columns.start, columns.stop))
    else:
        row, column = _pixels_on_detector(geometry, view, columns)
        values = np.asarray(_resample(stack.data[view], table, row, column))
    if stack.slab_integral > 0:
        slabs = np.float32(stack.slab_integral) / chord_weights(geometry, view, columns, 1.0)
        values -= slabs if geometry.at_rest(view) else np.where(measured_pixels(geometry, view, columns), slabs, 0)
    return values


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(pixels: NDArray[np.uint16], table: FloatArray) -> FloatArray:
    """The table's entries for every pixel, (rows, columns)."""
    values = np.empty(pixels.shape, np.float32)
    for j in range(pixels.shape[0]):
        for i in range(pixels.shape[1]):
            values[j, i] = table[pixels[j, i]]
    return values


def measured_pixels(geometry: AcquisitionGeometry, view: int, columns: slice) -> NDArray[np.bool_]:
    """True for pixels of the plane z = 0 whose ray meets the detector of a view, (ny, columns)."""
    detector = geometry.detector
    if geometry.detector_poses is None:
        rows, scale = _rows_on_turned_detector(geometry, view)
        column = (np.arange(columns.start, columns.stop) + 0.5) * scale[:, None] - 0.5
        met = (rows >= -0.5) & (rows <= detector.ny - 0.5)
        return np.asarray(met[:, None] & (column <= detector.nx - 0.5))
    row, column = _pixels_on_detector(geometry, view, columns)
    on_row = (row >= -0.5) & (row <= detector.ny - 0.5)
    return np.asarray(on_row & (column >= -0.5) & (column <= detector.nx - 0.5))


def _pixels_on_detector(
    geometry: AcquisitionGeometry, view: int, columns: slice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the rays through some columns of the plane z = 0 meet the detector, whatever its pose: row and column
    (fractions), each float64 (ny, columns); nan where they do not."""
    detector = geometry.detector
    source = geometry.sources[view]
    origin, row_direction = geometry.detector_frame(view)
    normal = geometry.normal(view)
    x = detector.x_centres()[columns] - source[0]
    y = detector.y_centres()[:, None] - source[1]
    z = -source[2]
    towards = normal[0] * x + normal[1] * y + normal[2] * z
    scale = float(normal @ (origin - source)) / np.where(towards < 0, towards, np.nan)

    def along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
        met = scale * (direction[0] * x + direction[1] * y + direction[2] * z)
        return np.asarray((met + direction @ (source - origin)) / detector.pixel)

    return along(row_direction) + (detector.ny - 1) / 2, along(geometry.column_direction(view)) - 0.5


def _rows_on_turned_detector(
    geometry: AcquisitionGeometry, view: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the rays through the rows of the plane z = 0 meet the turned detector: the row (fraction), and x there
    relative to x on the plane z = 0; each float64 (ny,). Holds for every x, since the source has x = 0."""
    detector = geometry.detector
    _, source_y, source_z = geometry.sources[view]
    origin, row_direction = geometry.detector_frame(view)
    normal_y, normal_z = -row_direction[2], row_direction[1]
    ray_y, ray_z = detector.y_centres() - source_y, -source_z
    distance = normal_y * (origin[1] - source_y) + normal_z * (origin[2] - source_z)
    scale = distance / (normal_y * ray_y + normal_z * ray_z)
    along = (source_y + scale * ray_y - origin[1]) * row_direction[1] + (
        source_z + scale * ray_z - origin[2]
    ) * row_direction[2]
    return along / detector.pixel + (detector.ny - 1) / 2, scale


@njit(cache=True, nogil=True)
def _resample_turned(
    view: NDArray[np.uint16],
    table: FloatArray,
    rows: NDArray[np.float64],
    scale: NDArray[np.float64],
    first: int,
    stop: int,
) -> FloatArray:
    """Bilinear between pixel centres, constant over the outer half of edge pixels, zero beyond."""
    ny, nx = view.shape
    result = np.zeros((ny, stop - first), np.float32)
    for j in range(ny):
        if rows[j] < -0.5 or rows[j] > ny - 0.5:
            continue
        row = min(max(rows[j], 0.0), ny - 1.0)
        for i in range(stop - first):
            column = (first + i + 0.5) * scale[j] - 0.5
            if column > nx - 0.5:
                break
            result[j, i] = _bilinear(view, table, row, min(max(column, 0.0), nx - 1.0))
    return result


@njit(cache=True, nogil=True)
def _resample(
    view: NDArray[np.uint16], table: FloatArray, rows: NDArray[np.float64], columns: NDArray[np.float64]
) -> FloatArray:
    """As ``_resample_turned``, at any row and column."""
    ny, nx = view.shape
    result = np.zeros(rows.shape, np.float32)
    for j in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            row, column = rows[j, i], columns[j, i]
            if not (-0.5 <= row <= ny - 0.5 and -0.5 <= column <= nx - 0.5):
                continue
            result[j, i] = _bilinear(view, table, min(max(row, 0.0), ny - 1.0), min(max(column, 0.0), nx - 1.0))
    return result


@njit(cache=True, nogil=True)
def _bilinear(view: NDArray[np.uint16], table: FloatArray, row: float, column: float) -> float:
    ny, nx = view.shape
    lower, left = min(int(row), max(ny - 2, 0)), min(int(column), max(nx - 2, 0))
    upper, right = min(lower + 1, ny - 1), min(left + 1, nx - 1)
    up, along = row - lower, column - left
    below = (1.0 - along) * table[view[lower, left]] + along * table[view[lower, right]]
    above = (1.0 - along) * table[view[upper, left]] + along * table[view[upper, right]]
    return float((1.0 - up) * below + up * above)
