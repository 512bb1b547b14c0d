"""Several rays a pixel: their intensities are averaged, not their paths."""

from __future__ import annotations

import numpy as np
import pytest

from bench.support.siddon import siddon
from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.projection import project
from simcore.projection.materials import attenuation_table
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, PhysicsSpec

MU = attenuation_table("johns-yaffe-20keV")
COARSE = AcquisitionSpec(views=3, truncation="allow", detector=DetectorSpec(pixels_y=24, pixels_x=20, pixel_mm=5.0))


@pytest.fixture(scope="module")
def random_phantom() -> Phantom:
    labels = np.random.default_rng(4).integers(0, 4, (18, 40, 34)).astype(np.uint8)
    return Phantom(labels, Grid(labels.shape, (2.0, 2.0, 2.0), (0.0, -40.0, 0.0)))


@pytest.mark.parametrize("rays", [2, 3, 8])
@pytest.mark.parametrize("turn", [0.0, 6.0])
def test_pixel_is_the_mean_intensity_of_its_rays(random_phantom, rays, turn):
    stack = project(random_phantom, COARSE.with_(detector_range_degrees=turn), PhysicsSpec(rays_per_pixel_edge=rays))
    geometry = stack.geometry
    assert stack.data.shape == (3, 24, 20)
    assert stack.report["rays"] == 3 * 24 * 20 * rays**2
    grid = random_phantom.grid.moved(z=geometry.support_height)
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    for view, j, i in [(0, 9, 3), (1, 20, 12), (2, 4, 0), (2, 12, 7)]:
        ends = [geometry.pixel_position(view, j + dj, i + di) for dj in offsets for di in offsets]
        integrals = [siddon(random_phantom.labels, grid, geometry.sources[view], end, MU) for end in ends]
        expected = stack.open_field * np.mean(np.exp(-np.array(integrals)))
        assert stack.data[view, j, i] == pytest.approx(expected, abs=0.5 + 0.1)
        # The mean path would be another number: the test tells them apart.
        assert abs(expected - stack.open_field * np.exp(-np.mean(integrals))) > 5


def test_a_border_within_a_pixel_lets_the_open_part_through():
    """A block ends in the middle of the pixels of column 6: half of their light is unattenuated."""
    labels = np.full((10, 20, 13), Tissue.CALCIFICATION, np.uint8)
    acquisition = AcquisitionSpec(
        views=1, air_gap_mm=0.0, source_to_detector_mm=2000.0, truncation="allow",
        detector=DetectorSpec(pixels_y=8, pixels_x=10, pixel_mm=2.0),
    )  # fmt: skip
    block = Phantom(labels, Grid(labels.shape, (1.0, 1.0, 0.3), (0.0, -10.0, 0.0)))
    stack = project(block, acquisition, PhysicsSpec(rays_per_pixel_edge=4))
    through = np.exp(-3.0 * MU[Tissue.CALCIFICATION])
    assert stack.data[0, 4, 2] == pytest.approx(60000 * through, abs=2)
    assert stack.data[0, 4, 6] == pytest.approx(60000 * (1 + through) / 2, abs=2)
    assert stack.data[0, 4, 8] == 60000


def test_one_ray_a_pixel_is_the_default_and_many_converge(random_phantom):
    images = {
        rays: project(random_phantom, COARSE, PhysicsSpec(rays_per_pixel_edge=rays)).data.astype(float)
        for rays in (1, 2, 4, 8)
    }
    assert np.array_equal(images[1], project(random_phantom, COARSE, PhysicsSpec()).data)
    errors = [np.sqrt(np.mean((images[rays] - images[8]) ** 2)) for rays in (1, 2, 4)]
    assert errors[2] < 0.5 * errors[1] < 0.3 * errors[0]


def test_the_same_bytes_for_any_number_of_threads(random_phantom, threads):
    images = []
    for count in (1, 2):
        threads(count)
        images.append(project(random_phantom, COARSE, PhysicsSpec(rays_per_pixel_edge=3)).data.tobytes())
    assert images[0] == images[1]
