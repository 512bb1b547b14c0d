"""Line integrals: closed forms, plane-prefix against rays in double precision, moved scenes, threads."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.projection import geometry_of
from simcore.projection.integrals import line_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.rays import project_rays
from simcore.projection.spec import AcquisitionSpec, DetectorSpec

MU = attenuation_table("johns-yaffe-20keV")
ALL_DIFFERENT = np.linspace(0.0, 0.15, MAX_TISSUES)


def phantom_of(labels, spacing=(2.0, 2.0, 2.0), x=0.0):
    ny = labels.shape[1]
    return Phantom(labels, Grid(labels.shape, spacing, (x, -ny * spacing[1] / 2, 0.0)))


def acquisition(**changes):
    detector = DetectorSpec(pixels_y=150, pixels_x=130, pixel_mm=1.1)
    return AcquisitionSpec(detector=detector, views=3, truncation="allow").with_(**changes)


def random_labels(seed=0, shape=(30, 60, 50), tissues=10):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, tissues, shape).astype(np.uint8)
    labels[:, :7] = 0
    labels[:, 33] = 0
    labels[:, :, 40:] = 0
    labels[4:6] = 0
    labels[:, 20:24, 10:] = 0
    return labels


def by_rays(phantom, geometry, view, mu, dtype=np.float64):
    out = np.empty((geometry.detector.ny, geometry.detector.nx), dtype)
    project_rays(phantom.labels, phantom.grid.moved(z=geometry.support_height), geometry, view, mu, out=out)
    return out


def chords_of_box(geometry, view, low, high):
    """Length of every ray inside a box, by clipping: independent of the voxels."""
    detector = geometry.detector
    j, i = np.mgrid[: detector.ny, : detector.nx]
    origin, row = geometry.detector_frame(view)
    pixel = origin + np.stack([(i + 0.5) * detector.pixel, 0 * i, 0 * i], -1)
    pixel = pixel + ((j - (detector.ny - 1) / 2) * detector.pixel)[..., None] * row
    ray = pixel - geometry.sources[view]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.stack([(low - geometry.sources[view]) / ray, (high - geometry.sources[view]) / ray])
    enter, leave = t.min(0).max(-1).clip(0, 1), t.max(0).min(-1).clip(0, 1)
    return (leave - enter).clip(0) * np.linalg.norm(ray, axis=-1)


@pytest.mark.parametrize("detector_range", [0.0, 8.0])
@pytest.mark.parametrize("view", [0, 1, 2])
def test_box_chords(view, detector_range):
    labels = np.zeros((30, 60, 50), np.uint8)
    labels[3:21, 12:50, 0:31] = Tissue.GLAND
    phantom = phantom_of(labels)
    geometry = geometry_of(acquisition(detector_range_degrees=detector_range))
    low = np.array([-1e-9, -60.0 + 24.0, 20.0 + 6.0])
    high = np.array([62.0, -60.0 + 100.0, 20.0 + 42.0])
    expected = chords_of_box(geometry, view, low, high) * MU[Tissue.GLAND]
    values = line_integrals(phantom, geometry, view, MU)
    assert expected.max() > 2.5
    assert np.abs(values - expected).max() < 2e-5
    assert np.abs(by_rays(phantom, geometry, view, MU) - expected).max() < 1e-11


def error_of_sphere(spacing):
    """rms error of the integrals through a voxelised ball of 20 mm, and the relative error of their sum."""
    radius, cells = 20.0, round(50.0 / spacing)
    at = (np.arange(cells) + 0.5) * spacing - 25.0
    inside = at**2 + at[:, None] ** 2 + at[:, None, None] ** 2 <= radius**2
    phantom = phantom_of(np.where(inside, Tissue.GLAND, 0).astype(np.uint8), (spacing,) * 3)
    geometry = geometry_of(acquisition(detector=DetectorSpec(pixels_y=110, pixels_x=110, pixel_mm=0.7)))
    detector, source = geometry.detector, geometry.sources[0]
    pixels = np.stack(np.broadcast_arrays(detector.x_centres(), detector.y_centres()[:, None], np.zeros((110, 1))), -1)
    ray = (pixels - source) / np.linalg.norm(pixels - source, axis=-1, keepdims=True)
    to_centre = np.array([25.0, 0.0, 45.0]) - source
    distance2 = to_centre @ to_centre - (ray @ to_centre) ** 2
    expected = 2 * np.sqrt((radius**2 - distance2).clip(0)) * MU[Tissue.GLAND]
    values = line_integrals(phantom, geometry, 0, MU)
    return np.sqrt(np.mean((values - expected) ** 2)), values.sum() / expected.sum() - 1


def test_sphere_chords():
    """What differs from the closed form is the staircase of the voxels: proportional to their edge."""
    coarse, fine = error_of_sphere(1.0), error_of_sphere(0.5)
    assert fine[0] < 0.6 * coarse[0]
    assert fine[0] < 0.5 * 0.5 * MU[Tissue.GLAND]
    assert abs(fine[1]) < 1e-3


@pytest.mark.parametrize(
    ("angular_range", "detector_range", "spacing", "x"),
    [(40.0, 0.0, (2.0, 2.0, 2.0), 0.0), (110.0, 0.0, (1.5, 1.3, 2.1), 0.0), (40.0, 9.0, (2.0, 2.0, 2.0), 0.0),
     (15.0, 4.0, (1.7, 2.2, 1.1), 5.0), (30.0, 0.0, (2.0, 1.0, 1.5), -11.0)],
)  # fmt: skip
def test_plane_prefix_is_siddon(angular_range, detector_range, spacing, x):
    phantom = phantom_of(random_labels(), spacing, x)
    geometry = geometry_of(acquisition(angular_range_degrees=angular_range, detector_range_degrees=detector_range))
    for view in range(3):
        values = line_integrals(phantom, geometry, view, ALL_DIFFERENT)
        expected = by_rays(phantom, geometry, view, ALL_DIFFERENT)
        assert expected.max() > 1.5
        error = values - expected
        assert np.sqrt(np.mean(error**2)) < 2e-6 * expected.max()
        assert np.abs(error).max() < 1e-5 * expected.max()


@pytest.mark.parametrize("columns", [40, 300])
def test_paths_that_meet_many_columns_in_a_slice(columns):
    labels = np.random.default_rng(4).integers(0, 10, (4, columns, 12)).astype(np.uint8)
    phantom = phantom_of(labels, (2.0, 24.0 / columns, 12.0))
    geometry = geometry_of(acquisition(angular_range_degrees=118.0))
    for view in range(3):
        values = line_integrals(phantom, geometry, view, ALL_DIFFERENT)
        np.testing.assert_allclose(values, by_rays(phantom, geometry, view, ALL_DIFFERENT), atol=2e-5)
        assert values.max() > 1.0


def test_rays_through_voxel_corners():
    """Pixels as wide as voxels on the detector: many rays run exactly along or through voxel boundaries."""
    labels = np.random.default_rng(3).integers(0, 4, (16, 32, 24)).astype(np.uint8)
    phantom = phantom_of(labels, (1.0, 1.0, 1.0))
    sources = np.array([[0.0, 0.0, 64.0], [0.0, 16.0, 64.0], [0.0, -40.0, 64.0]])
    geometry = AcquisitionGeometry(
        angles=np.zeros(3), sources=sources, detector=Detector(64, 48, 1.0), detector_angles=np.zeros(3),
        isocenter_height=0.0, source_to_detector=64.0, support_height=0.0,
    )  # fmt: skip
    for view in range(3):
        values = line_integrals(phantom, geometry, view, MU)
        # A ray within a boundary may count either side: compare with rays moved by a hair to each side.
        hair = 1e-7
        sides = []
        for side in (-hair, hair):
            moved = Phantom(phantom.labels, phantom.grid.moved(x=side, y=side))
            sides.append(by_rays(moved, geometry, view, MU))
            moved = Phantom(phantom.labels, phantom.grid.moved(x=side, y=-side))
            sides.append(by_rays(moved, geometry, view, MU))
        nearest = np.min([np.abs(values - side) for side in sides], axis=0)
        # Rays with several coincidences may mix sides; all others must agree with one.
        assert np.mean(nearest < 1e-5) > 0.97
        assert (values <= np.max(sides, axis=0) + 0.5).all()


def test_phantom_outside_the_beam_and_empty():
    geometry = geometry_of(acquisition())
    empty = phantom_of(np.zeros((4, 6, 5), np.uint8))
    assert not line_integrals(empty, geometry, 0, MU).any()
    aside = Phantom(np.full((4, 6, 5), 2, np.uint8), Grid((4, 6, 5), (2.0, 2.0, 2.0), (0.0, 400.0, 0.0)))
    assert not line_integrals(aside, geometry, 1, MU).any()


def test_chest_wall_column_is_full():
    """The first pixel column looks along the chest wall through the whole breast."""
    phantom = phantom_of(np.full((30, 60, 50), Tissue.GLAND, np.uint8))
    geometry = geometry_of(acquisition(views=1))
    values = line_integrals(phantom, geometry, 0, MU)
    assert values[75, 0] == pytest.approx(60.0 * MU[Tissue.GLAND], rel=1e-5)


def smooth_ball(cells, size=24.0):
    """A ball of half-density layers: labels are levels of a smooth function, mu their value."""
    centre = (np.arange(cells) + 0.5) * size / cells - size / 2
    radius2 = centre**2 + centre[:, None] ** 2 + centre[:, None, None] ** 2
    level = np.rint(15 * np.clip(1 - radius2 / 11.0**2, 0, 1) ** 2).astype(np.uint8)
    return phantom_of(level, (size / cells,) * 3)


def test_trilinear_converges_to_exact():
    geometry = geometry_of(acquisition(detector=DetectorSpec(pixels_y=40, pixels_x=40, pixel_mm=1.0)))
    errors = []
    for cells in (12, 24, 48):
        phantom = smooth_ball(cells)
        exact = line_integrals(phantom, geometry, 2, ALL_DIFFERENT)
        sampled = line_integrals(phantom, geometry, 2, ALL_DIFFERENT, sampling="trilinear", step_voxels=0.2)
        errors.append(np.sqrt(np.mean((exact - sampled) ** 2)) / exact.max())
    assert errors[2] < 0.4 * errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.01


def test_trilinear_step():
    phantom = smooth_ball(24)
    geometry = geometry_of(acquisition(detector=DetectorSpec(pixels_y=40, pixels_x=40, pixel_mm=1.0)))
    by_step = [
        line_integrals(phantom, geometry, 0, ALL_DIFFERENT, sampling="trilinear", step_voxels=step)
        for step in (0.45, 0.1, 0.01)
    ]
    coarse, fine = (np.sqrt(np.mean((image - by_step[2]) ** 2)) for image in by_step[:2])
    assert fine < coarse < 0.01 * by_step[2].max()
    assert fine < 0.002 * by_step[2].max()


def test_trilinear_of_a_uniform_box_is_its_chord():
    phantom = phantom_of(np.full((30, 60, 50), Tissue.ADIPOSE, np.uint8))
    geometry = geometry_of(acquisition())
    exact = line_integrals(phantom, geometry, 0, MU)
    step = 0.3 * 2.0
    sampled = line_integrals(phantom, geometry, 0, MU, sampling="trilinear", step_voxels=0.3)
    assert np.abs(exact - sampled).max() <= 1.001 * step * MU[Tissue.ADIPOSE]


@pytest.mark.parametrize("sampling", ["exact", "trilinear"])
def test_moving_the_whole_scene_changes_nothing(sampling):
    """A detector that turns with the tube sees, at angle a, the phantom turned by -a about the isocenter."""
    angle = 90.0
    rng = np.random.default_rng(5)
    labels = rng.integers(0, 4, (20, 20, 20)).astype(np.uint8)
    isocenter = 150.0
    # A cube centred on the isocenter: a turn by a right angle maps voxels onto voxels.
    grid = Grid((20, 20, 20), (2.0, 2.0, 2.0), (0.0, -20.0, isocenter - 20.0))
    detector = Detector(60, 40, 1.7)
    radius = 450.0

    def pose(degrees):
        a = np.deg2rad(degrees)
        return AcquisitionGeometry(
            angles=np.array([degrees]), detector_angles=np.array([degrees]), detector=detector,
            sources=np.array([[0.0, radius * np.sin(a), isocenter + radius * np.cos(a)]]),
            isocenter_height=isocenter, source_to_detector=600.0, support_height=0.0,
        )  # fmt: skip

    def project(volume, degrees):
        out = np.empty((60, 40))
        step = 0.8 if sampling == "trilinear" else 0.0
        project_rays(volume, grid, pose(degrees), 0, ALL_DIFFERENT, step_mm=step, out=out)
        return out

    # Tube from +z to +y: what lay at (y, z) lies at (z, -y) about the isocenter.
    turned = labels.transpose(1, 0, 2)[::-1]
    assert np.abs(project(labels, 0.0) - project(np.ascontiguousarray(turned), angle)).max() < 1e-9
    assert np.abs(project(labels, 0.0) - project(labels, angle)).max() > 0.1


def test_tilted_detector_magnifies_as_geometry_says():
    """A small ball appears where the geometry's own pixel positions say."""
    labels = np.zeros((40, 60, 50), np.uint8)
    labels[19:21, 39:41, 29:31] = Tissue.CALCIFICATION
    phantom = phantom_of(labels, (1.0, 1.0, 1.0))
    fine = DetectorSpec(pixels_y=150, pixels_x=130, pixel_mm=0.3)
    geometry = geometry_of(acquisition(detector_range_degrees=10.0, detector=fine))
    for view in range(3):
        image = line_integrals(phantom, geometry, view, MU)
        j, i = np.average(np.argwhere(image > 0), axis=0, weights=image[image > 0])
        source, pixel = geometry.sources[view], geometry.pixel_position(view, j, i)
        point = np.array([30.0, 10.0, 40.0])
        along = (pixel - source) / np.linalg.norm(pixel - source)
        offset = point - source
        assert np.linalg.norm(offset - (offset @ along) * along) < 0.2


def test_same_bytes_for_any_number_of_threads(threads):
    phantom = phantom_of(random_labels())
    for detector_range, sampling in ((0.0, "exact"), (6.0, "exact"), (0.0, "trilinear")):
        geometry = geometry_of(acquisition(detector_range_degrees=detector_range))
        images = []
        for count in (1, 2):
            threads(count)
            images.append(line_integrals(phantom, geometry, 0, MU, sampling=sampling).tobytes())
        assert images[0] == images[1]
