"""Widths, spread of artefacts and contrast of objects whose form is known."""

import math

import numpy as np
import pytest

from simcore.core.artifacts import Volume
from simcore.core.grid import Grid
from simcore.quality.contrast import Contrast, TissueValues, disk_contrast
from simcore.quality.profiles import (
    artefact_spread,
    cut_out,
    distances,
    full_width_at_half_maximum,
    in_plane_profile,
)

FWHM_OF_SIGMA = 2 * math.sqrt(2 * math.log(2))


def test_width_of_a_gaussian_and_of_a_triangle():
    x = np.linspace(-10, 10, 2001)
    assert full_width_at_half_maximum(x, np.exp(-0.5 * (x / 1.3) ** 2)) == pytest.approx(1.3 * FWHM_OF_SIGMA, rel=1e-5)
    coarse = np.arange(-5.0, 6.0)
    assert full_width_at_half_maximum(coarse, np.maximum(0, 4 - np.abs(coarse))) == pytest.approx(4.0)


def test_width_where_the_profile_ends_too_early_is_infinite():
    x = np.arange(5.0)
    assert full_width_at_half_maximum(x, np.array([0.9, 1.0, 0.4, 0.1, 0.0])) == math.inf
    with pytest.raises(ValueError, match="no peak"):
        full_width_at_half_maximum(x, -np.ones(5))


GRID = Grid((21, 300, 200), (0.05, 0.05, 0.5), (3.0, -7.5, 20.0))
BEAD = (8.125, 0.125, 25.25)


def bead(width_z: float, source: tuple[float, float, float] | None = None) -> np.ndarray:
    """Gaussian bead of 0.6 mm sigma in plane and ``width_z`` across, on a background that changes with depth."""
    values = np.empty(GRID.shape, np.float32)
    for k, z in enumerate(GRID.centres("z")):
        along = 0.0 if source is None else (z - BEAD[2]) / (source[2] - BEAD[2])
        x = BEAD[0] + (0.0 if source is None else along * (source[0] - BEAD[0]))
        y = BEAD[1] + (0.0 if source is None else along * (source[1] - BEAD[1]))
        blob = np.exp(-0.5 * (distances(GRID, x, y) / 0.6) ** 2)
        values[k] = 0.05 + 0.01 * z + np.exp(-0.5 * ((z - BEAD[2]) / width_z) ** 2) * blob
    return values


def test_artefact_spread_of_a_gaussian_bead_is_its_width_across_the_slices():
    heights, spread = artefact_spread(bead(1.5), GRID, BEAD, 0.5, (3.0, 4.5))
    assert spread == pytest.approx(np.exp(-0.5 * (heights / 1.5) ** 2), abs=1e-4)
    assert full_width_at_half_maximum(heights, spread) == pytest.approx(1.5 * FWHM_OF_SIGMA, rel=0.02)


def test_artefact_spread_follows_the_shadow_towards_the_source():
    source = (0.0, 30.0, 80.0)
    leaning = bead(1.5, source)
    heights, followed = artefact_spread(leaning, GRID, BEAD, 0.5, (3.0, 4.5), source)
    assert followed == pytest.approx(np.exp(-0.5 * (heights / 1.5) ** 2), abs=2e-3)
    _, lost = artefact_spread(leaning, GRID, BEAD, 0.5, (3.0, 4.5))
    assert lost[4] < 0.5 * followed[4]


def test_an_object_without_contrast_is_refused():
    with pytest.raises(ValueError, match="no contrast"):
        artefact_spread(-bead(1.0), GRID, BEAD, 0.5, (3.0, 4.5))


def test_a_shadow_that_leaves_the_values_is_refused():
    with pytest.raises(ValueError, match="outside the values"):
        artefact_spread(bead(1.5), GRID, BEAD, 0.5, (3.0, 4.5), (200.0, 0.0, 60.0))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_in_plane_profile_has_the_width_of_the_bead(axis: str):
    positions, profile = in_plane_profile(bead(1.5), GRID, BEAD, axis, 4.5, 3.0)
    assert full_width_at_half_maximum(positions, profile) == pytest.approx(0.6 * FWHM_OF_SIGMA, rel=0.02)
    assert profile.max() == pytest.approx(1.0, abs=0.01)


def test_a_cut_keeps_values_and_places():
    data = np.arange(GRID.size, dtype=np.uint16).reshape(GRID.shape)
    volume = Volume(data, GRID, 0.5, -2.0)
    values, grid = cut_out(volume, (4.0, -2.0, 22.0), (6.0, 2.0, 24.0))
    assert grid.spacing == GRID.spacing
    assert values.shape == grid.shape == (4, 80, 40)
    for axis in "xyz":
        assert set(np.round(grid.centres(axis), 9)) <= set(np.round(GRID.centres(axis), 9))
    k, j, i = (int(np.argmin(np.abs(GRID.centres(a) - grid.centres(a)[0]))) for a in "zyx")
    assert values[0, 0, 0] == 0.5 * data[k, j, i] - 2.0
    with pytest.raises(ValueError, match="x = 100"):
        cut_out(volume, (100.0, -2.0, 22.0), (101.0, 2.0, 24.0))


def disk_image(contrast: float, noise: float) -> np.ndarray:
    random = np.random.default_rng(4)
    field = 0.4 + noise * random.standard_normal((400, 400))
    return field + contrast * (distances(DISK_GRID, 20.0, 2.0) <= 2.5)


DISK_GRID = Grid((1, 400, 400), (0.1, 0.1, 1.0), (0.0, -20.0, 0.0))


def test_contrast_of_a_disk_is_what_was_put_in():
    contrast = disk_contrast(disk_image(0.05, 0.02), DISK_GRID, (20.0, 2.0), 2.5)
    assert contrast.difference == pytest.approx(0.05, abs=1.5e-3)
    assert contrast.noise == pytest.approx(0.02, rel=0.03)
    assert contrast.cnr == pytest.approx(2.5, rel=0.06)
    assert contrast.relative == pytest.approx(0.125, rel=0.04)


def test_contrast_without_noise_is_exact():
    contrast = disk_contrast(disk_image(-0.05, 0.0), DISK_GRID, (20.0, 2.0), 2.5)
    assert contrast.difference == pytest.approx(-0.05, abs=1e-12)
    assert abs(contrast.cnr) > 1e9
    assert Contrast(1.0, 0.0, 0.0).relative == math.inf


def test_a_disk_beyond_the_image_is_refused():
    with pytest.raises(ValueError, match="hold 0 and 0 pixels"):
        disk_contrast(np.zeros((400, 400)), DISK_GRID, (100.0, 2.0), 2.5)


def test_contrast_of_tissues_is_taken_slice_by_slice():
    # Slices of different mean: within each, tissue 2 is 3 above tissue 1, and both have a variance of 1.
    tissues = TissueValues(4)
    for mean in (0.0, 50.0, 100.0):
        values = mean + np.array([-1.0, 1.0, 2.0, 4.0])
        tissues.add(values, np.array([1, 1, 2, 2], np.uint8))
    tissues.add(np.array([1000.0, 1000.0]), np.array([1, 1], np.uint8))  # a slice without the other tissue
    contrast = tissues.contrast(2, 1)
    assert contrast is not None
    assert (contrast.difference, contrast.noise, contrast.cnr) == (3.0, 1.0, 3.0)
    assert tissues.count(1) == 8
    assert tissues.mean(2) == 53.0
    assert tissues.mean(3) is None
    assert tissues.contrast(3, 1) is None
