"""From an acquisition specification to poses of source and detector."""

from __future__ import annotations

import numpy as np

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.projection.spec import AcquisitionSpec


def geometry_of(acquisition: AcquisitionSpec) -> AcquisitionGeometry:
    """The poses of every view in the detector frame.

    The tube turns about the isocenter in the plane of the chest wall: at angle a the source lies at
    (0, r sin a, h + r cos a), h the isocenter height and r = source_to_detector - h. Angles are equiangular and
    symmetric about 0; a turning detector follows with its own, smaller range.

    raises: GeometryError where the isocenter does not lie below the source.
    """
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
    detector = acquisition.detector
    return AcquisitionGeometry(
        angles=angles,
        sources=sources,
        detector=Detector(ny=detector.pixels_y, nx=detector.pixels_x, pixel=detector.pixel_mm),
        detector_angles=_equiangular(acquisition.detector_range_degrees, acquisition.views),
        isocenter_height=height,
        source_to_detector=acquisition.source_to_detector_mm,
        support_height=acquisition.air_gap_mm,
    )


def _equiangular(total: float, views: int) -> np.ndarray:
    """``views`` angles over ``total`` degrees, exactly antisymmetric, 0 for a single view."""
    if views == 1:
        return np.zeros(1)
    return (np.arange(views) - (views - 1) / 2) * (total / (views - 1))
