"""From energy that is left behind to dose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.core.tissues import Tissue
from simcore.physics.attenuation import attenuation
from simcore.physics.materials import Material, material
from simcore.physics.spectrum import Emission, kerma_per_photon
from simcore.transport.monte_carlo import Sums, error, mean
from simcore.transport.scene import Setting
from simcore.transport.views import shares_of

FloatArray = NDArray[np.float64]
MGY_PER_KEV_PER_G = 1.602176634e-10
GRAM_PER_MM3 = 1e-3
GLANDULAR = (Tissue.GLAND, Tissue.DUCT, Tissue.TDLU)
KEPT = (Tissue.AIR, Tissue.SKIN, Tissue.NIPPLE, Tissue.MUSCLE)
"""Tissues that the homogeneous equivalent breast has where the breast has them."""
REFERENCE_X_MM = 60.0
ENTRANCE_LAYERS = 2


@dataclass(frozen=True, eq=False)
class Figure:
    """A value of every view, mGy per photon and steradian, with its standard error; both (views,)."""

    value: FloatArray
    error: FloatArray

    def per(self, kerma: float) -> dict[str, Any]:
        """JSON: by view and their mean, in mGy per mGy of ``kerma`` (mGy per photon and steradian)."""
        views = len(self.value)
        return {
            "views": (self.value / kerma).tolist(),
            "standard_errors": (self.error / kerma).tolist(),
            "mean": float(self.value.mean() / kerma),
            "mean_standard_error": float(np.sqrt(np.sum(self.error**2)) / views / kerma),
        }


def masses(setting: Setting) -> FloatArray:
    """g of every label, as the cells have it."""
    volumes = setting.cells.volumes()
    return np.array([volume * _density(setting, label) for label, volume in enumerate(volumes)])


def _density(setting: Setting, label: int) -> float:
    substance = setting.materials[label]
    return 0.0 if substance is None else substance.density_g_cm3 * GRAM_PER_MM3


def glandular_dose(setting: Setting, sums: Sums) -> Figure | None:
    """Mean dose of the glandular tissues; None where there are none."""
    mass = float(masses(setting)[list(GLANDULAR)].sum())
    if mass == 0:
        return None
    energy = sums.deposit[..., list(GLANDULAR)].sum(axis=-1) * (MGY_PER_KEV_PER_G / mass)
    return Figure(mean(energy), error(energy))


def entrance_dose(setting: Setting, sums: Sums) -> Figure | None:
    """Mean dose of the tissue in the uppermost layers of cells, with what is scattered back; None without tissue."""
    densities = np.array([_density(setting, label) for label in range(len(Tissue))])
    volumes = setting.cells.layer_volumes()[:, : len(Tissue)]
    mass = float((volumes[-ENTRANCE_LAYERS:] @ densities).sum())
    if mass == 0:
        return None
    energy = sums.depth[..., -ENTRANCE_LAYERS:].sum(axis=-1) * (MGY_PER_KEV_PER_G / mass)
    return Figure(mean(energy), error(energy))


def air_kerma(setting: Setting, geometry: AcquisitionGeometry, spectrum: Emission) -> FloatArray:
    """Incident air kerma of every view, mGy per photon and steradian (views,): at the height of the top of the breast,
    REFERENCE_X_MM from the chest wall on the middle line, behind the plates above, without any scatter."""
    air = material("air")
    point = np.array([REFERENCE_X_MM, 0.0, setting.cells.upper[2]])
    energies, shares = spectrum.energies_keV, shares_of(spectrum)
    per_fluence = kerma_per_photon(energies)
    kerma = np.empty(geometry.views)
    for view, source in enumerate(geometry.sources):
        way = source - point
        length = float(np.linalg.norm(way))
        depth = np.zeros(len(energies))
        for number, low, high in zip(setting.plates, setting.scene.plate_low, setting.scene.plate_high, strict=True):
            substance = setting.materials[number]
            if substance is not None and low >= point[2] - 1e-6:
                depth += attenuation(substance, energies) * ((high - low) * length / way[2])
        if setting.air is not None:
            above = (source[2] - setting.scene.high[2]) * length / way[2]
            depth += attenuation(air, energies) * above
        kerma[view] = np.sum(shares * per_fluence * np.exp(-depth)) / length**2
    return kerma


def equivalent(volumes: FloatArray, tissues: list[Material | None]) -> tuple[FloatArray, float]:
    """What each label is taken for in the homogeneous equivalent breast, (LABELS, LABELS), and its glandularity.

    All but skin, nipple and muscle becomes one mixture of adipose and glandular tissue with the same share of the mass
    glandular. volumes: (LABELS,), mm^3.
    """
    becomes = np.eye(len(volumes))
    inside = [int(tissue) for tissue in Tissue if tissue not in KEPT]
    mass = np.array([0.0 if t is None else t.density_g_cm3 for t in tissues]) * volumes
    total = mass[inside].sum()
    glandularity = float(mass[list(GLANDULAR)].sum() / total) if total > 0 else 0.0
    adipose, gland = tissues[Tissue.ADIPOSE], tissues[Tissue.GLAND]
    if adipose is None or gland is None:  # no mixture to make: one of the two is all there is
        share = 0.0 if gland is None else 1.0
    else:
        by_volume = glandularity / gland.density_g_cm3
        share = by_volume / (by_volume + (1 - glandularity) / adipose.density_g_cm3)
    for label in inside:
        becomes[label] = 0.0
        becomes[label, Tissue.ADIPOSE] = 1 - share
        becomes[label, Tissue.GLAND] = share
    return becomes, glandularity
