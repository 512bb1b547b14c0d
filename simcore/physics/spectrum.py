"""Spectra of tubes: tables of SpekPy behind filters, air kerma, half-value layers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.core.tissues import Tissue
from simcore.physics.attenuation import attenuation, energy_transfer
from simcore.physics.materials import Material, material, tissue_sets
from simcore.physics.spec import LOWEST_KEV, MaterialsSpec, TubeSpec
from simcore.physics.tables import arrays

FloatArray = NDArray[np.float64]
MGY_MM2_PER_KEV_PER_MM = 1.602176634e-10 / 1e-3
"""keV a mm3 as mGy in a material of 1 g/cm3: 1.602e-16 J in 1e-6 kg, in mGy."""
CM2_PER_SR = 1e4
"""At 1 m."""
LEAST_SHARE = 1e-7
BIN_PARTS = 10


class Emission(NamedTuple):
    """What leaves the tube behind its filters.

    energies_keV: (n,), ascending: middles of bins of 0.5 keV and the lines. photons: (n,), a steradian, for a load of
    1 mAs; of a measured spectrum without an output on any scale. absolute: whether the scale is that of a mAs.
    """

    energies_keV: FloatArray
    photons: FloatArray
    absolute: bool

    @property
    def mean_keV(self) -> float:
        """Mean energy of a photon."""
        return float(self.photons @ self.energies_keV / self.photons.sum())


def emission(tube: TubeSpec, air_mm: float = 0.0) -> Emission:
    """The spectrum of a tube behind its filters and ``air_mm`` of air, without energies that nothing is left of."""
    if tube.measured is not None:
        energies, photons = np.array(tube.measured.energies_keV), np.array(tube.measured.photons)
        if tube.measured.mGy_per_mAs is not None:
            photons = photons * (tube.measured.mGy_per_mAs / air_kerma(energies, photons, 1000.0))
    else:
        energies, photons = unfiltered(tube.anode, tube.kVp)
        photons = photons * through_filters(tube, energies)
    if air_mm:
        photons = photons * np.exp(-attenuation(material("air"), energies) * air_mm)
    strong = photons > LEAST_SHARE * photons.max()
    absolute = tube.measured is None or tube.measured.mGy_per_mAs is not None
    return Emission(energies[strong], photons[strong], absolute)


def unfiltered(anode: str, kVp: float) -> tuple[FloatArray, FloatArray]:
    """(energies, photons a steradian and mAs) of an anode on the axis of the beam: linear between whole kV.

    anode: "W", "Mo", "Rh". kVp: 20 to 49.
    """
    table = arrays("anodes")
    row = [str(name) for name in table["anodes"]].index(anode)
    kilovolts = np.asarray(table["kilovolts"], np.float64)
    low = min(int(np.searchsorted(kilovolts, kVp, side="right")) - 1, len(kilovolts) - 2)
    share = kVp - kilovolts[low]
    edges = np.asarray(table["bin_edges_keV"], np.float64)
    continuum, lines = (
        (1 - share) * np.asarray(table[name], np.float64)[row, low]
        + share * np.asarray(table[name], np.float64)[row, low + 1]
        for name in ("continuum", "lines")
    )
    places = np.asarray(table["line_keV"], np.float64)[row]
    energies = np.concatenate([(edges[:-1] + edges[1:]) / 2, places[lines > 0]])
    photons = np.concatenate([continuum * np.diff(edges), lines[lines > 0]]) * CM2_PER_SR
    energies, groups = np.unique(energies, return_inverse=True)
    return energies, np.asarray(np.bincount(groups, photons), np.float64)


def through_filters(tube: TubeSpec, energies_keV: FloatArray, slant: float = 1.0) -> FloatArray:
    """Share of photons that passes the filters, in the shape of the energies, which are those of ``unfiltered``.

    slant: path through a filter over its thickness. In a bin it is the mean over tenths: the K edge of a filter stands
    inside of one.
    """
    edges = np.asarray(arrays("anodes")["bin_edges_keV"], np.float64)
    middles = (edges[:-1] + edges[1:]) / 2
    width = np.where(np.isin(energies_keV, middles), edges[1] - edges[0], 0.0)
    places = energies_keV + width * ((np.arange(BIN_PARTS)[:, None] + 0.5) / BIN_PARTS - 0.5)
    depths = np.zeros(places.shape)
    for layer in (*tube.inherent, *tube.filters):
        depths += attenuation(material(layer.material), np.maximum(places, LOWEST_KEV)) * layer.thickness_mm
    return np.asarray(np.exp(-depths * slant).mean(axis=0))


def kerma_per_photon(energies_keV: ArrayLike) -> FloatArray:
    """Air kerma of a fluence of one photon a mm2, mGy, in the shape of the energies."""
    air, energies = material("air"), np.asarray(energies_keV, np.float64)
    return energies * energy_transfer(air, energies) / air.density_g_cm3 * MGY_MM2_PER_KEV_PER_MM


def air_kerma(energies_keV: FloatArray, photons: FloatArray, distance_mm: float) -> float:
    """Air kerma, mGy, of photons a steradian at a distance from the focal spot."""
    return float(photons @ kerma_per_photon(energies_keV)) / distance_mm**2


def value_layer(energies_keV: FloatArray, photons: FloatArray, share: float = 0.5) -> float:
    """Aluminium, mm, that leaves this share of the air kerma: 0.5 for the half-value layer, 0.25 for the quarter."""
    weights = photons * kerma_per_photon(energies_keV)
    depths = attenuation(material("aluminium"), energies_keV)
    low, high = 0.0, 1.0
    while weights @ np.exp(-depths * high) > share * weights.sum():
        high *= 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if weights @ np.exp(-depths * middle) > share * weights.sum() else (low, middle)
    return (low + high) / 2


def tissue_materials(spec: MaterialsSpec) -> Mapping[Tissue, Material]:
    """What every tissue is made of."""
    own = {
        Tissue[name.upper()]: Material(f"own {name}", entry.density_g_cm3, entry.mass_fractions)
        for name, entry in spec.own.items()
    }
    return {**tissue_sets()[spec.tissues], **own}
