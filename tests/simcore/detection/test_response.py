"""What one photon leaves in the converter."""

import numpy as np
import pytest

from simcore.detection.converters.csi import CaesiumIodide
from simcore.detection.converters.ideal import Ideal
from simcore.detection.converters.selenium import Selenium
from simcore.detection.response import response, response_table
from simcore.physics.attenuation import attenuation, cross_sections
from simcore.physics.materials import material
from simcore.physics.spec import FilterSpec, TubeSpec
from simcore.physics.spectrum import emission
from simcore.transport.response import DetectorResponse

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


@pytest.mark.parametrize(
    ("tube", "values"),
    [
        (TubeSpec(), {0.2: 0.96, 0.1: 0.57, 0.25: 0.86}),
        (TubeSpec(kVp=32.0, filters=(FilterSpec(),)), {0.2: 0.86, 0.1: 0.42, 0.25: 0.72}),
    ],
    ids=["W/Rh 28 kV", "W/Al 32 kV"],
)
def test_computed_quantum_efficiencies_behind_5_cm(tube, values):
    """Energy-integrating DQE of the layers in the beams of systems, as others computed it (without K fluorescence)."""
    energies, photons, _ = emission(tube)
    breast = sum(attenuation(material(name), energies) for name in ("adipose", "gland")) / 2
    photons = photons * np.exp(-50 * breast)
    for converter in (
        Selenium(swank=1.0, **BARE),
        CaesiumIodide(swank=1.0, **BARE),
        CaesiumIodide(thickness_mm=0.25, swank=1.0, **BARE),
    ):
        answer = response(converter, energies)
        efficiency = (photons @ answer.signal) ** 2 / (photons @ answer.variance) / photons.sum()
        assert efficiency == pytest.approx(values[converter.thickness_mm], abs=0.06)


def test_the_table_of_a_transport():
    table = response_table(CaesiumIodide(), 35.2)
    assert table.energies_keV[0] == 1.0
    assert table.energies_keV[-1] == 35.5
    assert np.all(np.diff(table.energies_keV) == 0.5)
    assert table.absorbed.shape == table.squared.shape == (70, 64)
    one = response(CaesiumIodide(), 20.0, 0.5)
    assert table.absorbed[38, 31] == pytest.approx(one.signal / 20)
    assert table.squared[38, 31] / table.swank == pytest.approx(one.variance / 400)
    detector = DetectorResponse(*table[:4])  # which wants all of it within 0 and 1
    assert detector.absorbed.max() <= 1
    ideal = response_table(Ideal(), 30.0)
    assert np.all(ideal.absorbed == 1)
    assert ideal.swank == 1.0


def test_a_table_over_energy_and_angle():
    answer = response(Selenium(), np.array([15.0, 20.0, 25.0]), np.array([[1.0], [0.9]]))
    assert answer.signal.shape == (2, 3)
    assert np.all(answer.absorbed[1, 1:] > answer.absorbed[0, 1:])


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"cosines of 0 .. 0 are outside"):
        response(Ideal(), 20.0, 0.0)
    with pytest.raises(ValueError, match="outside of the table"):
        response(Selenium(), 0.5)
    with pytest.raises(ValueError, match=r"aluminium.*carbon-fibre"):
        Selenium(cover_material="carbonfibre")
