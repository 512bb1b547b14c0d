"""Volume and shape of tetrahedra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of the face opposite to each corner, outward for a positive tetrahedron."""
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def volumes(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Signed volumes, mm^3, (m,)."""
    a, b, c, d = (nodes[tets[:, k]] for k in range(4))
    return np.asarray(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6)


def boundary_faces(tets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles that belong to one tetrahedron alone, (f, 3), outward for positive tetrahedra."""
    faces = tets[:, _FACES].reshape(-1, 3)
    key = _keys(faces)
    order = np.argsort(key)
    same = np.concatenate([[False], key[order[1:]] == key[order[:-1]], [False]])
    single = np.empty(len(faces), dtype=bool)
    single[order] = ~(same[1:] | same[:-1])
    return np.ascontiguousarray(faces[single])


def _keys(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for each set of two or three corners (n, 2 or 3); holds up to two million nodes."""
    nodes = int(corners.max(initial=0)) + 1
    low, high = corners.min(axis=1), corners.max(axis=1)
    if corners.shape[1] == 2:
        return np.asarray(low * nodes + high)
    return np.asarray((low * nodes + (corners.sum(axis=1) - low - high)) * nodes + high)


def radius_ratios(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.float64]:
    """3 inradius / circumradius: 1 for a regular tetrahedron, 0 for a flat one, (m,)."""
    corners = nodes[tets]
    faces = corners[:, _FACES]
    area = 0.5 * np.linalg.norm(np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 2] - faces[:, :, 0]), axis=2).sum(
        axis=1
    )
    length = np.linalg.norm(corners[:, _EDGES[:, 0]] - corners[:, _EDGES[:, 1]], axis=2)
    # Products of opposite edges; Crelle's formula for the circumradius.
    p, q, r = length[:, 0] * length[:, 5], length[:, 1] * length[:, 4], length[:, 2] * length[:, 3]
    crelle = np.sqrt(np.maximum((p + q + r) * (-p + q + r) * (p - q + r) * (p + q - r), 1e-300))
    volume = np.abs(volumes(nodes, tets))
    return np.asarray(3 * (3 * volume / area) / (crelle / (24 * np.maximum(volume, 1e-300))))


def dihedral_angles(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.float64]:
    """The six angles between faces, degrees, (m, 6)."""
    faces = nodes[tets][:, _FACES]
    normal = np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 2] - faces[:, :, 0])
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    cosine = -np.einsum("eki,eki->ek", normal[:, _EDGES[:, 0]], normal[:, _EDGES[:, 1]])
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def quality_report(nodes: NDArray[np.float64], tets: NDArray[np.int64]) -> Report:
    """Counts, volume and shape of a mesh, JSON-ready."""
    ratio, angle = radius_ratios(nodes, tets), dihedral_angles(nodes, tets)
    pairs = tets[:, _EDGES].reshape(-1, 2)
    edges = pairs[np.unique(_keys(pairs), return_index=True)[1]]
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    volume = volumes(nodes, tets)
    return {
        "nodes": len(nodes),
        "tets": len(tets),
        "volume_ml": float(volume.sum() / 1e3),
        "min_tet_volume_mm3": float(volume.min()),
        "edge_length_mm": {"min": float(length.min()), "mean": float(length.mean()), "max": float(length.max())},
        "radius_ratio": {
            "min": float(ratio.min()),
            "percentile_1": float(np.percentile(ratio, 1)),
            "mean": float(ratio.mean()),
        },
        "dihedral_angle_deg": {
            "min": float(angle.min()),
            "percentile_1": float(np.percentile(angle.min(axis=1), 1)),
            "max": float(angle.max()),
        },
    }
