"""The projection of slices and its transpose."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.reconstruction.operators.crossings import backproject, project_slices

GRIDS = {
    "inside": Grid((6, 40, 30), (0.5, 0.5, 2.0), (0.0, -10.0, 20.0)),
    "larger than the detector": Grid((4, 90, 70), (0.9, 0.8, 5.0), (-8.0, -36.0, 5.0)),
    "beside it": Grid((3, 20, 20), (1.0, 1.0, 3.0), (4.0, 8.0, 200.0)),
    "fine": Grid((5, 30, 90), (0.1, 0.2, 1.0), (2.0, -3.0, 0.0)),
}


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("source_x", [0.0, 7.0])
def test_backproject_is_the_transpose(make_geometry, name, source_x):
    grid = GRIDS[name]
    geometry = make_geometry(ny=48, nx=36, views=5)
    geometry.sources[:, 0] = source_x
    rng = np.random.default_rng(11)
    x = rng.normal(size=grid.shape).astype(np.float32)
    y = rng.normal(size=(5, 48, 36)).astype(np.float32)
    projected, back = project_slices(x, grid, geometry), backproject(y, grid, geometry)
    forward = np.vdot(projected.astype(np.float64), y)
    scale = np.linalg.norm(projected.astype(np.float64)) * np.linalg.norm(y)
    assert np.linalg.norm(projected) > 1.0
    assert abs(forward - np.vdot(x.astype(np.float64), back)) < 1e-6 * scale
    assert forward == pytest.approx(np.vdot(x.astype(np.float64), back), rel=1e-5, abs=1e-7 * scale)


def test_slab_gives_the_length_of_rays_in_it(make_geometry):
    geometry = make_geometry(ny=48, nx=36, views=5)
    grid = Grid((7, 400, 200), (1.0, 1.0, 3.0), (-80.0, -200.0, 20.0))
    projected = project_slices(np.ones(grid.shape, np.float32), grid, geometry)
    for view, source in enumerate(geometry.sources):
        y, x = geometry.detector.y_centres()[:, None], geometry.detector.x_centres()
        inclination = np.sqrt(x**2 + (y - source[1]) ** 2 + source[2] ** 2) / source[2]
        np.testing.assert_allclose(projected[view], 21.0 * inclination, rtol=1e-5)


def test_ellipsoid_against_the_closed_form(make_geometry, line_integrals):
    geometry = make_geometry(ny=100, nx=60, views=3)
    ellipsoid = ((12.0, 3.0, 35.0), (8.0, 14.0, 10.0), 0.05)
    grid = Grid((80, 128, 96), (0.25, 0.25, 0.25), (0.0, -13.0, 25.0))
    z, y, x = np.meshgrid(*(grid.centres(axis) for axis in "zyx"), indexing="ij", sparse=True)
    inside = ((x - 12.0) / 8) ** 2 + ((y - 3.0) / 14) ** 2 + ((z - 35.0) / 10) ** 2 < 1
    projected = project_slices(inside * np.float32(0.05), grid, geometry)
    expected = line_integrals(geometry, [ellipsoid])
    seen = expected > 0
    assert np.mean(projected[seen] - expected[seen]) == pytest.approx(0.0, abs=2e-3)
    assert np.sqrt(np.mean((projected - expected)[seen] ** 2)) < 0.01


def test_moving_everything_along_y_and_x_changes_nothing(make_geometry):
    geometry = make_geometry(ny=48, nx=36, views=3)
    grid = GRIDS["inside"]
    x = np.random.default_rng(2).random(grid.shape, np.float32)
    sources = geometry.sources + np.array([0.0, geometry.detector.pixel * 4, 0.0])
    moved = AcquisitionGeometry(**{**vars(geometry), "sources": sources})
    first = project_slices(x, grid, geometry)
    second = project_slices(x, grid.moved(y=geometry.detector.pixel * 4), moved)
    np.testing.assert_allclose(second[:, 4:], first[:, :-4], rtol=1e-4, atol=1e-5)


def test_threads_change_no_byte(make_geometry, threads):
    geometry = make_geometry(ny=48, nx=36, views=3)
    grid = GRIDS["inside"]
    x = np.random.default_rng(2).random(grid.shape, np.float32)
    results = []
    for count in (1, 2):
        threads(count)
        projected = project_slices(x, grid, geometry)
        results.append((projected.tobytes(), backproject(projected, grid, geometry).tobytes()))
    assert results[0] == results[1]


def test_refuses_what_it_cannot_do(make_geometry):
    grid = GRIDS["inside"]
    x = np.zeros(grid.shape, np.float32)
    with pytest.raises(GeometryError, match="at rest"):
        project_slices(x, grid, make_geometry(detector_range=4.0))
    with pytest.raises(GeometryError, match="lowest source"):
        project_slices(x, grid.moved(z=700.0), make_geometry())
    with pytest.raises(ValueError, match="differ"):
        project_slices(x[1:], grid, make_geometry())
    with pytest.raises(ValueError, match="do not fit"):
        backproject(np.zeros((1, 2, 3), np.float32), grid, make_geometry())
