"""Known objects (lesions) carried along by the deformation."""

from __future__ import annotations

from typing import Any

import numpy as np

from simcore.warp.points import ForwardMap


def carried(truth: tuple[dict[str, Any], ...], forward: ForwardMap) -> tuple[dict[str, Any], ...]:
    """The entries with their "centre_mm" (x, y, z) moved; where it was stands in "uncompressed_centre_mm". A centre
    outside of the mesh goes by the map of the tetrahedron it is least outside of.
    """
    known = [entry for entry in truth if "centre_mm" in entry]
    points = np.array([entry["centre_mm"] for entry in known], np.float64).reshape(-1, 3)
    centres = iter(forward.moved(points, forward.tets(points)))
    return tuple(
        {
            **entry,
            "centre_mm": [round(float(c), 4) for c in next(centres)],
            "uncompressed_centre_mm": list(entry["centre_mm"]),
        }
        if "centre_mm" in entry
        else dict(entry)
        for entry in truth
    )
