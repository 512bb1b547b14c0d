"""What the kernels look up of the materials: attenuation and angles of scattering."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.physics.attenuation import (
    ELECTRON_KEV,
    KEV_ANGSTROM,
    cross_sections,
    form_factor_squared,
    scattering_function,
)
from simcore.physics.materials import Material

Floats = NDArray[np.float32]
LOWEST_KEV = 1.0
STEP_KEV = 0.1
QUANTILES = 128
COSINES = 4001
MAJORANT_MARGIN = 1.0001
TINY = 1e-30
ABSORBED, SCATTERED = 0, 1
COHERENT, INCOHERENT = 0, 1


class Tables(NamedTuple):
    """Materials by number; energies from LOWEST_KEV in steps of STEP_KEV, those of the cosines in steps of 1 keV.

    attenuation: float32 (energies, materials, 2), photo-absorption and scattering, 1/mm.
    coherent:    float32 (energies, materials), share of coherent scattering.
    cosines:     float32 (2, keV, materials, QUANTILES + 1): quantiles of the cosine of coherent and incoherent
                 scattering.
    majorant:    float32 (energies,), 1/mm: the largest attenuation times the density of the points of a flight.
    """

    attenuation: Floats
    coherent: Floats
    cosines: Floats
    majorant: Floats


def tables_of(
    materials: Sequence[Material | None], highest_keV: float, capped: Sequence[int], density: float
) -> Tables:
    """Tables up to ``highest_keV``.

    materials: None for a number that is not used.
    capped:  numbers of materials that do not count for the majorant (calcifications: eight times the attenuation of
             tissue would cost all flights ten times the steps) and are attenuated by it at most.
    density: points of a flight by those that the majorant needs, at least 1.
    """
    energies = np.arange(LOWEST_KEV, highest_keV + 2 * STEP_KEV, STEP_KEV)
    parts = np.stack([_parts(material, energies) for material in materials], axis=-1)
    attenuation = np.stack([parts[0], parts[1] + parts[2]], axis=-1)
    counted = [number for number in range(len(materials)) if number not in capped]
    largest = attenuation.sum(axis=-1)[:, counted].max(axis=1) * MAJORANT_MARGIN
    for number in capped:
        too_much = attenuation[:, number].sum(axis=-1) / largest
        attenuation[:, number] /= np.maximum(too_much, 1.0)[:, None]
    return Tables(
        attenuation=np.ascontiguousarray(attenuation, np.float32),
        coherent=np.ascontiguousarray(parts[1] / np.maximum(parts[1] + parts[2], TINY), np.float32),
        cosines=_cosines(materials, int(np.ceil(highest_keV)) + 1),
        majorant=np.ascontiguousarray(largest * density, np.float32),
    )


def _parts(material: Material | None, energies: NDArray[np.float64]) -> NDArray[np.float64]:
    if material is None:
        return np.zeros((3, len(energies)))
    return np.stack(cross_sections(material, energies))


def _cosines(materials: Sequence[Material | None], highest_keV: int) -> Floats:
    """Quantiles of the cosine: of coherent scattering density F(x)^2 (1 + c^2), of incoherent that of Klein and Nishina
    times S(x), x = E / hc sin(theta / 2)."""
    cosines = np.linspace(-1, 1, COSINES)
    levels = np.linspace(0, 1, QUANTILES + 1)
    quantiles = np.zeros((2, highest_keV + 1, len(materials), QUANTILES + 1), np.float32)
    for number, material in enumerate(materials):
        if material is None:
            continue
        for energy in range(1, highest_keV + 1):
            x = energy / KEV_ANGSTROM * np.sqrt((1 - cosines) / 2)
            ratio = 1 / (1 + energy / ELECTRON_KEV * (1 - cosines))
            klein_nishina = ratio**2 * (ratio + 1 / ratio - 1 + cosines**2)
            densities = (
                form_factor_squared(material, x) * (1 + cosines**2),
                scattering_function(material, x) * klein_nishina,
            )
            for kind, density in enumerate(densities):
                share = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
                quantiles[kind, energy, number] = np.interp(levels, share / share[-1], cosines)
    quantiles[:, 0] = quantiles[:, 1]
    return quantiles
