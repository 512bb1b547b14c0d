"""Cross sections and scattering factors of materials from those of their atoms (free atoms, mixture rule)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.physics.materials import Material
from simcore.physics.tables import atomic_masses, elements, form_factors, k_shells

FloatArray = NDArray[np.float64]
ELECTRON_KEV = 510.99895
KEV_ANGSTROM = 12.398419843
LOWEST_KEV, HIGHEST_KEV = 1.0, 150.0
COSINES = 400


class CrossSections(NamedTuple):
    """Linear attenuation coefficients, 1/mm, in the shape of the energies."""

    photo: FloatArray
    coherent: FloatArray
    incoherent: FloatArray

    @property
    def total(self) -> FloatArray:
        """Sum of the three, 1/mm."""
        return self.photo + self.coherent + self.incoherent


def cross_sections(material: Material, energies_keV: ArrayLike) -> CrossSections:
    """Photo-absorption, coherent and incoherent scattering: log-log interpolation between the edges.

    energies_keV: any shape, keV.
    raises: ValueError for energies outside of the table, 1 to 150 keV.
    """
    energies = _checked(energies_keV)
    logs = np.log(energies)
    sums = np.zeros((3, *energies.shape))
    for symbol, fraction in material.mass_fractions.items():
        table = elements()[symbol]
        places = np.log(table.energies)
        for kind in range(3):
            sums[kind] += fraction * np.exp(np.interp(logs, places, np.log(table[kind + 1])))
    return CrossSections(*(sums * (material.density_g_cm3 / 10)))


def attenuation(material: Material, energies_keV: ArrayLike) -> FloatArray:
    """Linear attenuation coefficient, 1/mm, in the shape of the energies; see ``cross_sections``."""
    return cross_sections(material, energies_keV).total


def energy_transfer(material: Material, energies_keV: ArrayLike) -> FloatArray:
    """Energy transferred to electrons a length and photon energy, 1/mm: photo-absorption without the K lines that
    leave, and the recoil of Compton electrons (Klein and Nishina with the incoherent scattering function)."""
    energies = _checked(energies_keV)
    logs = np.log(energies)
    transfer = np.zeros(energies.shape)
    for symbol, fraction in material.mass_fractions.items():
        table = elements()[symbol]
        photo = np.exp(np.interp(logs, np.log(table.energies), np.log(table.photo)))
        if symbol in k_shells():
            shell = k_shells()[symbol]
            lost = shell.k_share * shell.fluorescence_yield * shell.line_keV / energies
            photo = photo * (1 - np.where(energies > shell.edge_keV, lost, 0.0))
        transfer += fraction * photo
    incoherent = cross_sections(material, energies).incoherent
    return transfer * (material.density_g_cm3 / 10) + incoherent * recoil_share(material, energies)


def recoil_share(material: Material, energies_keV: ArrayLike) -> FloatArray:
    """Mean share of the photon energy that a Compton electron takes, in the shape of the energies."""
    energies = _checked(energies_keV)
    nodes, weights = np.polynomial.legendre.leggauss(COSINES)
    ratio = 1 / (1 + energies[..., None] / ELECTRON_KEV * (1 - nodes))
    x = energies[..., None] / KEV_ANGSTROM * np.sqrt((1 - nodes) / 2)
    density = weights * ratio**2 * (ratio + 1 / ratio - 1 + nodes**2) * scattering_function(material, x)
    return np.asarray(np.sum(density * (1 - ratio), axis=-1) / np.sum(density, axis=-1))


def form_factor_squared(material: Material, x_per_angstrom: ArrayLike) -> FloatArray:
    """Square of the form factor, mean over the atoms.

    x_per_angstrom: sin(theta / 2) / wavelength, any shape, 0 to 12.2 per Angstrom.
    Free atoms: no interference of neighbours. Tables of molecules with a clear licence are not known.
    """
    return _mean_over_atoms(material, x_per_angstrom, form_factors().form_factor ** 2, 0)


def scattering_function(material: Material, x_per_angstrom: ArrayLike) -> FloatArray:
    """Incoherent scattering function, mean over the atoms; arguments as of ``form_factor_squared``."""
    return _mean_over_atoms(material, x_per_angstrom, form_factors().scattering_function, 2)


def _mean_over_atoms(material: Material, x_per_angstrom: ArrayLike, table: FloatArray, power_at_0: int) -> FloatArray:
    """Log-log interpolation; below the first x above 0 the factor goes as this power of x."""
    factors = form_factors()
    x = np.asarray(x_per_angstrom, np.float64)
    if x.size and not (x.min() >= 0 and x.max() <= factors.x[-1]):
        raise ValueError(f"x = {x.min():g} .. {x.max():g} per Angstrom is outside of 0 .. {factors.x[-1]:g}")
    atoms = {symbol: part / atomic_masses()[symbol] for symbol, part in material.mass_fractions.items()}
    total = sum(atoms.values())
    mean = sum(share / total * table[factors.rows[symbol], 1:] for symbol, share in atoms.items())
    first = factors.x[1]
    inside = np.exp(np.interp(np.log(np.maximum(x, first)), np.log(factors.x[1:]), np.log(mean)))
    return np.asarray(inside * np.minimum(x / first, 1.0) ** power_at_0)


def _checked(energies_keV: ArrayLike) -> FloatArray:
    energies = np.asarray(energies_keV, np.float64)
    if energies.size and not (energies.min() >= LOWEST_KEV and energies.max() <= HIGHEST_KEV):
        raise ValueError(
            f"energies of {energies.min():g} .. {energies.max():g} keV are outside of the table, "
            f"{LOWEST_KEV:g} .. {HIGHEST_KEV:g} keV"
        )
    return energies
