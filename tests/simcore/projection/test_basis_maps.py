"""Several maps in one pass: each as if it were alone, and in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES
from simcore.projection import geometry_of
from simcore.projection.integrals import basis_integrals, line_integrals
from simcore.projection.rays import project_rays
from simcore.projection.spec import AcquisitionSpec, DetectorPoseSpec, DetectorSpec, ViewSpec

DETECTOR = DetectorSpec(pixels_y=150, pixels_x=130, pixel_mm=1.1)
BASIS = np.random.default_rng(1).uniform(0.0, 0.1, (4, MAX_TISSUES))
BASIS[:, 0] = 0.0
BASIS[1, 3:7] = 0.0


def acquisition(**changes):
    return AcquisitionSpec(detector=DETECTOR, views=3, truncation="allow").with_(**changes)


@pytest.fixture(scope="module")
def phantom():
    """All labels there can be, with gaps."""
    labels = np.random.default_rng(0).integers(0, MAX_TISSUES, (30, 60, 50)).astype(np.uint8)
    labels[:, :7] = 0
    labels[:, 33] = 0
    labels[:, :, 40:] = 0
    labels[4:6] = 0
    return Phantom(labels, Grid(labels.shape, (2.0, 2.0, 2.0), (0.0, -60.0, 0.0)))


def moved_detector():
    """A detector that the plane prefixes cannot serve."""
    pose = DetectorPoseSpec(origin_mm=[-30.0, 0.0, 0.0])
    views = [ViewSpec(source_mm=[0.0, y, 600.0], detector=pose) for y in (-100.0, 0.0, 100.0)]
    return AcquisitionSpec(detector=DETECTOR, trajectory=views, truncation="allow")


@pytest.mark.parametrize("maps", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "spec",
    [
        acquisition(),
        acquisition(angular_range_degrees=110.0),
        acquisition(detector_range_degrees=9.0),
        moved_detector(),
    ],
    ids=["stationary", "flat", "turning", "rays"],
)
def test_each_map_is_siddon(phantom, spec, maps):
    geometry = geometry_of(spec)
    for view in (0, 1):
        images = basis_integrals(phantom, geometry, view, BASIS[:maps])
        assert images.shape == (maps, 150, 130)
        for values, image in zip(BASIS, images, strict=False):
            expected = np.empty((150, 130))
            project_rays(phantom.labels, phantom.grid.moved(z=20.0), geometry, view, values, out=expected)
            assert expected.max() > 1.0
            assert np.abs(image - expected).max() < 1e-5 * expected.max()


def test_tall_and_flat_voxels(phantom):
    """Paths that meet many columns within a slice."""
    flat = Phantom(phantom.labels, Grid(phantom.labels.shape, (1.5, 0.3, 2.1), (0.0, -9.0, 0.0)))
    geometry = geometry_of(acquisition(angular_range_degrees=80.0))
    images = basis_integrals(flat, geometry, 0, BASIS)
    for values, image in zip(BASIS, images, strict=True):
        expected = np.empty((150, 130))
        project_rays(flat.labels, flat.grid.moved(z=20.0), geometry, 0, values, out=expected)
        assert np.abs(image - expected).max() < 1e-5 * expected.max()


def test_path_lengths_of_tissues_add_up_to_any_attenuation(phantom):
    """Four indicator maps: their lengths times coefficients are the integral of these coefficients."""
    geometry = geometry_of(acquisition())
    lengths = np.zeros((4, MAX_TISSUES))
    lengths[[0, 1, 2, 3], [1, 2, 3, 4]] = 1.0
    mu = np.zeros(MAX_TISSUES)
    mu[1:5] = (0.0456, 0.0802, 0.3, 0.01)
    total = np.tensordot(mu[1:5], basis_integrals(phantom, geometry, 2, lengths).astype(np.float64), axes=1)
    assert np.abs(total - line_integrals(phantom, geometry, 2, mu)).max() < 1e-5


def test_refusals(phantom):
    geometry = geometry_of(acquisition())
    with pytest.raises(ValueError, match="1 to 4 maps"):
        basis_integrals(phantom, geometry, 0, np.zeros((5, MAX_TISSUES)))
    with pytest.raises(ValueError, match="of 16 labels"):
        basis_integrals(phantom, geometry, 0, np.zeros((2, 3)))


def test_same_bytes_for_any_number_of_threads(phantom, threads):
    geometry = geometry_of(acquisition())
    maps = []
    for count in (1, 2):
        threads(count)
        maps.append(basis_integrals(phantom, geometry, 0, BASIS).tobytes())
    assert maps[0] == maps[1]
