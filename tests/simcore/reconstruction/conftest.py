"""Acquisitions of ellipsoids in closed form, independent of simcore.projection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from simcore.core.artifacts import ProjectionStack
from simcore.core.geometry import AcquisitionGeometry, Detector

OPEN_FIELD = 60000.0
Ellipsoid = tuple[tuple[float, float, float], tuple[float, float, float], float]
"""centre (x, y, z) and semi-axes, mm, in the detector frame; attenuation, 1/mm"""


def _geometry(
    ny: int = 200,
    nx: int = 80,
    pixel: float = 0.5,
    views: int = 15,
    angular_range: float = 40.0,
    detector_range: float = 0.0,
    source_to_detector: float = 660.0,
    isocenter: float = 40.0,
    support: float = 20.0,
) -> AcquisitionGeometry:
    part = np.linspace(-0.5, 0.5, views)
    a = np.deg2rad(angular_range * part)
    radius = source_to_detector - isocenter
    sources = np.stack([0 * a, radius * np.sin(a), isocenter + radius * np.cos(a)], axis=1)
    return AcquisitionGeometry(
        angles=angular_range * part,
        sources=sources,
        detector=Detector(ny, nx, pixel),
        detector_angles=detector_range * part,
        isocenter_height=isocenter,
        source_to_detector=source_to_detector,
        support_height=support,
    )


def _line_integrals(geometry: AcquisitionGeometry, ellipsoids: list[Ellipsoid]) -> NDArray[np.float64]:
    """Chord of every ray through every ellipsoid times its attenuation, (views, ny, nx)."""
    detector = geometry.detector
    total = np.zeros((geometry.views, detector.ny, detector.nx))
    for view, source in enumerate(geometry.sources):
        origin, row = geometry.detector_frame(view)
        pixels = (
            origin
            + detector.x_centres()[None, :, None] * np.array([1.0, 0.0, 0.0])
            + detector.y_centres()[:, None, None] * row
        )
        for centre, axes, attenuation in ellipsoids:
            ray = (pixels - source) / axes
            start = (source - np.array(centre)) / axes
            a = (ray**2).sum(axis=2)
            b = ray @ start
            root = np.sqrt(np.maximum(b**2 - a * (start @ start - 1.0), 0.0))
            total[view] += attenuation * 2 * root / a * np.linalg.norm(pixels - source, axis=2)
    return total


@pytest.fixture(scope="session")
def make_geometry() -> Callable[..., AcquisitionGeometry]:
    return _geometry


@pytest.fixture(scope="session")
def line_integrals() -> Callable[[AcquisitionGeometry, list[Ellipsoid]], NDArray[np.float64]]:
    return _line_integrals


@pytest.fixture(scope="session")
def acquire() -> Callable[[AcquisitionGeometry, list[Ellipsoid]], ProjectionStack]:
    """(geometry, ellipsoids) -> what the detector stores of them."""

    def stack(geometry: AcquisitionGeometry, ellipsoids: list[Ellipsoid]) -> ProjectionStack:
        signal = OPEN_FIELD * np.exp(-_line_integrals(geometry, ellipsoids))
        return ProjectionStack(np.rint(signal).astype(np.uint16), OPEN_FIELD, geometry)

    return stack
