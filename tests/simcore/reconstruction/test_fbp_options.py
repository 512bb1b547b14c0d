"""Filters, edges, fields and regions of filtered back-projection; plain back-projection."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.artifacts import ProjectionStack
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.reconstruction import FilteredBackprojection, reconstruct
from simcore.reconstruction.filter.edges import thickness_profile
from simcore.reconstruction.filter.filters import filter_columns, frequency_response, padded_length
from simcore.reconstruction.filter.line_integrals import line_integrals as measured_integrals
from simcore.reconstruction.spec import Backprojection, RegionSpec

FINE = FilteredBackprojection(value_slope=1e-6, value_intercept=-0.03)
OBJECT = ((0.0, 3.0, 32.0), (25.0, 18.0, 9.0), 0.02)


def attenuation(volume):
    return volume.slope * volume.data.astype(np.float64) + volume.intercept


def response(**options):
    spec = FilteredBackprojection(slice_thickness_filter=False, **options)
    return frequency_response(512, 0.1, spec, 0.3, 1.05).astype(np.float64), np.fft.rfftfreq(512, 0.1)


def test_windows_and_regularisation_of_the_ramp():
    ramp, f = response(filter="ramp")
    np.testing.assert_allclose(ramp, f, atol=0.01)
    hamming, _ = response(filter="hamming", hann_cutoff=0.5)
    np.testing.assert_allclose(hamming, ramp * np.where(f < 2.5, 0.54 + 0.46 * np.cos(np.pi * f / 2.5), 0), atol=1e-6)
    hann, _ = response(filter="hann")
    np.testing.assert_allclose(hann, ramp * (0.5 + 0.5 * np.cos(np.pi * f / 5)), atol=1e-6)
    regularised, _ = response(filter="ramp", regularisation_mm=0.5)
    np.testing.assert_allclose(regularised, ramp / (1 + (0.5 * f) ** 2), atol=1e-6)
    assert regularised.argmax() == pytest.approx(np.searchsorted(f, 2.0), abs=1)
    none, _ = response(filter="none")
    np.testing.assert_array_equal(none, 1.0)


def filtered(columns, response, length, extend):
    out = np.empty_like(columns)
    filter_columns(columns, response, length, out, extend=extend)
    return out


def test_beyond_the_detector_values_may_go_on():
    """A constant has no edges then: the ramp leaves almost nothing of it."""
    constant = np.full((300, 2), 3.0, np.float32)
    length = padded_length(300)
    spec = FilteredBackprojection(filter="ramp", slice_thickness_filter=False)
    ramp = frequency_response(length, 0.1, spec, 0.0, 1.0)
    cut, extended = (filtered(constant, ramp, length, extend) for extend in (False, True))
    assert extended.shape == cut.shape == (300, 2)
    assert np.abs(extended).max() < 0.02 * np.abs(cut).max()
    slope = np.linspace(1.0, 5.0, 300, dtype=np.float32)[:, None]
    cut, extended = (filtered(slope, ramp, length, extend) for extend in (False, True))
    assert np.abs(extended[[0, -1]]).max() < 0.05 * np.abs(cut[[0, -1]]).max()
    # Where the columns fade out anyway, the two are alike.
    bump = np.zeros((300, 1), np.float32)
    bump[150] = 1.0
    np.testing.assert_array_equal(filtered(bump, ramp, length, True), filtered(bump, ramp, length, False))


def test_a_breast_cut_off_by_the_detector_is_less_bright_at_the_cut(make_geometry, acquire):
    wide = make_geometry(ny=300, nx=16, pixel=0.5)
    narrow = make_geometry(ny=120, nx=16, pixel=0.5)
    slab = ((0.0, 0.0, 40.0), (1e5, 60.0, 12.0), 0.02)
    truth = attenuation(reconstruct(acquire(wide, [slab]), FINE, 40.0))[20, 90:210, 8]
    errors = {}
    for edge in ("zero", "extend"):
        values = attenuation(reconstruct(acquire(narrow, [slab]), FINE.with_(detector_edge=edge), 40.0))[20, :, 8]
        errors[edge] = np.abs(values - truth)[16:-16].max()
    assert errors["extend"] < 0.25 * errors["zero"]


def test_flattened_edges_cast_no_shadow_and_keep_what_is_inside(make_geometry, acquire):
    geometry = make_geometry(ny=300, nx=40, pixel=0.4, views=9)
    breast = ((0.0, 0.0, 40.0), (1e5, 45.0, 14.0), 0.02)
    bead = ((8.0, 5.0, 40.0), (0.8, 0.8, 0.8), 0.05)
    kept, flat = (
        attenuation(reconstruct(acquire(geometry, [breast, bead]), FINE.with_(breast_edge=edge), 40.0))
        for edge in ("keep", "flatten")
    )
    y = geometry.detector.y_centres()
    outside = (np.abs(y) > 47.0) & (np.abs(y) < 55.0)
    assert np.abs(flat[:, outside]).max() < 0.25 * np.abs(kept[:, outside]).max()
    # The bead against its surroundings.
    row = np.argmin(np.abs(y - 5.0))
    contrast = [v[20, row, 20] - v[20, row - 12, 20] for v in (kept, flat)]
    assert contrast[1] == pytest.approx(contrast[0], rel=0.05)


def test_profile_leaves_a_constant_inside(make_geometry, acquire):
    geometry = make_geometry(ny=200, nx=40, pixel=0.5, views=3)
    stack = acquire(geometry, [((0.0, 0.0, 35.0), (1e5, 40.0, 14.0), 0.02)])
    profile = thickness_profile(stack, 1, 40)
    before = measured_integrals(stack, 1, slice(8, 24))
    after = before.copy()
    profile.take_from(after, slice(8, 24))
    taken = before - after
    assert taken[100, 3] == pytest.approx(np.quantile(before[before > 0.05], 0.25), rel=0.05)
    np.testing.assert_allclose(taken[80:120, 3], taken[100, 3], rtol=2e-3)
    assert np.all(after >= -0.02)


@pytest.mark.parametrize("kind", [FINE, Backprojection(value_slope=1e-6), FINE.with_(filter="none")])
def test_region_and_field_are_cut_out_of_the_whole(make_geometry, acquire, kind):
    stack = acquire(make_geometry(ny=200, nx=80, pixel=0.5), [OBJECT])
    whole = reconstruct(stack, kind, 25.0)
    region = RegionSpec(x_min_mm=5.0, x_max_mm=20.2, y_min_mm=-11.0, z_min_mm=3.0, z_max_mm=7.0)
    part = reconstruct(stack, kind.with_(region=region), 25.0)
    assert part.data.shape == (4, 122, 31)
    assert part.grid.corner == pytest.approx((5.0, -11.0, 23.0))
    difference = part.data.astype(int) - whole.data[3:7, 78:, 10:41]
    assert np.abs(difference).max() <= 1
    breast = reconstruct(stack, kind.with_(field="breast"), 25.0)
    assert breast.grid.corner[0] == 0.0
    assert 25.0 + 0.5 < breast.grid.upper[0] < 25.0 + 3.5
    assert -15.0 - 3.5 < breast.grid.corner[1] < -15.0 - 0.5
    assert 21.0 + 0.5 < breast.grid.upper[1] < 21.0 + 3.5
    first = round((breast.grid.corner[1] - whole.grid.corner[1]) / 0.5)
    _, ny, nx = breast.data.shape
    assert np.abs(breast.data.astype(int) - whole.data[:, first : first + ny, :nx]).max() <= 1


def test_field_of_a_truncated_breast_and_of_none(make_geometry, acquire):
    geometry = make_geometry(ny=60, nx=30, pixel=0.5, views=3)
    cut_off = reconstruct(acquire(geometry, [((0.0, 0.0, 32.0), (50.0, 50.0, 9.0), 0.02)]), FINE, 20.0)
    cropped = reconstruct(
        acquire(geometry, [((0.0, 0.0, 32.0), (50.0, 50.0, 9.0), 0.02)]), FINE.with_(field="breast"), 20.0
    )
    assert cropped.grid == cut_off.grid
    empty = reconstruct(acquire(geometry, []), FINE.with_(field="breast"), 20.0)
    assert empty.grid == cut_off.grid


def test_field_of_a_turned_detector(make_geometry, acquire):
    turned = acquire(make_geometry(ny=200, nx=80, detector_range=20.0), [OBJECT])
    still = acquire(make_geometry(ny=200, nx=80), [OBJECT])
    first, second = (reconstruct(s, FINE.with_(field="breast"), 20.0).grid for s in (turned, still))
    np.testing.assert_allclose(first.corner, second.corner, atol=0.51)
    np.testing.assert_allclose(first.upper, second.upper, atol=0.51)


def test_what_a_region_refuses(make_geometry, acquire):
    with pytest.raises(ValidationError, match=r"x_min_mm = 5 must be below x_max_mm = 4"):
        RegionSpec(x_min_mm=5.0, x_max_mm=4.0)
    stack = acquire(make_geometry(ny=20, nx=20), [])
    with pytest.raises(GeometryError, match=r"60 to inf mm along x holds no voxel"):
        reconstruct(stack, FINE.with_(region=RegionSpec(x_min_mm=60.0)), 20.0)


@pytest.mark.parametrize("method", ["simple", "shift-and-add", "none"])
def test_a_slab_comes_out_with_its_own_attenuation(make_geometry, method):
    """Rays of any inclination: the integral is divided by their length between the plates."""
    geometry = make_geometry(ny=300, nx=60, views=5)
    y, x = geometry.detector.y_centres()[:, None], geometry.detector.x_centres()
    data = np.empty((5, 300, 60), np.uint16)
    for view, source in enumerate(geometry.sources):
        inclination = np.sqrt(x**2 + (y - source[1]) ** 2 + source[2] ** 2) / source[2]
        data[view] = np.rint(60000 * np.exp(-0.03 * 20.0 * inclination))
    spec = FilteredBackprojection(filter="none") if method == "none" else Backprojection(method=method)
    values = attenuation(reconstruct(ProjectionStack(data, 60000.0, geometry), spec, 20.0))
    np.testing.assert_allclose(values[:, 50:250, :50], 0.03, rtol=2e-3)


def test_simple_backprojection_is_sharp_in_the_slice_of_a_bead(make_geometry, acquire):
    bead = (6.13, -8.4, 35.5)
    stack = acquire(make_geometry(ny=400, nx=80, pixel=0.2), [(bead, (0.4, 0.4, 0.4), 0.5)])
    volume = reconstruct(stack, Backprojection(), 25.0)
    values = attenuation(volume)
    place = np.unravel_index(values.argmax(), values.shape)
    peak = [volume.grid.centres(axis)[n] for axis, n in zip("zyx", place, strict=True)]
    assert np.all(np.abs(np.subtract(peak, bead[::-1])) < [1.0, 0.15, 0.15])
    # Elsewhere each view has its own copy.
    assert values[0].max() < 0.3 * values.max()


def test_shift_and_add_is_backprojection_for_a_tube_that_moves_parallel(make_geometry, acquire):
    geometry = make_geometry(ny=200, nx=60, views=5)
    parallel = AcquisitionGeometry(
        **{**vars(geometry), "sources": geometry.sources * [1, 1, 0] + np.array([0.0, 0.0, 660.0])}
    )
    stack = acquire(parallel, [OBJECT])
    simple, shifted = (reconstruct(stack, Backprojection(method=m), 25.0).data for m in ("simple", "shift-and-add"))
    assert np.abs(simple.astype(int) - shifted.astype(int)).max() <= 1
    turning = acquire(geometry, [OBJECT])
    simple, shifted = (reconstruct(turning, Backprojection(method=m), 25.0) for m in ("simple", "shift-and-add"))
    difference = np.abs(attenuation(simple) - attenuation(shifted))
    # On a circle magnifications differ a little: small in the middle, more outside.
    assert 1e-4 < difference.max() < 0.2 * attenuation(simple).max()
