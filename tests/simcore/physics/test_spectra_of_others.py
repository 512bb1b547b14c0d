"""Spectra, value layers and ideal screens against the source of the tables, TG-195, Boone and other computations."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.physics.attenuation import attenuation
from simcore.physics.materials import Material, material, mixture
from simcore.physics.spec import FilterSpec, TubeSpec
from simcore.physics.spectrum import air_kerma, emission, value_layer
from simcore.physics.tables import tg195_spectrum

WINDOW = (FilterSpec(material="beryllium", thickness_mm=1.0),)
BOONE_W_RH_28 = (
    "40.49 570.9 778.99 5661.5 20007.34 12612.32 19650.18 40708.36 44717.03 58022.98 83309.73 118654.49 160802.12 "
    "211739.75 265670.65 308986.79 349283.96 385719.29 426397.11 459035.65 493751.7 525041.95 551383.95 570021.46 "
    "583903.28 584829.65 579940.98 566150.87 547499.59 529811.41 501153.49 18938.25 20416.45 20980.12 21917.09 "
    "21389.83 20337.85 17690.22 13507.28 7997.38"
)
"""Photons a mm2 and keV for 1 mGy from 8 keV on, by 0.5 keV: as distributed with VICTRE_MCGPU (public domain)."""


@pytest.mark.parametrize(
    ("anode", "kVp", "filter", "half", "quarter", "photons", "kerma", "mean"),
    [
        ("W", 28.0, ("rhodium", 0.05), 0.45638, 1.02435, 96120, 0.021447, 18.665),
        ("W", 28.4, ("rhodium", 0.05), 0.45947, 1.03171, 99730, 0.022131, 18.720),
        ("Mo", 30.0, ("molybdenum", 0.03), 0.30153, 0.70969, 262577, 0.076495, 16.799),
        ("Rh", 29.0, ("rhodium", 0.025), 0.33822, 0.81336, 194832, 0.050659, 17.916),
        ("W", 34.7, ("aluminium", 0.7), 0.50698, 1.26555, 381032, 0.069865, 21.767),
        ("W", 49.0, ("aluminium", 0.7), 0.68179, 1.82627, 951684, 0.127997, 26.790),
    ],
)
def test_spectra_are_those_of_their_source(
    anode: str,
    kVp: float,
    filter: tuple[str, float],
    half: float,
    quarter: float,
    photons: float,
    kerma: float,
    mean: float,
) -> None:
    """SpekPy 2.5.4 ("casim", 22 degrees, steps of 0.1 keV, NIST coefficients), also between whole kilovolts."""
    chosen = FilterSpec(material=filter[0], thickness_mm=filter[1])  # type: ignore[arg-type]
    beam = emission(TubeSpec(anode=anode, kVp=kVp, filters=(chosen,), inherent=WINDOW))  # type: ignore[arg-type]
    assert value_layer(beam.energies_keV, beam.photons) == pytest.approx(half, rel=5e-3)
    assert value_layer(beam.energies_keV, beam.photons, 0.25) == pytest.approx(quarter, rel=5e-3)
    assert beam.photons.sum() / 1e6 == pytest.approx(photons, rel=5e-3)
    assert air_kerma(beam.energies_keV, beam.photons, 1000.0) == pytest.approx(kerma, rel=5e-3)
    assert beam.mean_keV == pytest.approx(mean, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "half", "quarter", "mean"),
    [("mo-mo-30", 0.3431, 0.7663, 16.8), ("w-al-100", 3.950, 9.840, 50.6), ("w-al-120", 5.010, None, 56.4)],
)
def test_value_layers_of_tg195_case_1(name: str, half: float, quarter: float | None, mean: float) -> None:
    """AAPM Report 195 (2015), behind 1 m of air; 120 kV is no case of its own, its layer stands with its spectrum."""
    energies, photons = tg195_spectrum(name)
    assert photons.sum() == pytest.approx(1, abs=1e-4)
    photons = photons * np.exp(-attenuation(material("air"), energies) * 1000.0)
    assert value_layer(energies, photons) == pytest.approx(half, rel=6e-3 if quarter is None else 5e-3)
    assert quarter is None or value_layer(energies, photons, 0.25) == pytest.approx(quarter, rel=5e-3)
    assert photons @ energies / photons.sum() == pytest.approx(mean, abs=0.15)


def test_a_spectrum_that_tg195_lacks_is_refused() -> None:
    with pytest.raises(ValueError, match="no TG-195 spectrum 'rqr8'; there are mo-mo-30, w-al-100, w-al-120"):
        tg195_spectrum("rqr8")


def test_the_spectrum_of_boone_has_its_own_kerma() -> None:
    """W/Rh 28 kV: 4.586e6 photons a mm2 are 1 mGy, 19.0 keV, half-value layer 0.486 mm Al as the file says."""
    energies, photons = 8.0 + 0.5 * np.arange(40), np.array(BOONE_W_RH_28.split(), np.float64) / 2
    assert photons.sum() == pytest.approx(4.586e6, rel=1e-3)
    assert air_kerma(energies, photons, 1.0) == pytest.approx(1, rel=0.03)
    assert photons @ energies / photons.sum() == pytest.approx(19.0, abs=0.05)
    assert value_layer(energies, photons) == pytest.approx(0.486, rel=0.03)


def test_a_beam_of_tungsten_and_rhodium_is_as_that_of_boone() -> None:
    """With the aluminium that gives it the same half-value layer, as many photons for a kerma."""
    inherent = (*WINDOW, FilterSpec(material="aluminium", thickness_mm=0.04))
    rhodium = (FilterSpec(material="rhodium", thickness_mm=0.05),)
    beam = emission(TubeSpec(filters=rhodium, inherent=inherent), 650.0)
    assert value_layer(beam.energies_keV, beam.photons) == pytest.approx(0.486, abs=5e-3)
    assert beam.photons.sum() / air_kerma(beam.energies_keV, beam.photons, 1.0) == pytest.approx(4.586e6, rel=0.02)


@pytest.mark.parametrize(
    ("kVp", "filter", "screen", "thickness", "expected"),
    [
        (28.0, ("rhodium", 0.05), "selenium", 0.2, 0.96),
        (32.0, ("aluminium", 0.7), "selenium", 0.2, 0.86),
        (28.0, ("rhodium", 0.05), "caesium-iodide", 0.1, 0.57),
        (32.0, ("aluminium", 0.7), "caesium-iodide", 0.1, 0.42),
        (28.0, ("rhodium", 0.05), "caesium-iodide", 0.25, 0.86),
        (32.0, ("aluminium", 0.7), "caesium-iodide", 0.25, 0.72),
    ],
)
def test_ideal_screens_detect_as_much_as_computed_elsewhere(
    kVp: float, filter: tuple[str, float], screen: str, thickness: float, expected: float
) -> None:
    """Energy-integrating, without fluorescence, behind 5 cm of half gland; needles of caesium iodide fill 80 %."""
    filling = 0.8 if screen == "caesium-iodide" else 1.0
    chosen = FilterSpec(material=filter[0], thickness_mm=filter[1])  # type: ignore[arg-type]
    beam = emission(TubeSpec(kVp=kVp, filters=(chosen,), inherent=WINDOW))
    energies = beam.energies_keV
    photons = beam.photons * np.exp(-attenuation(half_gland(), energies) * 50.0)
    absorbed = photons * (1 - np.exp(-attenuation(material(screen), energies) * thickness * filling))
    efficiency = (absorbed @ energies) ** 2 / (absorbed @ energies**2) / photons.sum()
    assert efficiency == pytest.approx(expected, abs=0.012)


def half_gland() -> Material:
    return mixture("half gland", [(material("adipose"), 0.5), (material("gland"), 0.5)])
