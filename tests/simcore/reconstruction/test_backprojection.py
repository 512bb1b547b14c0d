"""The backprojector against one written out in double precision, and the filters against their formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from simcore.core.artifacts import ProjectionStack
from simcore.core.grid import Grid
from simcore.reconstruction import FilteredBackprojection
from simcore.reconstruction.filter.filters import angular_steps, frequency_response
from simcore.reconstruction.filter.line_integrals import attenuation_table, lit_columns
from simcore.reconstruction.filter.line_integrals import line_integrals as carried_integrals
from simcore.reconstruction.methods.fbp import filtered_views
from simcore.reconstruction.operators.backprojection import backproject_quantised, plan_backprojection

SLOPE, INTERCEPT = 1e-3, -30.0


def naive_backprojection(filtered, geometry, grid):
    """Sum over views of the squared magnification times the bilinear value of the pixel that a voxel projects to."""
    views, rows, columns = filtered.shape
    padded = np.zeros((views, rows + 2, columns + 2))
    padded[:, 1:-1, 1:-1] = filtered
    result = np.zeros(grid.shape)
    for z, height in enumerate(grid.centres("z")):
        for view, (_, source_y, source_z) in enumerate(geometry.sources):
            m = source_z / (source_z - height)
            v = (source_y + (grid.centres("y") - source_y) * m) / geometry.detector.pixel + (rows - 1) / 2
            u = grid.centres("x") * m / geometry.detector.pixel - 0.5
            for y in range(grid.shape[1]):
                for x in range(grid.shape[2]):
                    j, i = int(np.floor(v[y])), int(np.floor(u[x]))
                    if -1 <= j < rows and -1 <= i < columns:
                        b, a = v[y] - j, u[x] - i
                        corner = padded[view, j + 1 : j + 3, i + 1 : i + 3]
                        result[z, y, x] += m**2 * ([1 - b, b] @ corner @ [1 - a, a])
    return result


def run(filtered, geometry, grid):
    out = np.empty(grid.shape, np.uint16)
    plan = plan_backprojection(geometry, grid)
    # Odd row ranges: blocks of rows need not end where ranges do.
    middle = grid.shape[1] // 2 + 1
    for rows in (slice(0, middle), slice(middle, grid.shape[1])):
        clipped = backproject_quantised(filtered, plan, rows, SLOPE, INTERCEPT, out)
        assert clipped == (0, 0)
    return out * SLOPE + INTERCEPT


@pytest.mark.parametrize(
    "grid",
    [
        Grid((3, 21, 18), (0.5, 0.5, 4.0), (0.0, -5.25, 20.0)),
        Grid((2, 45, 50), (0.6, 0.7, 9.0), (-4.0, -15.0, 5.0)),  # larger than the detector on all sides
        Grid((2, 13, 100), (0.07, 0.11, 30.0), (0.0, 0.3, 300.0)),  # small voxels, strong magnification
        Grid((1, 6, 7), (2.3, 1.9, 1.0), (0.0, -6.0, 30.0)),  # voxels of several pixels
    ],
)
def test_equals_the_naive_backprojection(make_geometry, grid):
    geometry = make_geometry(ny=24, nx=37, views=5, angular_range=30.0)
    filtered = np.random.default_rng(5).normal(size=(5, 24, 37)).astype(np.float32)
    expected = naive_backprojection(filtered, geometry, grid)
    assert np.abs(expected).max() > 1.0
    assert np.abs(run(filtered, geometry, grid) - expected).max() <= 0.51 * SLOPE


def test_unseen_voxels_are_exactly_zero(make_geometry):
    geometry = make_geometry(ny=24, nx=20, views=3, angular_range=10.0)
    grid = Grid((2, 60, 60), (0.5, 0.5, 5.0), (0.0, -15.0, 20.0))
    seen = naive_backprojection(np.ones((3, 24, 20), np.float32), geometry, grid) > 0
    values = run(np.ones((3, 24, 20), np.float32), geometry, grid)
    assert 0 < seen.sum() < seen.size / 2
    assert np.all(values[~seen] == 0.0)
    assert np.all(values[seen] >= 0.0)


def test_columns_without_signal_may_be_left_out(make_geometry):
    geometry = make_geometry(ny=24, nx=37, views=5, angular_range=30.0)
    grid = Grid((3, 21, 37), (0.5, 0.5, 4.0), (0.0, -5.25, 20.0))
    filtered = np.random.default_rng(5).normal(size=(5, 24, 37)).astype(np.float32)
    filtered[:, :, 23:] = 0.0
    whole = run(filtered, geometry, grid)
    np.testing.assert_array_equal(run(np.ascontiguousarray(filtered[:, :, :23]), geometry, grid), whole)
    np.testing.assert_array_equal(run(np.zeros((5, 24, 0), np.float32), geometry, grid), 0.0)


def test_lit_columns(make_geometry):
    geometry = make_geometry(ny=6, nx=9, views=2)
    data = np.full((2, 6, 9), 60000, np.uint16)
    assert lit_columns(ProjectionStack(data.copy(), 60000.0, geometry)) == 0
    data[0, 4, 2] = 59999
    data[1, 0, 6] = 60001
    assert lit_columns(ProjectionStack(data.copy(), 60000.0, geometry)) == 7
    assert lit_columns(ProjectionStack(data.copy(), 60000.5, geometry)) == 9


def test_line_integrals_of_pixel_values():
    table = attenuation_table(60000.0)
    assert table[60000] == 0.0
    assert table[0] == table[1] == np.float32(np.log(60000.0))
    assert table[30000] == pytest.approx(np.log(2.0), rel=1e-7)


def test_turned_detector_is_read_where_rays_meet_it(make_geometry, line_integrals):
    """Line integrals carried to the plane z = 0 are those of a detector that lies there."""
    ellipsoid = ((5.0, 5.0, 40.0), (45.0, 30.0, 15.0), 0.02)
    still = make_geometry(ny=150, nx=90, pixel=0.8, views=3, source_to_detector=300.0)
    turned = make_geometry(ny=150, nx=90, pixel=0.8, views=3, source_to_detector=300.0, detector_range=30.0)
    expected = line_integrals(still, [ellipsoid])
    data = np.rint(60000 * np.exp(-line_integrals(turned, [ellipsoid]))).astype(np.uint16)
    stack = ProjectionStack(data, 60000.0, turned)
    for view in range(3):
        carried = np.hstack([carried_integrals(stack, view, slice(i, i + 45)) for i in (0, 45)])
        # At the rim of the shadow the line integral is a root, which interpolation cannot follow.
        inside = expected[view] > 0.35
        assert 2000 < inside.sum() < 6000
        assert inside[:, 0].sum() > 40  # up to the chest wall
        assert np.abs(carried - expected[view])[inside].max() < 5e-4
        assert np.all(carried[binary_erosion(expected[view] == 0, iterations=2)] == 0)


def test_slice_thickness_filter_is_meant_for_the_middle_of_the_volume(make_geometry):
    data = np.random.default_rng(3).integers(30000, 60000, (3, 64, 8)).astype(np.uint16)
    stack = ProjectionStack(data, 60000.0, make_geometry(ny=64, nx=8, views=3))
    volumes = (Grid((2, 8, 8), (1.0, 1.0, 1.0), (0.0, 0.0, z_middle - 1.0)) for z_middle in (0.0, 60.0))
    low, high = (filtered_views(stack, FilteredBackprojection(), volume, 2.0) for volume in volumes)
    np.testing.assert_array_equal(low[1], high[1])
    assert np.linalg.norm(high[0]) < 0.98 * np.linalg.norm(low[0])


def test_angular_steps():
    np.testing.assert_allclose(np.rad2deg(angular_steps(np.array([0.0, -20.0, 20.0]))), [20.0, 20.0, 20.0])
    np.testing.assert_allclose(np.rad2deg(angular_steps(np.array([-3.0, 0.0, 1.0, 2.0]))), [3, 2, 1, 1])


def test_frequency_response():
    length, pixel = 512, 0.1
    f = np.fft.rfftfreq(length, pixel)
    spec = FilteredBackprojection(hann_cutoff=0.5, slice_mm=2.0)
    central = frequency_response(length, pixel, spec, 0.0, 1.05)
    hann = np.where(f < 2.5, 0.5 + 0.5 * np.cos(np.pi * f / 2.5), 0.0)
    np.testing.assert_allclose(central, f * hann, atol=0.01)
    assert 0.0 < central[0] < 1e-2  # the band-limited ramp keeps the mean of a finite object
    outer = frequency_response(length, pixel, spec, 0.36, 1.05)
    depth = f * 1.05 * 0.36
    window = np.where(depth < 0.25, 0.5 + 0.5 * np.cos(np.pi * depth / 0.25), 0.0)
    np.testing.assert_allclose(outer, f * hann * window, atol=0.01)
    off = frequency_response(length, pixel, spec.with_(slice_thickness_filter=False), 0.36, 1.05)
    np.testing.assert_array_equal(off, central)
