"""Strains and shapes of the compressed elements, in a few numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report
from simcore.fem.model import Floats, Model
from simcore.fem.strain import principal_stretches

PERCENTILES = (1, 50, 99)
_EDGES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


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
    corners = nodes[tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    squares = sum(((corners[:, a] - corners[:, b]) ** 2).sum(axis=1) for a, b in _EDGES)
    ratio = 12 * (3 * volumes) ** (2 / 3) / squares
    return {
        "mean_ratio_smallest": float(ratio.min()),
        "mean_ratio_p1": float(np.percentile(ratio, 1)),
        "mean_ratio_p50": float(np.percentile(ratio, 50)),
        "dihedral_angle_smallest_degrees": float(np.degrees(_smallest_dihedral(corners).min())),
    }


def _smallest_dihedral(corners: Floats) -> Floats:
    """(m,) radian."""
    normals = []
    for opposite in range(4):
        a, b, c = (corners[:, k] for k in range(4) if k != opposite)
        normal = np.cross(b - a, c - a)
        outward = np.sign(((a - corners[:, opposite]) * normal).sum(axis=1, keepdims=True))
        normals.append(outward * normal / np.linalg.norm(normal, axis=1, keepdims=True))
    angles = [np.pi - np.arccos(np.clip((normals[a] * normals[b]).sum(axis=1), -1, 1)) for a, b in _EDGES]
    smallest: Floats = np.min(angles, axis=0)
    return smallest


def _weighted(values: Floats, weights: Floats) -> list[float]:
    """PERCENTILES of values, each counted with its weight."""
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    index = np.searchsorted(cumulative, np.array(PERCENTILES) / 100 * cumulative[-1])
    return [float(v) for v in values[order][np.minimum(index, len(values) - 1)]]
