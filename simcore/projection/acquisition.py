"""From an acquisition specification to poses of source and detector."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import GeometryError
from simcore.core.geometry import AT_REST, AcquisitionGeometry, Detector
from simcore.projection.spec import AcquisitionSpec, DetectorPoseSpec, ViewSpec


def geometry_of(acquisition: AcquisitionSpec) -> AcquisitionGeometry:
    """The poses of every view in the detector frame.

    The tube turns about the isocenter in the plane of the chest wall: at angle a the source lies at
    (0, r sin a, h + r cos a), h the isocenter height and r = source_to_detector - h. Angles are equiangular and
    symmetric about 0; a turning detector follows with its own, smaller range. A trajectory lists the focal spots, and
    the poses of the detector, instead.

    raises: GeometryError where the isocenter does not lie below the source.
    """
    if acquisition.trajectory is not None:
        return _listed(acquisition, acquisition.trajectory)
    height = acquisition.isocenter_height_mm
    radius = acquisition.source_to_detector_mm - height
    if radius <= 0:
        raise GeometryError(
            f"isocenter_height_mm = {height:g} must be below source_to_detector_mm = "
            f"{acquisition.source_to_detector_mm:g}"
        )
    angles = _equiangular(acquisition.angular_range_degrees, acquisition.views)
    radians = np.deg2rad(angles)
    sources = np.stack([np.zeros_like(radians), radius * np.sin(radians), height + radius * np.cos(radians)], axis=1)
    return AcquisitionGeometry(
        angles=angles,
        sources=sources,
        detector=_detector(acquisition),
        detector_angles=_equiangular(acquisition.detector_range_degrees, acquisition.views),
        isocenter_height=height,
        source_to_detector=acquisition.source_to_detector_mm,
        support_height=acquisition.air_gap_mm,
    )


def _listed(acquisition: AcquisitionSpec, views: list[ViewSpec]) -> AcquisitionGeometry:
    sources = np.array([view.source_mm for view in views], np.float64)
    poses = None
    turns = np.zeros(len(views))
    if any(view.detector is not None for view in views):
        poses = np.stack([AT_REST if view.detector is None else _pose(view.detector) for view in views])
        turns = np.rad2deg(np.arctan2(-poses[:, 1, 2], poses[:, 1, 1])) + 0.0
    return AcquisitionGeometry(
        angles=np.rad2deg(np.arctan2(sources[:, 1], sources[:, 2] - acquisition.isocenter_height_mm)),
        sources=sources,
        detector=_detector(acquisition),
        detector_angles=turns,
        isocenter_height=acquisition.isocenter_height_mm,
        source_to_detector=acquisition.source_to_detector_mm,
        support_height=acquisition.air_gap_mm,
        detector_poses=poses,
    )


def _pose(pose: DetectorPoseSpec) -> NDArray[np.float64]:
    """(3, 3) as in AcquisitionGeometry.detector_poses, orthonormal to rounding."""
    rows, columns = np.array(pose.row_direction), np.array(pose.column_direction)
    rows = rows / np.linalg.norm(rows)
    columns = columns - (columns @ rows) * rows
    return np.stack([np.array(pose.origin_mm), rows, columns / np.linalg.norm(columns)])


def _detector(acquisition: AcquisitionSpec) -> Detector:
    detector = acquisition.detector
    return Detector(ny=detector.pixels_y, nx=detector.pixels_x, pixel=detector.pixel_mm)


def _equiangular(total: float, views: int) -> np.ndarray:
    """``views`` angles over ``total`` degrees, exactly antisymmetric, 0 for a single view."""
    if views == 1:
        return np.zeros(1)
    return (np.arange(views) - (views - 1) / 2) * (total / (views - 1))
