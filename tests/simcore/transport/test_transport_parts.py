"""Tables, cells, random numbers, upsampling: each by itself."""

import numpy as np
import pytest

from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.kernels import njit
from simcore.physics.attenuation import ELECTRON_KEV, KEV_ANGSTROM, cross_sections, recoil_share, scattering_function
from simcore.physics.materials import material
from simcore.physics.upsampling import spread_over_pixels
from simcore.transport import draws
from simcore.transport.cells import CARDS, LABELS, cells_of
from simcore.transport.collisions import majorant, scattered, turned
from simcore.transport.tables import COHERENT, tables_of

WATER = material("water")
TABLES = tables_of([WATER], 60.0, (), 1.0)


@njit
def _uniforms(n, key):
    out = np.empty((n, 2))
    for index in range(n):
        state = draws.start(key, index)
        for k in range(2):
            state, out[index, k] = draws.uniform(state)
    return out


@njit
def _flights(n, energy, tables):
    total = 0.0
    for index in range(n):
        u = draws.uniform(draws.start(np.uint64(7), index))[1]
        total += -np.log(u) / majorant(energy, tables)
    return total / n


@njit
def _scatters(n, energy, tables):
    out = np.empty((n, 3))
    for index in range(n):
        state, cosine, after = scattered(draws.start(np.uint64(3), index), energy, 0, tables)
        u, _, w = turned(state, 0.6, 0.0, -0.8, cosine)[1:]
        out[index, 0], out[index, 1], out[index, 2] = cosine, after, u * 0.6 - w * 0.8
    return out


def test_numbers_are_uniform_and_of_no_history_but_their_own():
    numbers = _uniforms(200_000, np.uint64(1))
    assert np.histogram(numbers, 20, (0, 1))[0].std() < 4 * np.sqrt(numbers.size / 20)
    assert abs(np.corrcoef(numbers[:, 0], numbers[:, 1])[0, 1]) < 0.01
    assert abs(np.corrcoef(numbers[:-1, 0], numbers[1:, 0])[0, 1]) < 0.01
    assert not np.array_equal(numbers, _uniforms(200_000, np.uint64(2)))


@pytest.mark.parametrize("energy", [12.0, 20.0, 33.3])
def test_mean_free_path_is_that_of_the_cross_sections(energy):
    expected = 1 / float(cross_sections(WATER, energy).total)
    assert _flights(200_000, energy, TABLES) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("energy", [15.0, 30.0])
def test_angles_are_those_of_klein_and_nishina_and_of_the_form_factors(energy):
    n = 400_000
    cosine, after, along = _scatters(n, energy, TABLES).T
    assert along == pytest.approx(cosine, abs=1e-5)
    coherent = after == energy
    share = float(cross_sections(WATER, energy).coherent)
    share /= float(cross_sections(WATER, energy).coherent + cross_sections(WATER, energy).incoherent)
    assert coherent.mean() == pytest.approx(share, abs=4 * np.sqrt(share / n))
    lost = 1 - (after[~coherent] / energy).mean()
    assert lost == pytest.approx(float(recoil_share(WATER, energy)), rel=0.01)
    ratio = 1 / (1 + energy / ELECTRON_KEV * (1 - cosine[~coherent]))
    assert after[~coherent] == pytest.approx(energy * ratio, rel=1e-9)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    k = 1 / (1 + energy / ELECTRON_KEV * (1 - nodes))
    x = energy / KEV_ANGSTROM * np.sqrt((1 - nodes) / 2)
    density = weights * k**2 * (k + 1 / k - 1 + nodes**2) * scattering_function(WATER, x)
    for power in (1, 2):
        expected = float(np.sum(density * nodes**power) / np.sum(density))
        assert (cosine[~coherent] ** power).mean() == pytest.approx(expected, abs=0.006)


def test_coherent_scattering_is_forward_and_of_thomson_where_the_form_factor_is_flat():
    quantiles = TABLES.cosines[COHERENT, :, 0]
    assert quantiles[1, 64] < quantiles[20, 64] < quantiles[50, 64]
    assert quantiles[50, 64] > 0.9


def test_capped_materials_do_not_count_for_the_majorant():
    tables = tables_of([WATER, material("calcium-oxalate")], 40.0, (1,), 1.0)
    total = tables.attenuation.sum(axis=-1)
    assert np.all(tables.majorant >= total.max(axis=1) * (1 - 1e-5))
    assert tables.majorant[190] == pytest.approx(float(cross_sections(WATER, 20.0).total), rel=2e-4)
    free = tables_of([WATER, material("calcium-oxalate")], 40.0, (), 1.0)
    assert free.majorant[190] > 5 * tables.majorant[190]


def test_hands_have_every_label_as_often_as_the_voxels():
    random = np.random.default_rng(1)
    labels = random.choice(
        [Tissue.AIR, Tissue.ADIPOSE, Tissue.GLAND, Tissue.CALCIFICATION], (43, 61, 57), p=[0.1, 0.6, 0.29, 0.01]
    )
    labels = labels.astype(np.uint8)
    grid = Grid(labels.shape, (0.2, 0.25, 0.3), (0.0, -7.0, 15.0))
    cells = cells_of(labels, grid, np.eye(LABELS), 1.0)
    assert cells.edge == pytest.approx((1.0, 1.0, 0.9))
    assert cells.hands.shape[1] == CARDS
    volumes = cells.volumes()
    assert volumes.sum() == pytest.approx(grid.voxel_volume * grid.size)
    exact = np.bincount(labels.ravel(), minlength=LABELS) * grid.voxel_volume
    assert volumes == pytest.approx(exact, abs=0.004 * volumes.sum())
    cards = exact[Tissue.CALCIFICATION] / np.prod(cells.edge) * CARDS
    assert volumes[Tissue.CALCIFICATION] == pytest.approx(exact[Tissue.CALCIFICATION], rel=4 / np.sqrt(cards))
    assert cells.layer_volumes().sum(axis=0) == pytest.approx(volumes)


def test_hands_of_one_label_are_that_label_alone():
    labels = np.full((10, 10, 10), Tissue.SKIN, np.uint8)
    cells = cells_of(labels, Grid(labels.shape, (0.5,) * 3, (0.0, 0.0, 0.0)), np.eye(LABELS), 1.0)
    assert cells.hands.tolist() == [[Tissue.SKIN] * CARDS]
    assert cells.index.shape == (5, 5, 5)


def test_a_label_can_be_taken_for_a_mixture():
    labels = np.full((40, 40, 40), Tissue.GLAND, np.uint8)
    becomes = np.eye(LABELS)
    becomes[Tissue.GLAND] = 0.0
    becomes[Tissue.GLAND, [Tissue.ADIPOSE, Tissue.GLAND]] = 0.77, 0.23
    cells = cells_of(labels, Grid(labels.shape, (0.5,) * 3, (0.0, 0.0, 0.0)), becomes, 1.0)
    volumes = cells.volumes()
    assert volumes[Tissue.GLAND] / volumes.sum() == pytest.approx(0.23, abs=0.002)
    assert volumes[Tissue.ADIPOSE] / volumes.sum() == pytest.approx(0.77, abs=0.002)


def test_pixels_keep_the_sums_of_their_cells():
    random = np.random.default_rng(2)
    cells = random.random((7, 9)).astype(np.float32)
    pixels = spread_over_pixels(cells, (70, 45))
    assert pixels.reshape(7, 10, 9, 5).mean(axis=(1, 3)) == pytest.approx(cells, abs=1e-5)


def test_parabolas_are_spread_exactly():
    edges = np.linspace(0, 1, 9)
    means = np.diff(edges**3 / 3) / np.diff(edges)
    fine = np.linspace(0, 1, 81)
    expected = np.diff(fine**3 / 3) / np.diff(fine)
    pixels = spread_over_pixels(np.tile(means, (4, 1)).astype(np.float32), (40, 80))
    assert pixels[5] == pytest.approx(expected, abs=1e-6)
