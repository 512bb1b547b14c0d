"""Iterative reconstructions: what each converges to, its guarantees, subsets, start, end, memory of thread counts."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.artifacts import ProjectionStack
from simcore.core.errors import Cancelled, GeometryError
from simcore.core.grid import Grid
from simcore.reconstruction import FilteredBackprojection, reconstruct
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.grids import breast_grid
from simcore.reconstruction.methods.algebraic import algebraic_correction
from simcore.reconstruction.methods.iterative import Measurement, measure, subsets_of
from simcore.reconstruction.methods.subsets import subset_sums, view_sums
from simcore.reconstruction.operators.crossings import backproject, crossings_of, project_slices
from simcore.reconstruction.operators.total_variation import denoise_slices
from simcore.reconstruction.spec import Backprojection, MaximumLikelihood, RegionSpec, Sart, Sirt

BREAST = ((0.0, 2.0, 30.0), (24.0, 18.0, 9.0), 0.02)
BEAD = ((8.0, -4.0, 34.0), (2.0, 2.0, 2.0), 0.05)
COARSE = {"pixel_mm": 1.0, "slice_mm": 2.0, "value_slope": 2e-6, "value_intercept": -0.01}


def attenuation(volume):
    return volume.slope * volume.data.astype(np.float64) + volume.intercept


@pytest.fixture(scope="module")
def geometry(make_geometry):
    return make_geometry(ny=72, nx=44, pixel=1.0, views=9)


@pytest.fixture(scope="module")
def stack(geometry, acquire):
    return acquire(geometry, [BREAST, BEAD])


def consistent(geometry, thickness=20.0, slice_mm=4.0):
    """A measurement that a volume on the very same grid has made, and that volume."""
    grid = volume_grid(geometry, Sart(slice_mm=slice_mm), Body(thickness))
    z, y, x = np.meshgrid(*(grid.centres(axis) for axis in "zyx"), indexing="ij", sparse=True)
    inside = (x / 24) ** 2 + (y / 18) ** 2 + ((z - 30) / 11) ** 2 < 1
    volume = (inside * (0.02 + 0.01 * (np.hypot(x - 8, y + 4) < 3))).astype(np.float32)
    return Measurement(project_slices(volume, grid, geometry), crossings_of(grid, geometry)), volume


GRIDS = {
    "inside": Grid((4, 30, 20), (0.9, 1.1, 3.0), (0.0, -14.0, 20.0)),
    "larger than the detector": Grid((3, 60, 40), (2.1, 2.2, 5.0), (-8.0, -60.0, 5.0)),
    "fine": Grid((3, 50, 60), (0.3, 0.2, 2.0), (5.0, -3.0, 0.0)),
}


@pytest.mark.parametrize("name", GRIDS)
def test_products_of_sums_are_row_and_column_sums(geometry, name):
    grid = GRIDS[name]
    crossings = crossings_of(grid, geometry)
    ones = np.ones(grid.shape, np.float32)
    rows = np.empty((geometry.detector.ny, geometry.detector.nx), np.float32)
    for view in range(geometry.views):
        crossings.project(ones, view, rows)
        sums = view_sums(crossings, view)
        np.testing.assert_allclose(np.einsum("zj,zi->ji", sums.along_y, sums.along_x), rows, atol=1e-4)
        length = sums.lengths
        np.testing.assert_allclose(
            length[2] * np.sqrt(1 + length[0][:, None] + length[1]),
            crossings.ray_lengths(view),
            rtol=1e-6,
        )
    views = np.array([0, 3, 8])
    subset = subset_sums(crossings, views)
    assert subset.along_x.shape[0] == 2  # views 0 and 8 share their height
    unit = np.stack([1.0 / crossings.ray_lengths(view) for view in range(geometry.views)])
    unit[[v for v in range(geometry.views) if v not in views]] = 0
    expected = backproject(unit.astype(np.float32), grid, geometry)
    np.testing.assert_allclose(np.einsum("gzy,gzx->zyx", subset.along_y, subset.along_x), expected, atol=1e-3)


def test_sart_reproduces_consistent_projections(geometry):
    measurement, truth = consistent(geometry)
    correct = algebraic_correction(measurement, 1.0, True)
    volume = np.zeros_like(truth)
    for _ in range(30):
        for subset in subsets_of(geometry.angles, 1):
            correct(volume, subset)
    again = project_slices(volume, measurement.grid, geometry)
    assert np.sqrt(np.mean((again - measurement.integrals) ** 2)) < 2e-3 * measurement.integrals.max()
    assert volume.min() >= 0.0
    # A volume that fits the data already is left alone.
    before = truth.copy()
    for subset in subsets_of(geometry.angles, 3):
        assert correct(before, subset) < 1e-9
    np.testing.assert_allclose(before, truth, atol=1e-6)


@pytest.mark.parametrize("relaxation", [0.3, 1.0, 1.9])
@pytest.mark.parametrize("non_negative", [True, False])
def test_misfit_of_sirt_never_rises(stack, relaxation, non_negative):
    spec = Sirt(iterations=12, relaxation=relaxation, non_negative=non_negative, **COARSE)
    misfit = np.array(reconstruct(stack, spec, 20.0).report["misfit"])
    assert len(misfit) == 12
    assert np.all(np.diff(misfit) < 0)
    assert misfit[-1] < 0.1 * misfit[0]


def test_sirt_step_is_that_of_its_formula(geometry):
    """One step from a random volume, against A written out with the public operator pair."""
    measurement, truth = consistent(geometry)
    grid, shape = measurement.grid, truth.shape
    start = np.random.default_rng(4).random(shape, np.float32) * np.float32(0.02)
    stepped = start.copy()
    views = np.arange(geometry.views)
    misfit = algebraic_correction(measurement, 0.7, False)(stepped, views)
    length = np.stack([crossings_of(grid, geometry).ray_lengths(view) for view in views]).astype(np.float64)

    def forward(volume):
        return project_slices(volume.astype(np.float32), grid, geometry) / length

    def back(rays):
        return backproject((rays / length).astype(np.float32), grid, geometry).astype(np.float64)

    rows, columns = forward(np.ones(shape)), back(np.ones_like(length))
    residual = measurement.integrals / length - forward(start)
    seen = rows > 1e-3
    shares = np.where(seen, residual / np.where(seen, rows, 1), 0)
    expected = start + 0.7 * np.where(columns > 1e-3, back(shares) / np.maximum(columns, 1e-3), 0)
    np.testing.assert_allclose(stepped, expected, atol=2e-6)
    assert misfit == pytest.approx(np.sum(shares * residual * seen), rel=1e-4)


def test_likelihood_never_falls(stack):
    spec = MaximumLikelihood(iterations=15, **COARSE)
    distance = np.array(reconstruct(stack, spec, 20.0).report["misfit"])
    assert np.all(np.diff(distance) < 0)
    assert 0 < distance[-1] < 0.02 * distance[0]
    subsets = reconstruct(stack, spec.with_(iterations=5, views_per_subset=2), 20.0)
    assert subsets.report["subsets"] == 5
    assert subsets.report["misfit"][-1] < distance[10]


@pytest.mark.parametrize(
    "spec",
    [
        Sart(iterations=5, **COARSE),
        Sart(iterations=8, views_per_subset=3, relaxation=1.0, **COARSE),
        Sirt(iterations=40, relaxation=1.8, start="backprojection", **COARSE),
        MaximumLikelihood(iterations=10, views_per_subset=2, **COARSE),
    ],
    ids=["sart", "os-sart", "sirt", "ml"],
)
def test_an_object_comes_out_with_its_attenuation(stack, spec):
    volume = reconstruct(stack, spec, 20.0)
    values = attenuation(volume)
    z, y, x = np.meshgrid(*(volume.grid.centres(axis) for axis in "zyx"), indexing="ij")
    bead = (x - 8) ** 2 + (y + 4) ** 2 + (z - 34) ** 2 < 2.5
    level = (x - 8) ** 2 + (y + 4) ** 2 + (z - 26) ** 2 < 2.5
    assert values[bead].mean() > values[level].mean() + 0.006
    assert np.all(values[np.abs(y - 2) > 22] == 0.0)
    # A limited angle says little of where in depth attenuation lies, but how much there is.
    x, y = x[0], y[0]
    radius = np.hypot(x / 24, (y - 2) / 18)
    core = (radius < 0.8) & (np.hypot(x - 8, y + 4) > 5)
    ratio = values.sum(axis=0)[core] * 2.0 / (0.02 * 18 * np.sqrt(1 - radius[core] ** 2))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)
    assert np.abs(ratio - 1).max() < 0.1
    # Sums along y, x and z: the amount of attenuation is right.
    assert values.sum() * volume.grid.voxel_volume == pytest.approx(
        0.02 * 2 / 3 * np.pi * 24 * 18 * 9 + 0.05 * 4 / 3 * np.pi * 8, rel=0.02
    )


def test_a_start_near_the_result_needs_fewer_iterations(stack):
    cold = reconstruct(stack, Sirt(iterations=6, **COARSE), 20.0).report["misfit"]
    plain = reconstruct(stack, Sirt(iterations=6, start="backprojection", **COARSE), 20.0).report["misfit"]
    filtered = reconstruct(stack, Sirt(iterations=6, start="fbp", **COARSE), 20.0).report["misfit"]
    assert plain[0] < 0.05 * cold[0]
    assert plain[-1] < cold[-1]
    assert filtered[0] < cold[0]
    assert filtered[-1] < cold[-1]


def test_tolerance_ends_the_iteration(stack):
    report = reconstruct(stack, Sirt(iterations=200, tolerance=0.1, **COARSE), 20.0).report
    misfit = report["misfit"]
    assert report["ended_by"] == "tolerance"
    assert 3 < report["iterations"] == len(misfit) < 60
    assert abs(misfit[-2] - misfit[-1]) < 0.1 * misfit[-2]
    assert abs(misfit[-3] - misfit[-2]) >= 0.1 * misfit[-3]
    assert reconstruct(stack, Sirt(iterations=2, **COARSE), 20.0).report["ended_by"] == "iterations"


def test_total_variation_lowers_noise_and_keeps_edges(geometry, acquire):
    clean = acquire(geometry, [BREAST])
    noise = np.random.default_rng(8).normal(0, 600, clean.data.shape)
    noisy = ProjectionStack(np.clip(np.rint(clean.data + noise), 1, 60000).astype(np.uint16), 60000.0, geometry)
    inside = np.s_[4:6, 30:46, 3:16]
    left = []
    for strength in (0.0, 2e-3):
        spec = Sart(iterations=3, total_variation=strength, **COARSE)
        with_noise, without = (attenuation(reconstruct(s, spec, 20.0))[inside] for s in (noisy, clean))
        left.append((with_noise - without).var())
        assert with_noise.mean() == pytest.approx(without.mean(), rel=0.03)
    assert left[0] > 4 * left[1]


def test_denoising_of_a_disk_is_its_closed_form():
    """Of a disk of radius R and height h, total variation takes 2 strength / R (D. Strong, T. Chan, Inverse Problems
    19 (2003) S165), and no mean."""
    y, x = np.mgrid[:128, :128] - 63.5
    inside = np.hypot(y, x) < 30
    volume = np.stack([inside, 2.0 * inside]).astype(np.float32)
    denoise_slices(volume, 1.5, 1500)
    core = np.hypot(y, x) < 24
    for height, result in zip((1.0, 2.0), volume, strict=True):
        assert result[core].mean() == pytest.approx(height - 2 * 1.5 / 30, abs=0.006)
        assert result.mean() == pytest.approx(height * inside.mean(), rel=1e-4)


def test_subsets_hold_every_view_once_and_spread():
    angles = np.array([3.0, -3.0, 1.0, -1.0, 2.0, -2.0, 0.0])
    for size in (1, 2, 3, 7, 50):
        subsets = subsets_of(angles, size)
        assert sorted(np.concatenate(subsets)) == list(range(7))
        assert max(len(s) for s in subsets) <= max(size, 1)
    assert len(subsets_of(angles, 3)) == 3
    first = [angles[s][0] for s in subsets_of(angles, 1)]
    assert min(np.abs(np.diff(first))) >= 2


def test_region_is_cut_out_of_the_same_volume(stack):
    spec = Sart(iterations=2, **COARSE)
    whole = reconstruct(stack, spec, 20.0)
    region = RegionSpec(x_min_mm=4.0, x_max_mm=12.0, y_max_mm=6.0, z_min_mm=4.0)
    part = reconstruct(stack, spec.with_(region=region), 20.0)
    assert part.data.shape == (8, 42, 8)
    np.testing.assert_array_equal(part.data, whole.data[2:, :42, 4:12])
    breast = reconstruct(stack, spec.with_(field="breast"), 20.0)
    assert breast.grid == breast_grid(stack, whole.grid)
    assert breast.data.size < 0.6 * whole.data.size


def test_coarse_voxels_average_pixels(make_geometry, acquire):
    fine = make_geometry(ny=144, nx=88, pixel=0.5, views=9)
    stack = acquire(fine, [BREAST, BEAD])
    grid = breast_grid(stack, volume_grid(fine, Sart(**COARSE), Body(20.0)))
    measurement = measure(stack, grid)
    detector = measurement.geometry.detector
    assert (detector.ny, detector.pixel) == (72, 1.0)
    assert detector.nx < 44  # columns that no voxel meets are left out
    pixels = -np.log(stack.data / 60000.0)[:, :, : 2 * detector.nx]
    expected = pixels.reshape(9, 72, 2, detector.nx, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(measurement.integrals, expected, atol=1e-6)


def test_a_turned_detector_gives_the_same_volume(make_geometry, acquire):
    specs = (Sart(iterations=3, **COARSE), MaximumLikelihood(iterations=3, views_per_subset=1, **COARSE))
    stacks = [
        acquire(make_geometry(ny=144, nx=88, pixel=0.5, views=9, detector_range=turn), [BREAST]) for turn in (0.0, 20.0)
    ]
    for spec in specs:
        still, turned = (attenuation(reconstruct(stack, spec, 20.0)) for stack in stacks)
        assert np.sqrt(np.mean((turned - still) ** 2)) < 0.02 * still.max()
    # Rays that miss the turned detector are not taken for empty ones.
    narrow = acquire(make_geometry(ny=80, nx=60, pixel=0.5, views=9, detector_range=40.0), [BREAST])
    integrals = measure(narrow, volume_grid(narrow.geometry, specs[0], Body(20.0))).integrals
    assert 0.001 < np.isnan(integrals).mean() < 0.2
    assert np.isfinite(reconstruct(narrow, specs[0], 20.0).report["misfit"]).all()


@pytest.mark.parametrize(
    "spec",
    [
        FilteredBackprojection(filter="hamming", field="breast", breast_edge="flatten"),
        Backprojection(method="shift-and-add"),
        Sart(iterations=2, total_variation=1e-3, **COARSE),
        Sirt(iterations=2, start="fbp", **COARSE),
        MaximumLikelihood(iterations=2, views_per_subset=4, **COARSE),
    ],
    ids=lambda spec: spec.kind,
)
def test_threads_change_no_byte_and_progress_is_told(stack, spec, threads):
    results, fractions = [], []
    for count in (1, 2):
        threads(count)
        fractions.clear()
        volume = reconstruct(stack, spec, 20.0, lambda fraction, message: fractions.append(fraction))
        results.append((volume.data.tobytes(), volume.report))
    assert results[0] == results[1]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert volume.data.max() > volume.data.min()

    def stop(fraction, message):
        if fraction > 0.3:
            raise Cancelled("enough")

    with pytest.raises(Cancelled):
        reconstruct(stack, spec, 20.0, stop)


def test_what_cannot_be_reconstructed_is_refused(make_geometry, acquire):
    one = acquire(make_geometry(ny=16, nx=16, views=1), [])
    for spec in (Sart(), Sirt(), MaximumLikelihood(), Backprojection()):
        with pytest.raises(GeometryError, match="1 view"):
            reconstruct(one, spec, 20.0)


def test_nothing_in_the_beam_stays_nothing(make_geometry, acquire):
    empty = acquire(make_geometry(ny=24, nx=16, pixel=2.0, views=3), [])
    for spec in (Sart(iterations=1), Sirt(iterations=2), MaximumLikelihood(iterations=2)):
        assert np.all(reconstruct(empty, spec, 8.0).data == 20000)
