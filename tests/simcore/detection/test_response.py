"""What one photon leaves in the converter."""

import numpy as np
import pytest

from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.ideal import Ideal
from simcore.detection.converters.selenium import Selenium
from simcore.detection.response import response
from simcore.physics.attenuation import attenuation, cross_sections
from simcore.physics.materials import material

BARE = {"cover_mm": 0.0}


def test_the_ideal_detector_counts_energy():
    answer = response(Ideal(), [10.0, 20.0])
    assert np.array_equal(answer.signal, [10.0, 20.0])
    assert np.array_equal(answer.variance, [100.0, 400.0])
    assert np.array_equal(answer.swank, [1.0, 1.0])


def test_below_the_edge_all_energy_stays():
    answer = response(Selenium(**BARE), 12.0)
    absorbed = 1 - np.exp(-0.2 * cross_sections(material("selenium"), 12.0).photo)
    assert answer.absorbed == pytest.approx(absorbed, rel=1e-12)
    assert answer.signal == pytest.approx(12.0 * absorbed, rel=1e-12)
    assert answer.swank == pytest.approx(0.99, rel=1e-12)


def test_cover_fill_and_obliquity():
    plain = response(Selenium(**BARE), 20.0).absorbed
    cover = np.exp(-1.0 * attenuation(material("pmma"), 20.0))
    covered = response(Selenium(cover_material="pmma", cover_mm=1.0, fill_factor=0.7), 20.0)
    assert covered.absorbed == pytest.approx(0.7 * cover * plain, rel=1e-12)
    thicker = response(Selenium(thickness_mm=0.4, **BARE), 20.0).absorbed
    assert response(Selenium(**BARE), 20.0, 0.5).absorbed == pytest.approx(thicker, rel=1e-12)


def test_k_photons_leave_as_a_random_walk_says():
    """Escape of the K photons of a-Se by a Monte Carlo that knows nothing of exponential integrals."""
    energy, thickness, photons = 20.0, 0.2, 400_000
    numbers = np.random.default_rng(1)
    layer = material("selenium")
    mu = float(cross_sections(layer, energy).photo)
    depth = -np.log(1 - numbers.random(photons) * (1 - np.exp(-mu * thickness))) / mu
    alpha = numbers.random(photons) < 0.863
    line = np.where(alpha, 11.2103, 12.5013)
    path = numbers.exponential(1 / attenuation(layer, line))
    end = depth + path * numbers.uniform(-1, 1, photons)
    left = (numbers.random(photons) < 0.8616 * 0.5738) & ((end < 0) | (end > thickness))
    stays = energy - line * left
    answer = response(Selenium(swank=1.0, **BARE), energy)
    assert answer.signal / answer.absorbed == pytest.approx(stays.mean(), rel=2e-3)
    assert answer.swank == pytest.approx(stays.mean() ** 2 / np.mean(stays**2), rel=2e-3)


def test_caesium_iodide_loses_k_photons_above_its_edges_alone():
    answer = response(CaesiumIodide(), np.array([32.0, 34.0, 37.0]))
    kept = answer.signal / answer.absorbed
    assert kept[0] == pytest.approx(32.0)
    assert kept[1] < 25.0
    assert answer.swank[2] < 0.7


def test_published_quantum_efficiencies():
    """Energy-integrating DQE without optical noise of the reference table: .96 / .57 / .86 in a beam of W/Rh, 28 kV,
    behind 5 cm of breast, which is nearly 21.5 keV."""
    for converter, efficiency in (
        (CaesiumIodide(swank=1.0, **BARE), 0.60),
        (CaesiumIodide(thickness_mm=0.25, swank=1.0, **BARE), 0.89),
        (Selenium(swank=1.0, **BARE), 0.95),
    ):
        answer = response(converter, 21.5)
        assert answer.signal**2 / answer.variance == pytest.approx(efficiency, abs=0.04)


def test_a_table_over_energy_and_angle():
    answer = response(Selenium(), np.array([15.0, 20.0, 25.0]), np.array([[1.0], [0.9]]))
    assert answer.signal.shape == (2, 3)
    assert np.all(answer.absorbed[1, 1:] > answer.absorbed[0, 1:])


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"cosines of 0 .. 0 are outside"):
        response(Ideal(), 20.0, 0.0)
    with pytest.raises(ValueError, match="outside of the table"):
        response(Selenium(), 0.5)
    with pytest.raises(ValueError, match="no material 'carbonfibre'; there are"):
        Selenium(cover_material="carbonfibre")
