"""Compositions of materials and tissues."""

import pytest

from simcore.core.tissues import Tissue
from simcore.physics.attenuation import attenuation
from simcore.physics.materials import Material, material, mixture, standard_materials, tissue_sets
from simcore.physics.spec import ELEMENTS
from simcore.physics.tables import atomic_masses
from simcore.projection.materials import attenuation_table


def test_every_set_names_every_tissue_once():
    assert {name: sorted(tissues) for name, tissues in tissue_sets().items()} == {
        "icru-hammerstein": sorted(Tissue),
        "johns-yaffe": sorted(Tissue),
    }


@pytest.mark.parametrize("tissue", [tissue for tissue in Tissue if tissue is not Tissue.AIR])
def test_tissues_attenuate_at_20_keV_as_the_table_of_one_energy(tissue):
    """Both come from the same compositions (simcore/data/SOURCES.md, S3, S6, S8)."""
    expected = attenuation_table("icru-20keV")[tissue]
    assert attenuation(tissue_sets()["icru-hammerstein"][tissue], 20.0) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("tissue", "at_20_keV", "at_30_keV", "tolerance"),
    [
        (Tissue.ADIPOSE, 0.0456, 0.0264, 0.004),
        (Tissue.GLAND, 0.0802, 0.0378, 0.004),
        (Tissue.MASS, 0.0844, 0.0392, 0.017),
    ],
)
def test_the_set_of_the_paper_attenuates_as_measured(tissue, at_20_keV, at_30_keV, tolerance):
    """P. C. Johns, M. J. Yaffe, Phys. Med. Biol. 32 (1987): the 20 keV are met, the 30 keV follow."""
    substance = tissue_sets()["johns-yaffe"][tissue]
    assert attenuation(substance, 20.0) == pytest.approx(at_20_keV, rel=1e-3)
    assert attenuation(substance, 30.0) == pytest.approx(at_30_keV, rel=tolerance)


def test_fractions_are_scaled_to_sum_to_one():
    substance = Material("salt", 2.16, {"Na": 0.3934, "Cl": 0.6064})
    assert sum(substance.mass_fractions.values()) == pytest.approx(1, abs=1e-15)
    with pytest.raises(TypeError):
        substance.mass_fractions["Na"] = 1.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("density", "fractions", "sentence"),
    [
        (1.0, {"H": 0.112, "Og": 0.888}, "no cross sections of 'Og'; there are H, Be,"),
        (1.0, {"H": 0.112, "O": 0.885}, "mass fractions sum to 0.997; they must sum to 1 within 0.001"),
        (1.0, {"H": 11.2, "O": 88.8}, "sum to 100; they must sum to 1 within 0.001; give fractions, not percent"),
        (1.0, {"H": 1.112, "O": -0.112}, "mass fractions must not be below 0: O = -0.112"),
        (1.0, {"H": float("nan"), "O": 1.0}, "mass fractions must not be below 0: H = nan"),
        (0.0, {"H": 0.112, "O": 0.888}, "density_g_cm3 = 0 must be above 0"),
        (1.0, {}, "mass fractions sum to 0"),
    ],
)
def test_a_composition_that_is_none_is_refused(density, fractions, sentence):
    with pytest.raises(ValueError, match=f"material 'mine': .*{sentence}"):
        Material("mine", density, fractions)


def test_an_unknown_material_names_those_there_are():
    with pytest.raises(ValueError, match=r"no material 'fat'; there are adipose, .*, selenium"):
        material("fat")
    assert {"pmma", "caesium-iodide", "hydroxyapatite", "beryllium"} <= set(standard_materials())


def test_volumes_of_a_mixture_add_up_unless_its_density_is_given():
    parts = [(material("adipose"), 0.8), (material("gland"), 0.2)]
    assert mixture("20 %", parts).density_g_cm3 == pytest.approx(1 / (0.8 / 0.93 + 0.2 / 1.04))
    assert mixture("20 %", parts, density_g_cm3=0.952).density_g_cm3 == 0.952
    assert mixture("20 %", parts).mass_fractions["C"] == pytest.approx(0.8 * 0.619 + 0.2 * 0.184)
    whole = attenuation(mixture("20 %", parts), 25.0)
    volumes = [share / part.density_g_cm3 for part, share in parts]
    assert whole == pytest.approx(
        sum(v * attenuation(part, 25.0) for v, (part, _) in zip(volumes, parts, strict=True)) / sum(volumes)
    )


def test_a_specification_names_the_elements_of_the_table() -> None:
    """It is read without numerics, so it cannot look there."""
    assert tuple(atomic_masses()) == ELEMENTS
