"""Scatter against analog photons, closed forms and published ratios, in short."""

import numpy as np
import pytest

from bench.physics_transport.analog import simulate_analog
from bench.physics_transport.run import blocks_of, slab_rows
from bench.scatter.bodies import arc, beam, block_setting, pure_cells
from bench.scatter.run import RESPONSE, SPECTRUM, breast_setting
from simcore.core.progress import silent
from simcore.physics.attenuation import cross_sections, energy_transfer, recoil_share
from simcore.physics.materials import material
from simcore.transport.cells import LABELS
from simcore.transport.denoising import denoised
from simcore.transport.monte_carlo import error, imbalance, mean, simulate
from simcore.transport.response import IDEAL, DetectorResponse, GridTransmission, tabulated
from simcore.transport.scene import Plate, setting_of
from simcore.transport.views import cell_sides

MONO = beam([20.0])
WATER = material("water")


def sums_of(setting, geometry, spectrum=MONO, response=RESPONSE, rays=20_000, grid_mm=10.0, seed=1):
    return simulate(
        setting, geometry, spectrum, response,
        rays=rays, grid_mm=grid_mm, capped=(), seed=seed, purpose="test", progress=silent,
    )  # fmt: skip


@pytest.fixture(scope="module")
def against_analog():
    setting, _ = breast_setting(40.0, voxel=1.0)
    geometry = arc([15.0])
    fast = sums_of(setting, geometry, SPECTRUM, rays=80_000)
    plain = simulate_analog(setting, geometry, SPECTRUM, RESPONSE, photons=2_000_000, grid_mm=10.0, seed=2)
    return fast, plain


def test_scatter_of_every_cell_is_that_of_analog_photons(against_analog):
    fast, plain = against_analog
    value, reference = mean(fast.signal)[0], mean(plain.signal)[0]
    deviation = np.hypot(error(fast.signal)[0], error(plain.signal)[0])
    counted = reference[0] > 0.2 * reference[0].max()
    chi = ((value - reference) / np.maximum(deviation, 1e-300))[:, counted] ** 2
    assert chi.mean() == pytest.approx(1.0, abs=0.25)
    total = value[0].sum() / reference[0].sum()
    spread = np.hypot(
        *(s.signal[0, :, 0].sum(axis=(1, 2)).std() / 8 / mean(s.signal)[0, 0].sum() for s in (fast, plain))
    )
    assert abs(total - 1) < 4 * spread < 0.04


def test_energy_left_in_every_material_is_that_of_analog_photons(against_analog):
    fast, plain = against_analog
    for number in np.flatnonzero(mean(plain.deposit)[0]):
        ratio = mean(fast.deposit)[0, number] / mean(plain.deposit)[0, number]
        spread = np.hypot(*(error(s.deposit)[0, number] / mean(s.deposit)[0, number] for s in (fast, plain)))
        assert abs(ratio - 1) < 4 * spread < 0.08, number


def test_analog_energy_balances_to_rounding(against_analog):
    missing, _ = imbalance(against_analog[1])
    assert abs(missing[0]) < 1e-12


def test_smooth_maps_are_nearer_to_the_truth_than_raw_ones():
    """On the whole detector: a model that is fitted in the shadow alone is 10 % off beside it."""
    setting, _ = breast_setting(40.0, voxel=1.0)
    geometry = arc([-15.0, -7.5, 0.0, 7.5, 15.0])
    few, many = (sums_of(setting, geometry, SPECTRUM, rays=rays, grid_mm=5.0) for rays in (8_000, 250_000))
    raw, truth = (mean(sums.signal)[:, 0] for sums in (few, many))
    smooth = denoised(raw, few.primary, cell_sides(geometry, raw.shape[1:]), geometry.angles)
    for part in (few.primary.shadow[2], ~few.primary.shadow[2]):
        inside = blocks_of(part.astype(float)) == 4
        of_raw, of_smooth = (
            np.sqrt(np.mean((blocks_of(maps[2])[inside] / blocks_of(truth[2])[inside] - 1) ** 2))
            for maps in (raw, smooth)
        )
        assert 2 * of_smooth < of_raw
        assert of_smooth < 0.07


def test_scatter_to_primary_of_slabs_is_that_of_measurements():
    for row in slab_rows(20_000):
        assert row.holds, row


def test_a_thin_layer_scatters_once_by_closed_form():
    """0.1 mm of water far above a large detector: what is absorbed is mu_tr t, what is scattered down mu_s t / 2."""
    thickness, radius = 0.1, 40.0
    cells = pure_cells(np.zeros((1, 1, 1), np.uint16), (0.0, 0.0, 0.0))
    plate = Plate(WATER, 20.0, 20.0 + thickness)
    setting = setting_of(cells, [None] * LABELS, [plate], None, (200.0, 200.0))
    geometry = arc([0.0], distance=1e6, field=(80, 40))
    sums = sums_of(setting, geometry, rays=40_000)
    area = 80.0 * radius
    per_area = 1e12 / area
    absorbed = mean(sums.deposit)[0, setting.plates[0]] * per_area / 20.0
    assert absorbed == pytest.approx(float(energy_transfer(WATER, 20.0)) * thickness, rel=0.01)
    sections = cross_sections(WATER, 20.0)
    lost = float(sections.incoherent * recoil_share(WATER, 20.0))
    assert lost < float(energy_transfer(WATER, 20.0))


def test_the_primary_is_attenuated_by_the_whole_block():
    setting = block_setting(WATER, (140.0, 260.0, 30.0), bottom=15.0)
    geometry = arc([0.0], distance=1e5)
    sums = sums_of(setting, geometry, rays=2_000)
    expected = 20.0 * np.exp(-30.0 * float(cross_sections(WATER, 20.0).total)) / 1e10
    assert sums.primary.signal[0, 13, 7] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_detector_that_takes_a_share_sees_a_share(share):
    setting = block_setting(WATER, (140.0, 260.0, 30.0), bottom=15.0)
    part = DetectorResponse(np.array([1.0, 60.0]), np.array([0.1, 1.0]), np.full((2, 2), share))
    seen, whole = (
        mean(sums_of(setting, arc([0.0]), response=tabulated(response, None, 40.0), rays=2_000).signal)
        for response in (part, IDEAL)
    )
    assert np.allclose(seen, share * whole, rtol=1e-6)


def test_a_grid_takes_scatter_and_lets_the_focused_primary_through():
    across = np.linspace(0.0, 1.0, 21)
    transmission = np.where(across < 0.1, 0.8, 0.0)[None, :, None] * np.ones((1, 1, 2))
    grid = GridTransmission(np.array([20.0]), across, np.array([0.0, 1.0]), transmission, focus_mm=660.0)
    setting = block_setting(WATER, (140.0, 260.0, 40.0), bottom=15.0)
    with_grid, without = (
        sums_of(setting, arc([0.0]), response=tabulated(IDEAL, g, 40.0), rays=4_000) for g in (grid, None)
    )
    middle = np.s_[0, 8:18, 2:12]
    assert (with_grid.primary.signal[middle] / without.primary.signal[middle]).mean() == pytest.approx(0.8, abs=1e-3)
    ratio = mean(with_grid.signal)[0, 0].sum() / mean(without.signal)[0, 0].sum()
    assert 0.02 < ratio < 0.4
