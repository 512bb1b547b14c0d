"""Known objects (lesions) carried along by the deformation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import TetMesh


def carried(
    truth: tuple[dict[str, Any], ...], mesh: TetMesh, deformed: NDArray[np.float64]
) -> tuple[dict[str, Any], ...]:
    """The entries with their "centre_mm" (x, y, z) moved; where it was stands in "uncompressed_centre_mm".

    deformed: (n, 3) node positions, mm, in the frame wanted.
    """
    moved = []
    for entry in truth:
        if "centre_mm" not in entry:
            moved.append(dict(entry))
            continue
        centre = moved_point(np.array(entry["centre_mm"], dtype=np.float64), mesh, deformed)
        moved.append(
            {
                **entry,
                "centre_mm": [round(float(c), 4) for c in centre],
                "uncompressed_centre_mm": list(entry["centre_mm"]),
            }
        )
    return tuple(moved)


def moved_point(point: NDArray[np.float64], mesh: TetMesh, deformed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a point of the undeformed mesh goes; from outside, by the map of the tetrahedron it is least outside of."""
    corners = mesh.nodes[mesh.tets]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (point - corners[:, 0])[..., None])[..., 0]
    weights = np.concatenate([1.0 - weights.sum(axis=1, keepdims=True), weights], axis=1)
    nearest = int(np.argmax(weights.min(axis=1)))
    position: NDArray[np.float64] = weights[nearest] @ deformed[mesh.tets[nearest]]
    return position
