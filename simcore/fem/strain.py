"""Principal stretches of the elements. Numba kernels."""

from __future__ import annotations

import numpy as np
from numba import njit

from simcore.fem.element import Array, deformation_gradient
from simcore.fem.principal import principal_axes


@njit(cache=True, nogil=True)
def principal_stretches(displacement: Array, tets: Array, gradients: Array) -> Array:
    """(m, 3), ascending."""
    F, left, axes, squared = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    stretches = np.empty((tets.shape[0], 3))
    for e in range(tets.shape[0]):
        deformation_gradient(displacement, tets[e], gradients[e], F)
        for i in range(3):
            for j in range(3):
                left[i, j] = F[i, 0] * F[j, 0] + F[i, 1] * F[j, 1] + F[i, 2] * F[j, 2]
        principal_axes(left, squared, axes)
        squared.sort()
        for i in range(3):
            stretches[e, i] = np.sqrt(max(squared[i], 0.0))
    return stretches
