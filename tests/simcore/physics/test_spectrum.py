"""Spectra against measured half-value layers and published fluence; maps and energies against the whole spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from bench.physics_transport.tg195 import MO_MO_30
from simcore.core.tissues import Tissue
from simcore.physics.attenuation import attenuation
from simcore.physics.basis import basis_of, nodes_of
from simcore.physics.materials import material
from simcore.physics.spec import CompositionSpec, FilterSpec, MaterialsSpec, MeasuredSpectrum, TubeSpec
from simcore.physics.spectrum import Emission, air_kerma, emission, tissue_materials, unfiltered, value_layer

AIR_MM = 600.0
PADDLE = FilterSpec(material="polycarbonate", thickness_mm=2.5)


def tube(anode: str, filter: str, thickness: float, kVp: float, aluminium: float, *more: FilterSpec) -> TubeSpec:
    inherent = (FilterSpec(material="beryllium", thickness_mm=0.8), *more)
    if aluminium:
        inherent += (FilterSpec(material="aluminium", thickness_mm=aluminium),)
    chosen = FilterSpec(material=filter, thickness_mm=thickness)  # type: ignore[arg-type]
    return TubeSpec(anode=anode, kVp=kVp, filters=(chosen,), inherent=inherent)  # type: ignore[arg-type]


def layer(beam: Emission, share: float = 0.5) -> float:
    return value_layer(beam.energies_keV, beam.photons, share)


@pytest.mark.parametrize(
    ("anode", "filter", "thickness", "aluminium", "layers"),
    [
        ("Mo", "molybdenum", 0.03, 0.05, (0.33, 0.36, 0.39)),
        ("Mo", "rhodium", 0.025, 0.05, (0.40, 0.42, 0.44)),
        ("Rh", "rhodium", 0.025, 0.1, (0.38, 0.43, 0.48)),
        ("W", "rhodium", 0.05, 0.2, (0.52, 0.54, 0.56)),
    ],
)
def test_half_value_layers_are_those_of_systems(
    anode: str, filter: str, thickness: float, aluminium: float, layers: tuple[float, ...]
) -> None:
    """At 25, 28, 31 kV behind the paddle (European quality controls; +-0.02 to 0.03 mm)."""
    for kVp, measured in zip((25.0, 28.0, 31.0), layers, strict=True):
        beam = emission(tube(anode, filter, thickness, kVp, aluminium, PADDLE), AIR_MM)
        assert layer(beam) == pytest.approx(measured, abs=0.03)


def test_fluence_for_an_air_kerma() -> None:
    """W/Rh 28 kV: 4.45e6 photons a mm2 and mGy by SpekPy, 4.586e6 by the tables of Boone."""
    beam = emission(tube("W", "rhodium", 0.05, 28.0, 0.0), 1000.0)
    per_mGy = beam.photons.sum() / air_kerma(beam.energies_keV, beam.photons, 1.0)
    assert 4.4e6 < per_mGy < 4.7e6
    assert layer(beam) == pytest.approx(0.48, abs=0.01)  # its own, behind beryllium and air


def test_layers_of_tg195_case_1() -> None:
    """Mo/Mo 30 kV behind 1 m of air: half-value layer 0.3431, quarter-value layer 0.7663 mm of aluminium."""
    energies = 7.25 + 0.5 * np.arange(len(MO_MO_30))
    photons = np.array(MO_MO_30) * np.exp(-attenuation(material("air"), energies) * 1000.0)
    assert value_layer(energies, photons) == pytest.approx(0.3431, rel=5e-3)
    assert value_layer(energies, photons, 0.25) == pytest.approx(0.7663, rel=5e-3)


def test_a_monoenergetic_beam_has_the_layers_of_its_attenuation() -> None:
    energies, photons = np.array([20.0]), np.array([5.0])
    mu = float(attenuation(material("aluminium"), 20.0))
    assert value_layer(energies, photons) == pytest.approx(np.log(2) / mu, rel=1e-9)
    assert value_layer(energies, photons, 0.25) == pytest.approx(np.log(4) / mu, rel=1e-9)


def test_kerma_of_20_keV_photons() -> None:
    """mu_en/rho of dry air at 20 keV: 0.5389 cm2/g (NIST); 1 mGy is 5.79e6 photons a mm2."""
    kerma = air_kerma(np.array([20.0]), np.array([1.0]), 1.0)
    assert kerma == pytest.approx(1 / 5.79e6, rel=5e-3)


def test_no_photon_is_above_the_voltage_and_voltages_are_interpolated() -> None:
    for kVp in (20.0, 28.4, 49.0):
        beam = emission(tube("W", "aluminium", 0.7, kVp, 0.0))
        assert beam.energies_keV.max() < np.ceil(kVp)
    energies, middle = unfiltered("Mo", 28.5)
    ends = [dict(zip(*unfiltered("Mo", kVp), strict=True)) for kVp in (28.0, 29.0)]
    mean = [(ends[0].get(energy, 0.0) + ends[1].get(energy, 0.0)) / 2 for energy in energies]
    np.testing.assert_allclose(middle, mean)


def test_a_measured_spectrum_takes_the_place_of_the_tube() -> None:
    measured = MeasuredSpectrum(energies_keV=(15.0, 20.0), photons=(1.0, 3.0), mGy_per_mAs=0.02)
    beam = emission(TubeSpec(measured=measured))
    assert beam.absolute
    assert beam.photons[1] / beam.photons[0] == pytest.approx(3.0)
    assert air_kerma(beam.energies_keV, beam.photons, 1000.0) == pytest.approx(0.02)
    assert not emission(TubeSpec(measured=measured.with_(mGy_per_mAs=None))).absolute


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kVp": 55.0}, "less than or equal to 49"),
        ({"anode": "Ag"}, "'W', 'Mo' or 'Rh'"),
        ({"filters": [{"material": "molybdenum", "thickness_mm": 0.03}]}, "W goes with aluminium, copper, rhodium"),
        ({"measured": {"energies_keV": [20.0, 15.0], "photons": [1.0, 1.0]}}, "must ascend"),
        ({"measured": {"energies_keV": [20.0], "photons": [1.0, 1.0]}}, "1 energies and 2 numbers"),
    ],
)
def test_what_no_tube_has_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        TubeSpec.model_validate(change)


def test_own_compositions_take_the_place_of_the_set() -> None:
    water = CompositionSpec(density_g_cm3=1.0, mass_fractions={"H": 0.112, "O": 0.888})
    tissues = tissue_materials(MaterialsSpec(own={"mass": water}))
    assert tissues[Tissue.MASS].density_g_cm3 == 1.0
    assert tissues[Tissue.GLAND].name == "gland-johns-yaffe"
    with pytest.raises(ValidationError, match=r"sum to 0\.9; they must sum to 1"):
        CompositionSpec(density_g_cm3=1.0, mass_fractions={"H": 0.1, "O": 0.8})
    with pytest.raises(ValidationError, match="no cross sections of 'Xx'"):
        CompositionSpec(density_g_cm3=1.0, mass_fractions={"Xx": 1.0})


@pytest.mark.parametrize("tissue_set", ["johns-yaffe", "icru-hammerstein"])
@pytest.mark.parametrize(
    ("anode", "filter", "thickness", "kVp"),
    [("Mo", "molybdenum", 0.03, 26.0), ("W", "rhodium", 0.05, 28.0), ("W", "aluminium", 0.7, 49.0)],
)
def test_three_maps_and_eight_energies_give_signal_and_variance(
    tissue_set: str, anode: str, filter: str, thickness: float, kVp: float
) -> None:
    """Largest error of any path up to 60 mm of adipose, 40 of gland, 6 of skin, 0.6 of calcification: below 3e-4."""
    tissues = tissue_materials(MaterialsSpec(tissues=tissue_set))  # type: ignore[arg-type]
    beam = emission(tube(anode, filter, thickness, kVp, 0.1), AIR_MM)
    energies = beam.energies_keV
    weights = np.array([beam.photons * energies, beam.photons * energies**2])
    plates = attenuation(material("polycarbonate"), energies) * 2.5
    basis = basis_of(tissues, energies, weights[0])
    nodes = nodes_of(tissues, basis, energies, weights, plates)
    assert len(nodes.energies_keV) <= 8
    assert nodes.worst < 3e-4
    longest = {Tissue.ADIPOSE: 60.0, Tissue.GLAND: 40.0, Tissue.SKIN: 6.0, Tissue.CALCIFICATION: 0.6}
    paths = np.random.default_rng(3).random((5000, 4)) * list(longest.values())
    mu = np.array([attenuation(tissues[tissue], energies) for tissue in longest])
    exact = np.exp(-paths @ mu - plates) @ weights.T
    maps = paths @ basis.coefficients[:, list(longest)].T
    at_nodes = np.exp(-maps @ nodes.curves - np.interp(nodes.energies_keV, energies, plates)) @ nodes.weights.T
    np.testing.assert_allclose(at_nodes, exact, rtol=3e-4)


def test_the_basis_gives_back_the_curve_of_every_tissue() -> None:
    tissues = tissue_materials(MaterialsSpec())
    energies = np.linspace(10.0, 40.0, 61)
    basis = basis_of(tissues, energies, np.ones(61))
    for tissue, substance in tissues.items():
        if tissue != Tissue.AIR:
            np.testing.assert_allclose(
                basis.coefficients[:, tissue] @ basis.curves, attenuation(substance, energies), rtol=2e-3
            )
    assert not basis.coefficients[:, Tissue.AIR].any()
