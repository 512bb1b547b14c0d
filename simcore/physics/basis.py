"""Few maps and few energies in place of many tissues and many bins of a spectrum.

Attenuation curves of all tissues are sums of three basis curves within some 1e-4 of the signal (calcium needs the
third), so a view takes three line integrals a pixel; and a sum over eight energies with fitted weights replaces the
bins of the spectrum, for the signal and for its variance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.physics.attenuation import attenuation
from simcore.physics.materials import Material

FloatArray = NDArray[np.float64]
MAPS = 3
NODES = 8
USUAL_PATHS_MM = {Tissue.ADIPOSE: 60.0, Tissue.GLAND: 50.0, Tissue.SKIN: 6.0, Tissue.CALCIFICATION: 0.6}
OTHER_PATH_MM = 3.0
"""Longest paths through tissues for which curves and energies are fitted; no path of any other is used."""
PATHS = 400
SEED = 20


class Basis(NamedTuple):
    """curves: (maps, energies), of each basis material, any unit; coefficients: (maps, MAX_TISSUES), so that
    coefficients^T curves is the attenuation of every label, 1/mm."""

    curves: FloatArray
    coefficients: FloatArray


class Nodes(NamedTuple):
    """energies_keV: (nodes,), some of those of the spectrum. weights: (2, nodes), of signal and variance.
    curves: (maps, nodes), of the basis there. worst: largest relative error of the signal of a usual path, against all
    energies."""

    energies_keV: FloatArray
    weights: FloatArray
    curves: FloatArray
    worst: float


def basis_of(tissues: Mapping[Tissue, Material], energies_keV: FloatArray, weights: FloatArray) -> Basis:
    """The basis that fits all tissues where the spectrum is strong behind a breast.

    energies_keV, weights: (n,), of the signal without breast.
    """
    names = [tissue for tissue in tissues if tissue != Tissue.AIR]
    mu = np.array([attenuation(tissues[tissue], energies_keV) for tissue in names])
    paths = np.array([_longest(tissue) for tissue in names])
    behind = weights * np.exp(-0.5 * _middle(tissues, energies_keV))
    scale = np.sqrt(behind / behind.sum())
    left, sizes, right = np.linalg.svd(paths[:, None] * mu * scale, full_matrices=False)
    maps = min(MAPS, len(names))
    coefficients = np.zeros((maps, MAX_TISSUES))
    for row, tissue in enumerate(names):
        coefficients[:, tissue] = left[row, :maps] * sizes[:maps] / paths[row]
    return Basis(right[:maps] / scale, coefficients)


def nodes_of(
    tissues: Mapping[Tissue, Material], basis: Basis, energies_keV: FloatArray, weights: FloatArray, plates: FloatArray
) -> Nodes:
    """At most eight energies with weights not below 0 that give signal and variance of every usual path.

    energies_keV: (n,). weights: (2, n), of signal and variance in front of the plates. plates: (n,), line integral of
    all plates.
    """
    mu = np.array([attenuation(tissues[tissue], energies_keV) for tissue in tissues if tissue != Tissue.AIR])
    longest = np.array([_longest(tissue) for tissue in tissues if tissue != Tissue.AIR])
    rng = np.random.default_rng(SEED)
    paths = rng.random((PATHS, len(longest))) * longest
    paths[::2] *= rng.random((PATHS // 2, 1)) ** 2
    paths[0] = 0.0
    slant = 1.0 + 0.3 * rng.random(PATHS)
    shares = np.exp(-paths @ mu - slant[:, None] * plates)
    exact = shares @ weights.T
    chosen = _support(shares / exact[:, :1], weights[0])
    fitted = np.array([_fit(shares[:, chosen], exact[:, kind]) for kind in range(2)])
    worst = float(np.max(np.abs(shares[:, chosen] @ fitted[0] / exact[:, 0] - 1)))
    return Nodes(energies_keV[chosen], fitted, basis.curves[:, chosen], worst)


def _support(shares: FloatArray, weights: FloatArray) -> NDArray[np.int64]:
    """Ascending numbers of the energies whose columns span the rest best: pivots of a QR decomposition."""
    from scipy.linalg import qr

    _, _, pivots = qr(shares * weights, mode="economic", pivoting=True)
    return np.sort(pivots[:NODES])


def _fit(shares: FloatArray, exact: FloatArray) -> FloatArray:
    """Weights not below 0 with the least relative errors."""
    from scipy.optimize import nnls

    weights, _ = nnls(shares / exact[:, None], np.ones(len(exact)), maxiter=50 * shares.shape[1])
    return np.asarray(weights)


def _longest(tissue: Tissue) -> float:
    return USUAL_PATHS_MM.get(tissue, OTHER_PATH_MM)


def _middle(tissues: Mapping[Tissue, Material], energies_keV: FloatArray) -> FloatArray:
    """Line integral of 60 mm of adipose tissue."""
    return attenuation(tissues[Tissue.ADIPOSE], energies_keV) * USUAL_PATHS_MM[Tissue.ADIPOSE]
