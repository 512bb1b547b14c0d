"""Borders between tissues against numpy's own search for them."""

import numpy as np
import pytest

from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES
from simcore.projection import geometry_of, plane_prefix
from simcore.projection.borders import borders_of
from simcore.projection.integrals import line_integrals
from simcore.projection.rays import project_rays
from simcore.projection.spec import AcquisitionSpec, DetectorSpec


def labels_of(nx, tissues=3):
    return np.random.default_rng(nx).integers(0, tissues, (3, 4, nx)).astype(np.uint8)


@pytest.mark.parametrize("nx", [1, 2, 7, 8, 9, 16, 17, 200])
def test_every_border_is_found(nx):
    labels = labels_of(nx)
    labels[1, 2] = 0
    labels[2, 3] = 2
    beside = np.pad(labels.reshape(-1, nx), ((0, 0), (1, 1))).astype(np.int64)
    row, place = np.nonzero(beside[:, 1:] != beside[:, :-1])
    borders = borders_of(labels)
    np.testing.assert_array_equal(borders.start, np.concatenate([[0], np.cumsum(np.bincount(row, minlength=12))]))
    np.testing.assert_array_equal(borders.packed, place << 8 | beside[row, place] << 4 | beside[row, place + 1])


def test_what_is_present_and_where_rows_end():
    labels = np.zeros((2, 2, 10), np.uint8)
    labels[0, 0, 2:6] = 1
    labels[0, 0, 6:8] = 5
    labels[0, 1, 0] = 1
    labels[1, 1] = 5
    mu = np.zeros(MAX_TISSUES)
    mu[[1, 2]] = 0.1, 0.2
    borders = borders_of(labels)
    np.testing.assert_array_equal(np.flatnonzero(borders.present(mu)), [1])
    np.testing.assert_array_equal(borders.row_ends(mu), [[6, 1], [0, 0]])
    mu[5] = 0.3
    np.testing.assert_array_equal(borders.row_ends(mu), [[8, 1], [0, 10]])
    assert borders.falls(mu)[1 << 4 | 5] == np.float32(mu[1] - mu[5])


def test_tissue_that_takes_nothing_lies_beyond_all_that_does():
    """No ray crosses what is there."""
    labels = np.zeros((20, 30, 40), np.uint8)
    labels[:, :, :20] = 1
    labels[:, :, 30:38] = 5
    mu = np.zeros(MAX_TISSUES)
    mu[1] = 0.05
    geometry = geometry_of(AcquisitionSpec(detector=DetectorSpec(pixels_y=70, pixels_x=80, pixel_mm=0.5), views=3))
    phantom = Phantom(labels, Grid(labels.shape, (1.0, 1.0, 1.0), (0.0, -15.0, 0.0)))
    grid = phantom.grid.moved(z=geometry.support_height)
    for view in range(geometry.views):
        assert plane_prefix.serves_lanes(geometry, view, grid)
        values = line_integrals(phantom, geometry, view, mu)
        expected = np.empty((70, 80))
        project_rays(labels, grid, geometry, view, mu, out=expected)
        np.testing.assert_allclose(values, expected, atol=1e-5)
