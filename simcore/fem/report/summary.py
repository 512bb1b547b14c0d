"""Strains and shapes of the compressed elements, in a few numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report
from simcore.fem.elements.geometry import Array, cross
from simcore.fem.elements.model import Floats, Model
from simcore.fem.elements.strain import principal_stretches
from simcore.kernels import njit

PERCENTILES = (1, 50, 99)


def strain_summary(model: Model, displacement: Floats) -> Report:
    """Logarithms of the principal stretches, percentiles by undeformed volume.

    returns: {"smallest": {"p1": ..., "p50": ..., "p99": ...}, "middle": ..., "largest": ..., "shear_p99": ...}, the
    last one of the largest principal shear (largest - smallest)/2
    """
    strains = np.log(np.maximum(principal_stretches(displacement, model.tets, model.gradients), 1e-12))
    summary: Report = {
        name: dict(zip((f"p{q}" for q in PERCENTILES), _weighted(strains[:, k], model.volumes), strict=True))
        for k, name in enumerate(("smallest", "middle", "largest"))
    }
    summary["shear_p99"] = _weighted(0.5 * (strains[:, 2] - strains[:, 0]), model.volumes)[-1]
    return summary


def shape_summary(nodes: Floats, tets: NDArray[np.int64]) -> Report:
    """Mean ratio 12 (3 V)^(2/3) / (sum of squared edges), 1 for a regular tetrahedron, 0 for a flat one; and the
    smallest dihedral angle.

    Source: Liu, Joe, Relationship between tetrahedron shape measures, BIT 34 (1994).
    """
    ratio, largest_cosine = _shapes(nodes, tets)
    return {
        "mean_ratio_smallest": float(ratio.min()),
        "mean_ratio_p1": float(np.percentile(ratio, 1)),
        "mean_ratio_p50": float(np.percentile(ratio, 50)),
        "dihedral_angle_smallest_degrees": float(np.degrees(np.arccos(min(largest_cosine, 1.0)))),
    }


@njit(cache=True, nogil=True)
def _shapes(nodes: Array, tets: Array) -> tuple[Array, float]:
    """(mean ratio (m,), largest cosine of a dihedral angle)"""
    ratio, largest = np.empty(tets.shape[0]), -1.0
    edge, normal, length = np.empty((3, 3)), np.empty((4, 3)), np.empty(4)
    for e in range(tets.shape[0]):
        squares = 0.0
        for k in range(3):
            for i in range(3):
                edge[k, i] = nodes[tets[e, k + 1], i] - nodes[tets[e, 0], i]
                squares += edge[k, i] ** 2
        for k in range(3):
            for i in range(3):
                squares += (edge[k, i] - edge[k - 1, i]) ** 2
        # Normals of the faces opposite to corners 1, 2, 3 and 0, all outward or all inward.
        cross(edge[1], edge[2], normal[1])
        cross(edge[2], edge[0], normal[2])
        cross(edge[0], edge[1], normal[3])
        volume = 0.0
        for i in range(3):
            normal[0, i] = -normal[1, i] - normal[2, i] - normal[3, i]
            volume += edge[0, i] * normal[1, i] / 6
        ratio[e] = 12 * (3 * abs(volume)) ** (2 / 3) / squares
        for a in range(4):
            length[a] = np.sqrt(normal[a, 0] ** 2 + normal[a, 1] ** 2 + normal[a, 2] ** 2)
        for a in range(4):
            for b in range(a):
                product = normal[a, 0] * normal[b, 0] + normal[a, 1] * normal[b, 1] + normal[a, 2] * normal[b, 2]
                largest = max(largest, -product / max(length[a] * length[b], 1e-300))
    return ratio, largest


def _weighted(values: Floats, weights: Floats) -> list[float]:
    """PERCENTILES of values, each counted with its weight."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    index = np.searchsorted(cumulative, np.array(PERCENTILES) / 100 * cumulative[-1])
    return [float(v) for v in values[order][np.minimum(index, len(values) - 1)]]
