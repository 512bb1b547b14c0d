"""Whether the poses of source and detector can be served. No compiled code: asked before anything runs, too."""

from __future__ import annotations

import math

from simcore.core.advice import one_of, where
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry

PARALLEL_MM = 1e-6
"""A source nearer to the plane of the detector stands in it."""


def check_poses(geometry: AcquisitionGeometry, bottom: float, top: float) -> None:
    """The source must stand above the phantom and before the detector, the detector below the phantom, in every view.

    bottom, top: of the phantom, with the paddle on it, mm in the detector frame.
    raises: GeometryError
    """
    for view in range(geometry.views):
        _check_source(geometry, view, top)
        highest = _highest_corner(geometry, view)
        if highest > bottom + 1e-9:
            raise GeometryError(
                f"view {view}: the edge of the detector, turned by {geometry.detector_angles[view]:g} degrees, rises "
                f"to {highest:.2f} mm, above the bottom of the phantom at {bottom:.2f} mm; take "
                + _lower_detector(geometry, view, highest - bottom)
            )


def _check_source(geometry: AcquisitionGeometry, view: int, top: float) -> None:
    source = geometry.sources[view]
    name = f"view {view} at {geometry.angles[view]:g} degrees: the source"
    ahead = float(geometry.normal(view) @ (source - geometry.detector_frame(view)[0]))
    if ahead < PARALLEL_MM:
        where = "in the plane of" if ahead > -PARALLEL_MM else f"{-ahead:.1f} mm behind"
        raise GeometryError(
            f"{name} at ({source[0]:g}, {source[1]:g}, {source[2]:g}) mm stands {where} the detector; it must stand "
            "before it, where column_direction x row_direction points to: move source_mm, or turn the detector"
        )
    if source[2] <= top:
        raise GeometryError(
            f"{name} stands {source[2]:.1f} mm above the detector, not above the top of the phantom at {top:.1f} mm; "
            f"raise source_to_detector_mm ({geometry.source_to_detector:g}) or the source_mm of the trajectory, or "
            "lower angular_range_degrees"
        )


def _lower_detector(geometry: AcquisitionGeometry, view: int, by_mm: float) -> str:
    """What lowers the detector's edge by ``by_mm`` against the phantom."""
    listed = geometry.detector_poses is not None
    return one_of(
        f"air_gap_mm = {math.ceil(10 * (geometry.support_height + by_mm)) / 10:g}",
        where(listed, "a lower detector in the trajectory"),
        where(not listed and geometry.detector_angles[view] != 0, "a smaller detector_range_degrees"),
    )


def _highest_corner(geometry: AcquisitionGeometry, view: int) -> float:
    """z of the highest corner of the detector, mm."""
    detector = geometry.detector
    origin, row = geometry.detector_frame(view)
    along_row = detector.ny * detector.pixel / 2 * abs(row[2])
    along_column = max(0.0, detector.nx * detector.pixel * geometry.column_direction(view)[2])
    return float(origin[2] + along_row + along_column)
