"""Cross sections and scattering factors against published numbers and against what they must be."""

from importlib import resources

import numpy as np
import pytest

from simcore.physics.attenuation import (
    attenuation,
    cross_sections,
    energy_transfer,
    form_factor_squared,
    recoil_share,
    scattering_function,
)
from simcore.physics.materials import Material, material
from simcore.physics.tables import atomic_masses, elements, form_factors, k_shells

WATER, AIR = material("water"), material("air")


@pytest.mark.parametrize(("energy", "mu"), [(10.0, 0.5329), (15.0, 0.1673), (20.0, 0.08096), (30.0, 0.03756)])
def test_water_attenuates_as_in_the_nist_tables(energy, mu):
    assert attenuation(WATER, energy) == pytest.approx(mu, rel=2e-3)


@pytest.mark.parametrize(
    ("energy", "cm2_per_g"), [(10.0, 4.742), (15.0, 1.334), (20.0, 0.5389), (30.0, 0.1537), (50.0, 0.04098)]
)
def test_air_takes_energy_as_in_the_nist_tables(energy, cm2_per_g):
    """mu_en / rho of dry air, J. H. Hubbell, S. M. Seltzer, NISTIR 5632 (1995)."""
    assert energy_transfer(AIR, energy) * 10 / AIR.density_g_cm3 == pytest.approx(cm2_per_g, rel=2e-3)


@pytest.mark.parametrize(
    ("symbol", "energy", "kinds"),
    [
        ("O", 20.0, (0.612404, 0.098880, 0.154022)),
        ("Ca", 12.34, (50.99572, 0.715484, 0.112027)),
        ("Rh", 23.0, (10.06502, 0.900745, 0.098603)),
        ("Rh", 23.4, (61.916386, 0.879082, 0.099198)),
        ("Cs", 36.2, (30.252188, 0.589358, 0.102131)),
    ],
)
def test_elements_stand_in_the_table_as_in_its_source(symbol, energy, kinds):
    """xraydb 4.5.8, between the points of the table and on both sides of an edge."""
    sections = cross_sections(Material(symbol, 10.0, {symbol: 1.0}), energy)
    assert np.array(sections) == pytest.approx(kinds, rel=5e-4)


def test_an_edge_is_a_step():
    below, above = cross_sections(material("rhodium"), [23.2199, 23.2201]).photo
    assert above / below == pytest.approx(63.14 / 9.797, rel=1e-3)
    for symbol, shell in k_shells().items():
        table = elements()[symbol]
        first, last = np.flatnonzero(np.isclose(table.energies, shell.edge_keV, atol=1e-9))
        assert last == first + 1
        assert table.photo[last] > 2 * table.photo[first]


def test_energies_keep_their_shape_and_must_lie_in_the_table():
    assert cross_sections(WATER, np.full((2, 3), 20.0)).photo.shape == (2, 3)
    for energies in ([0.9, 20.0], [20.0, 150.1], [np.nan]):
        with pytest.raises(ValueError, match=r"outside of the table, 1 \.\. 150 keV"):
            attenuation(WATER, energies)


def test_factors_at_their_limits():
    """All electrons scatter in phase at x = 0, each by itself at large x."""
    carbon = material("carbon")
    assert form_factor_squared(carbon, 0.0) == pytest.approx(36.0, rel=1e-4)
    assert scattering_function(carbon, 0.0) == 0.0
    assert scattering_function(carbon, 12.0) == pytest.approx(6.0, rel=1e-3)
    assert form_factor_squared(carbon, 12.0) < 1e-3
    with pytest.raises(ValueError, match=r"outside of 0 \.\. 12\.2"):
        scattering_function(carbon, [0.0, 12.3])


def test_factors_of_a_compound_are_means_over_its_atoms():
    """Water: two atoms of hydrogen to one of oxygen, whatever they weigh."""
    x = np.array([0.05, 0.3, 1.1])
    atom = {symbol: Material(symbol, 1.0, {symbol: 1.0}) for symbol in ("H", "O")}
    for factor in (form_factor_squared, scattering_function):
        expected = (2 * factor(atom["H"], x) + factor(atom["O"], x)) / 3
        assert factor(WATER, x) == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize("energy", [10.0, 20.0, 40.0])
@pytest.mark.parametrize("name", ["water", "adipose", "pmma", "aluminium"])
def test_the_integral_of_the_factors_is_the_cross_section(name, energy):
    """Thomson and Klein-Nishina with F^2 and S, over all angles, against the tabulated sums."""
    substance = material(name)
    nodes, weights = np.polynomial.legendre.leggauss(600)
    x = energy / 12.398419843 * np.sqrt((1 - nodes) / 2)
    ratio = 1 / (1 + energy / 510.99895 * (1 - nodes))
    thomson = np.sum(weights * form_factor_squared(substance, x) * (1 + nodes**2))
    compton = np.sum(weights * scattering_function(substance, x) * ratio**2 * (ratio + 1 / ratio - 1 + nodes**2))
    atoms = sum(f / m for f, m in atom_shares(substance))
    scale = np.pi * 2.8179403e-13**2 * 6.02214076e23 * atoms * substance.density_g_cm3 / 10
    sections = cross_sections(substance, energy)
    assert scale * thomson == pytest.approx(float(sections.coherent), rel=0.02)
    assert scale * compton == pytest.approx(float(sections.incoherent), rel=0.02)


def atom_shares(substance):
    return [(fraction, atomic_masses()[symbol]) for symbol, fraction in substance.mass_fractions.items()]


def test_a_compton_electron_takes_more_of_a_photon_of_more_energy():
    low, high = recoil_share(WATER, [20.0, 50.0])
    assert 0.03 < low < 0.045
    assert 0.07 < high < 0.09


def test_tables_are_read_only_and_small():
    folder = resources.files("simcore.physics.data")
    assert sum(len(entry.read_bytes()) for entry in folder.iterdir() if entry.is_file()) < 500_000
    with pytest.raises(ValueError, match="read-only"):
        elements()["O"].photo[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        form_factors().form_factor[0] = 1.0
