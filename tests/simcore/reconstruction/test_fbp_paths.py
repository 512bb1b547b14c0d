"""Filtered back-projection where the tube moves on another path than an arc: values are attenuation all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simcore.core.errors import GeometryError
from simcore.reconstruction import reconstruct
from simcore.reconstruction.filter.filters import ray_weights

from .test_fbp import FINE, at, value_at_centre


def on_a_line(geometry):
    """The same tube angles, all focal spots at one height."""
    height = geometry.source_to_detector - geometry.isocenter_height
    y = height * np.tan(np.deg2rad(geometry.angles))
    sources = np.stack([0 * y, y, np.full(len(y), geometry.source_to_detector)], axis=1)
    return replace(geometry, sources=sources)


def test_centre_of_a_cylinder_has_its_closed_form(make_geometry, acquire):
    arc = make_geometry(ny=700, nx=6, pixel=0.8, views=41, angular_range=80.0, source_to_detector=400.0)
    line = on_a_line(arc)
    cylinder = [((0.0, 0.5, 40.5), (1e5, 12.0, 9.0), 0.02)]
    expected = value_at_centre(arc, (12.0, 9.0), 0.02, 0.5, 40.5)
    spec = FINE.with_(slice_thickness_filter=False)
    for geometry in (arc, line):
        volume = reconstruct(acquire(geometry, cylinder), spec, 40.0)
        assert at(volume, 1.0, 0.5, 40.5) == pytest.approx(expected, rel=0.01)


def test_motion_on_a_line_is_what_differences_give(make_geometry):
    """S' is (H - c) / cos^2 a along y: its weight at the pixel below the source is that times s_z / (s_z L)."""
    line = on_a_line(make_geometry(ny=400, nx=4, pixel=1.0, views=81, angular_range=40.0))
    for view in (0, 17, 40, 80):
        row = int(np.argmin(np.abs(line.detector.y_centres() - line.sources[view, 1])))
        weight = ray_weights(line, view, slice(0, 1))[row, 0]
        expected = 620.0 / np.cos(np.deg2rad(line.angles[view])) ** 2 / 660.0
        assert weight == pytest.approx(expected, rel=1e-3)


def test_two_views_at_one_angle_are_refused(make_geometry, acquire):
    geometry = on_a_line(make_geometry(views=5))
    doubled = replace(geometry, sources=geometry.sources[[0, 1, 2, 2, 4]], angles=geometry.angles[[0, 1, 2, 2, 4]])
    with pytest.raises(GeometryError, match="two views stand at the same tube angle"):
        reconstruct(acquire(doubled, [((8.0, 0.0, 30.0), (5.0, 5.0, 5.0), 0.02)]), FINE, 20.0)
