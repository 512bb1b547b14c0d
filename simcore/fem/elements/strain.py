"""Principal stretches of the elements. Numba kernels."""

from __future__ import annotations

import numpy as np

from simcore.fem.elements.geometry import Array, deformation
from simcore.kernels import njit


@njit(cache=True, nogil=True)
def principal_stretches(displacement: Array, tets: Array, gradients: Array) -> Array:
    """(m, 3), ascending: roots of the eigenvalues of F F^T, to 1e-8 where they are equal, else to rounding.

    Source: Smith, Eigenvalues of a symmetric 3 x 3 matrix, Commun. ACM 4 (1961).
    """
    stretches = np.empty((tets.shape[0], 3))
    for e in range(tets.shape[0]):
        F = deformation(displacement, tets, gradients, e)
        xx = F[0] * F[0] + F[1] * F[1] + F[2] * F[2]
        yy = F[3] * F[3] + F[4] * F[4] + F[5] * F[5]
        zz = F[6] * F[6] + F[7] * F[7] + F[8] * F[8]
        xy = F[0] * F[3] + F[1] * F[4] + F[2] * F[5]
        xz = F[0] * F[6] + F[1] * F[7] + F[2] * F[8]
        yz = F[3] * F[6] + F[4] * F[7] + F[5] * F[8]
        mean = (xx + yy + zz) / 3.0
        xx, yy, zz = xx - mean, yy - mean, zz - mean
        spread = np.sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
        det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        cosine = 0.5 * det / spread**3 if spread > 0.0 else 1.0
        angle = np.arccos(min(max(cosine, -1.0), 1.0)) / 3.0
        largest = mean + 2.0 * spread * np.cos(angle)
        smallest = mean + 2.0 * spread * np.cos(angle + 2.0 / 3.0 * np.pi)
        stretches[e, 0] = np.sqrt(max(smallest, 0.0))
        stretches[e, 1] = np.sqrt(max(3.0 * mean - smallest - largest, 0.0))
        stretches[e, 2] = np.sqrt(largest)
    return stretches
