"""Filtered back-projection against closed forms: values, places, edges, stored numbers."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.errors import Cancelled, GeometryError
from simcore.core.geometry import AcquisitionGeometry
from simcore.reconstruction import FilteredBackprojection, reconstruct
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid

FINE = FilteredBackprojection(value_slope=1e-6, value_intercept=-0.03)


def attenuation(volume):
    return volume.slope * volume.data.astype(np.float64) + volume.intercept


def at(volume, x, y, z):
    """Attenuation in the voxel around a point, mm."""
    index = [int((c - o) / s) for c, o, s in zip((x, y, z), volume.grid.corner, volume.grid.spacing, strict=True)]
    return volume.slope * float(volume.data[index[2], index[1], index[0]]) + volume.intercept


def value_at_centre(geometry, axes, mu, y, z):
    """Filtered back-projection at the centre of an elliptic cylinder along x, semi-axes a (y) and b (z).

    A parallel view inclined by t, ramp filtered, is mu a b / (pi (a^2 cos^2 t + b^2 sin^2 t)) all over the cylinder;
    the integral over the inclinations t that the centre is seen at is mu / pi atan(b / a tan t).
    """
    a, b = axes
    half_step = np.deg2rad(abs(geometry.angles[1] - geometry.angles[0])) / 2
    ends = np.deg2rad([geometry.angles[0], geometry.angles[-1]]) + np.array([-half_step, half_step])
    radius = geometry.source_to_detector - geometry.isocenter_height
    tangent = (radius * np.sin(ends) - y) / (geometry.isocenter_height + radius * np.cos(ends) - z)
    return mu / np.pi * np.ptp(np.arctan(b / a * tangent))


@pytest.mark.parametrize(
    ("angular_range", "views", "axes", "centre", "part"),
    [
        (40.0, 15, (30.0, 12.0), (0.5, 40.5), 0.1),  # the paper's range: most of a flat object is lost
        (40.0, 15, (30.0, 12.0), (0.5, 65.5), 0.1),  # not at the pivot
        (80.0, 41, (12.0, 12.0), (-20.5, 32.5), 0.45),  # to the side
        (110.0, 61, (6.0, 18.0), (0.5, 40.5), 0.86),  # upright and seen widely: close to the true value
    ],
)
def test_value_at_the_centre_of_a_cylinder(make_geometry, acquire, angular_range, views, axes, centre, part):
    mu = 0.02
    geometry = make_geometry(ny=500, nx=12, pixel=1.0, views=views, angular_range=angular_range)
    spec = FINE.with_(value_slope=4e-7, value_intercept=-0.005, slice_thickness_filter=False)
    volume = reconstruct(acquire(geometry, [((0.0, *centre), (1e5, *axes), mu)]), spec, 50.0)
    expected = value_at_centre(geometry, axes, mu, *centre)
    assert expected / mu == pytest.approx(part, abs=0.03)
    assert at(volume, 5.5, *centre) == pytest.approx(expected, rel=3e-3)


def test_beads_lie_where_they_are(make_geometry, acquire):
    beads = [(6.13, -18.4, 26.3), (14.86, 2.27, 31.5), (20.4, 21.55, 38.4)]
    geometry = make_geometry(ny=400, nx=130, pixel=0.2)
    stack = acquire(geometry, [(bead, (0.4, 0.4, 0.4), 0.5) for bead in beads])
    volume = reconstruct(stack, FilteredBackprojection(), 25.0)
    values = attenuation(volume)
    x, y, z = (volume.grid.centres(axis) for axis in "xyz")
    for bead in beads:
        slice_index = int(np.argmin(np.abs(z - bead[2])))
        near_y, near_x = np.abs(y - bead[1]) < 1.0, np.abs(x - bead[0]) < 1.0
        through = values[:, near_y][:, :, near_x].max(axis=(1, 2))
        assert abs(z[np.argmax(through)] - bead[2]) <= 1.0
        patch = np.maximum(values[slice_index][np.ix_(near_y, near_x)], 0.0) ** 2
        assert np.sum(patch.sum(axis=1) * y[near_y]) / patch.sum() == pytest.approx(bead[1], abs=0.05)
        assert np.sum(patch.sum(axis=0) * x[near_x]) / patch.sum() == pytest.approx(bead[0], abs=0.05)


def test_slice_thickness_filter_lowers_the_peak_of_a_bead(make_geometry, acquire):
    geometry = make_geometry(ny=300, nx=30, pixel=0.2)
    stack = acquire(geometry, [((3.0, 0.0, 32.5), (0.3, 0.3, 0.3), 0.5)])
    peaks = []
    for spec in (FilteredBackprojection(slice_thickness_filter=False), FilteredBackprojection(slice_mm=1.0)):
        values = attenuation(reconstruct(stack, spec, 25.0))
        peaks.append(values[12].max())
    assert 0.0 < peaks[1] < 0.8 * peaks[0]


def test_a_turning_detector_gives_the_same_volume(make_geometry, acquire):
    ellipsoids = [((8.0, -4.0, 32.0), (5.0, 9.0, 6.0), 0.02), ((12.3, 14.2, 30.5), (1.0, 1.0, 1.0), 0.2)]
    still = reconstruct(acquire(make_geometry(pixel=0.4, nx=60, ny=300), ellipsoids), FINE, 20.0)
    turned = reconstruct(acquire(make_geometry(pixel=0.4, nx=60, ny=300, detector_range=20.0), ellipsoids), FINE, 20.0)
    difference = attenuation(turned) - attenuation(still)
    scale = attenuation(still).max()
    # Interpolating twice smooths edges a little; nothing may move or change its value.
    assert np.sqrt(np.mean(difference**2)) < 0.01 * scale
    assert np.abs(difference).max() < 0.35 * scale
    assert at(turned, 8.0, -4.0, 32.0) == pytest.approx(at(still, 8.0, -4.0, 32.0), rel=0.02)


def test_size_of_the_detector_changes_nothing_where_all_views_see(make_geometry, acquire):
    """An object that nearly touches the edge: nothing wraps round in the filter, nothing is clamped."""
    edge = ((10.0, 25.0, 32.0), (6.0, 5.0, 5.0), 0.02)
    small, large = (
        reconstruct(acquire(make_geometry(ny=ny, nx=40, angular_range=30.0), [edge]), FINE, 20.0) for ny in (180, 320)
    )
    # At z = 40 mm rays shift by 40 tan(15 degrees) = 11 mm at most: |y| < 32 mm is seen by all views.
    seen = np.abs(small.grid.centres("y")) < 32.0
    first, second = attenuation(small)[:, seen], attenuation(large)[:, 70:250][:, seen]
    assert second.max() > 1e-3
    assert np.abs(first - second).max() < 3e-6
    # The first view, tube at -y, sees the object shifted to +y: beyond it, no view leaves a copy of its last row.
    assert np.abs(attenuation(small)[-1, -2:]).max() < 0.2 * second.max()


def test_value_does_not_change_along_a_cylinder(make_geometry, acquire):
    """Far from the plane of the tube as well: rays are longer there, and weighted less (Feldkamp)."""
    geometry = make_geometry(ny=240, nx=150, pixel=1.0, views=41, angular_range=80.0, source_to_detector=300.0)
    stack = acquire(geometry, [((0.0, 0.5, 42.0), (1e5, 12.0, 12.0), 0.02)])
    spec = FINE.with_(slice_mm=4.0, slice_thickness_filter=False)
    values = attenuation(reconstruct(stack, spec, 40.0))[5, 120]
    assert values[[1, 60, 120]] == pytest.approx(value_at_centre(geometry, (12.0, 12.0), 0.02, 0.5, 42.0), rel=2e-3)


def test_views_count_by_the_angle_they_stand_for(make_geometry, acquire):
    """Twice as many views on one side change no value inside."""
    dense = make_geometry(ny=500, nx=8, pixel=1.0, views=37, angular_range=110.0)
    kept = np.array([k for k in range(37) if k >= 18 or k % 2 == 0])
    sparse = AcquisitionGeometry(
        **{
            **vars(dense),
            "angles": dense.angles[kept],
            "sources": dense.sources[kept],
            "detector_angles": dense.detector_angles[kept],
        }
    )
    ellipsoids = [((0.0, 0.0, 40.0), (1e5, 12.0, 18.0), 0.02)]
    first, second = (reconstruct(acquire(g, ellipsoids), FINE, 40.0) for g in (dense, sparse))
    wider = (
        np.deg2rad(110.0 / 36) / 2 * 0.02 / np.pi * 12 * 18 / (12**2 * np.cos(0.96) ** 2 + 18**2 * np.sin(0.96) ** 2)
    )
    # The first view of the sparse half stands for half a wide step beyond its angle.
    assert at(second, 4.5, 0.5, 40.0) == pytest.approx(at(first, 4.5, 0.5, 40.0) + wider, rel=0.01)


def test_grid_of_slices(make_geometry):
    geometry = make_geometry(ny=200, nx=80, pixel=0.5)
    grid = volume_grid(geometry, FilteredBackprojection(slice_mm=0.1), Body(60.0))
    assert grid.shape == (600, 200, 80)
    grid = volume_grid(geometry, FilteredBackprojection(), Body(60.2))
    assert grid.shape == (61, 200, 80)
    assert grid.centres("z")[0] == pytest.approx(20.5)
    assert grid.corner == (0.0, -50.0, 20.0)
    np.testing.assert_allclose(grid.centres("x"), geometry.detector.x_centres())
    np.testing.assert_allclose(grid.centres("y"), geometry.detector.y_centres(), atol=1e-12)
    coarse = volume_grid(geometry, FilteredBackprojection(pixel_mm=0.7), Body(60.0))
    assert coarse.shape == (60, 143, 58)
    assert coarse.corner == (0.0, pytest.approx(-143 * 0.35), 20.0)


def test_another_pixel_samples_the_same_volume(make_geometry, acquire):
    """Voxels are samples at their centres; those of three times the edge are every third of the others."""
    stack = acquire(make_geometry(ny=201, nx=81), [((0.0, 3.0, 32.0), (25.0, 18.0, 9.0), 0.02)])
    fine, coarse = (reconstruct(stack, FINE.with_(pixel_mm=pixel), 20.0) for pixel in (None, 1.5))
    assert coarse.data.shape == (20, 67, 27)
    np.testing.assert_allclose(fine.grid.centres("x")[1::3], coarse.grid.centres("x"))
    np.testing.assert_allclose(fine.grid.centres("y")[1::3], coarse.grid.centres("y"), atol=1e-12)
    np.testing.assert_allclose(attenuation(coarse), attenuation(fine)[:, 1::3, 1::3], atol=1.5e-6)
    assert np.ptp(attenuation(coarse)) > 1e-3  # there is something to see


def test_stored_values_follow_slope_and_intercept(make_geometry, acquire):
    stack = acquire(make_geometry(), [((0.0, 0.0, 32.0), (25.0, 18.0, 9.0), 0.02)])
    fine = reconstruct(stack, FINE, 20.0)
    coarse = reconstruct(stack, FINE.with_(value_slope=2.5e-5, value_intercept=-0.05), 20.0)
    assert coarse.slope == 2.5e-5
    assert fine.report["clipped_voxels"] == coarse.report["clipped_voxels"] == 0
    assert np.abs(attenuation(fine) - attenuation(coarse)).max() <= 0.5 * (1e-6 + 2.5e-5) * 1.01

    cut = reconstruct(stack, FINE.with_(value_intercept=0.0, value_slope=1e-8), 20.0)
    reference = attenuation(fine)
    assert cut.report["clipped_low_voxels"] == pytest.approx((reference < 0).sum(), rel=0.05)
    assert cut.report["clipped_high_voxels"] == pytest.approx((reference > 65535e-8).sum(), rel=0.05)
    assert np.all(cut.data[reference < -1e-5] == 0)
    assert np.all(cut.data[reference > 0.001] == 65535)


def test_any_number_of_threads_gives_the_same_bytes(make_geometry, acquire, threads):
    stack = acquire(make_geometry(), [((0.0, 0.0, 32.0), (25.0, 18.0, 9.0), 0.02)])
    volumes = []
    for count in (1, 2):
        threads(count)
        volumes.append(reconstruct(stack, FINE, 20.0).data.tobytes())
    assert volumes[0] == volumes[1]


def test_views_in_another_order_give_the_same_volume(make_geometry, acquire):
    geometry = make_geometry(views=6)
    stack = acquire(geometry, [((0.0, 4.0, 32.0), (25.0, 18.0, 9.0), 0.02)])
    order = np.array([3, 0, 5, 1, 4, 2])
    shuffled = type(stack)(
        stack.data[order],
        stack.open_field,
        type(geometry)(
            **{
                **vars(geometry),
                "angles": geometry.angles[order],
                "sources": geometry.sources[order],
                "detector_angles": geometry.detector_angles[order],
            }
        ),
    )
    first, second = (reconstruct(s, FINE, 20.0).data.astype(int) for s in (stack, shuffled))
    assert np.abs(first - second).max() <= 1


def test_what_cannot_be_reconstructed_is_refused(make_geometry, acquire):
    one = acquire(make_geometry(views=1), [])
    with pytest.raises(GeometryError, match=r"1 view"):
        reconstruct(one, FINE, 20.0)
    stack = acquire(make_geometry(ny=16, nx=16), [])
    with pytest.raises(GeometryError, match=r"thickness.* -3"):
        reconstruct(stack, FINE, -3.0)
    with pytest.raises(GeometryError, match=r"source"):
        reconstruct(stack, FINE.with_(slice_mm=20.0), 640.0)


def test_progress_is_told_and_may_cancel(make_geometry, acquire):
    stack = acquire(make_geometry(ny=64, nx=32), [])
    fractions = []
    reconstruct(stack, FINE, 10.0, lambda fraction, message: fractions.append(fraction))
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0

    def stop(fraction, message):
        if fraction > 0.5:
            raise Cancelled("enough")

    with pytest.raises(Cancelled):
        reconstruct(stack, FINE, 10.0, stop)


def test_empty_field_is_exactly_zero(make_geometry, acquire):
    volume = reconstruct(acquire(make_geometry(ny=64, nx=32), []), FilteredBackprojection(), 10.0)
    assert np.all(volume.data == 20000)
