"""Exact line integrals (Siddon's) for a whole detector row at once.

The pixels of a detector row and the source lie in one plane, and that plane contains the x direction: along every ray
of the row, y is the same function of z. So for a row, let T_c(z) be the integral of mu from the bottom of the volume
to height z at the x column c, taken along that common path. A ray runs through few columns: it leaves column b for
column b - 1 at a height z_b that depends on the pixel alone, and its integral is

    sum over its columns of (T at leaving - T at entering) = T_last(top) - sum over b of E_b(z_b),   E_b = T_{b-1} - T_b

times the length of the ray per unit of height. E_b is a running sum over slices that grows where tissue changes at b;
what is left for a single ray is one term for each column boundary it crosses. The idea of sharing the prefix sums along
one axis is that of separable projectors; the lengths are Siddon's (Med. Phys. 12 (1985) 252-255) without approximation.

A detector that is moved or turned about the x axis is served too: each of its rows is replaced by the row of z = 0 that
the same rays meet, with its own pixel pitch. Where it is at rest all rows share the table of crossings, and
``plane_prefix_lanes`` takes sixteen of them at a time; ``plane_prefix_rows`` takes all others, and paths so flat that
they meet many voxel rows in a slice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.projection import plane_prefix_lanes, plane_prefix_rows
from simcore.projection.borders import Borders
from simcore.projection.crossings import Columns
from simcore.projection.plane_prefix_rows import Rows
from simcore.projection.schedule import spread
from simcore.simd.vector import LANES


def serves(geometry: AcquisitionGeometry, view: int) -> bool:
    """True where columns run along x, and x falls from every pixel to the source: it is not beyond the chest-wall
    edge."""
    along_x = geometry.column_direction(view)[0] == 1.0
    edge = geometry.detector_frame(view)[0][0]
    return bool(along_x and geometry.sources[view, 0] < edge + geometry.detector.pixel / 2)


def serves_lanes(geometry: AcquisitionGeometry, view: int, grid: Grid) -> bool:
    """True where ``plane_prefix_lanes`` can do it: all rows share their crossings, and no path meets more than two
    voxel rows in a slice."""
    bottom_y, top_y, stretch, _ = paths_of(geometry, view, grid)[0]
    flattest = np.abs(top_y - bottom_y).max() / grid.shape[0]
    return bool(np.all(stretch == stretch[0]) and flattest < plane_prefix_lanes.FLATTEST)


def project_planes(
    borders: Borders,
    grid: Grid,
    geometry: AcquisitionGeometry,
    view: int,
    basis: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Line integrals of one view, of one map or several.

    borders: of labels on ``grid``, detector frame, below the source and above the detector.
    basis: (maps, MAX_TISSUES), 1 to MAPS, what each label has of each map, per mm.
    out: float32 (maps, detector.ny, detector.nx), overwritten; dimensionless, within 1e-5 of double precision.
    """
    rows, columns, source_z = paths_of(geometry, view, grid)
    if serves_lanes(geometry, view, grid):
        for values, one in zip(basis, out, strict=True):
            lists = (borders.start, borders.packed, borders.falls(values), *borders.shape)
            order = spread(-(-len(rows[0]) // LANES))
            reach = int(borders.row_ends(np.abs(values)).max())
            plane_prefix_lanes.project_lanes(lists, rows, columns, order, reach, source_z, grid.spacing[2], one)
        return
    ends = borders.row_ends(np.abs(basis).sum(axis=0))
    plane_prefix_rows.project_rows(
        (borders.start, borders.packed, ends, plane_prefix_rows.falls_of(basis)),
        rows,
        columns,
        bool(np.all(rows[2] == rows[2][0])),
        spread(len(rows[0])),
        source_z,
        grid.spacing[2],
        out,
    )


def paths_of(geometry: AcquisitionGeometry, view: int, grid: Grid) -> tuple[Rows, Columns, float]:
    """What the rays of a view have in common: rows, columns, z of the source."""
    detector = geometry.detector
    source_x, source_y, source_z = geometry.sources[view]
    origin, row_direction = geometry.detector_frame(view)
    offsets = detector.y_centres()[:, None] * row_direction
    row_y, row_z = origin[1] + offsets[:, 1], origin[2] + offsets[:, 2]
    stretch = source_z / (source_z - row_z)
    # Along a ray, a coordinate at height z is source + (its value at z = 0 - source) (source_z - z) / source_z.
    share_bottom = (source_z - grid.corner[2]) / source_z
    share_top = (source_z - grid.upper[2]) / source_z
    virtual_y = (row_y - source_y) * stretch
    bottom_y = (source_y - grid.corner[1] + virtual_y * share_bottom) / grid.spacing[1]
    top_y = (source_y - grid.corner[1] + virtual_y * share_top) / grid.spacing[1]
    rows = (bottom_y, top_y, stretch, virtual_y / source_z)
    source_cell = (source_x - grid.corner[0]) / grid.spacing[0]
    pixel_x = origin[0] + detector.x_centres() - source_x
    columns = (pixel_x, grid.spacing[0], source_cell, share_bottom, grid.spacing[2] / source_z)
    return rows, columns, float(source_z)
