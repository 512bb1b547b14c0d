"""The plates of a compression in a label volume (VICTRE's label 50): their inner planes are those of the simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SpecError
from simcore.phantom.upload.spec import Axes, along, kept_handed

WHOLE_PLATE = 0.5
"""Planes with at least this part of the voxels of the fullest plane are a plate's."""
FLAT = 0.5
"""Least part of the plates' voxels in such planes."""

Profile = NDArray[np.int64]


@dataclass(frozen=True)
class Gap:
    """Between the inner planes of the plates.

    first, behind: planes of the array across its axis along z, first and behind the last.
    single: whether the file has one plate alone; the other stands where the tissue ends.
    stray: part of the plates' voxels that lies in no plate's plane.
    """

    first: int
    behind: int
    single: bool
    stray: float


def gap(plates: tuple[Profile, Profile, Profile], body: tuple[Profile, Profile, Profile], axes: Axes) -> Gap | None:
    """Where the tissue lies between the plates; None where there are none.

    plates, body: voxels in every plane across each axis of the array. axes: where those lead.
    raises: SpecError where the plates do not lie across z, or are not two with tissue between them
    """
    total = int(plates[0].sum())
    if not total:
        return None
    upright = along(axes, "z")
    density = [int(profile.max()) / total for profile in plates]
    across = int(np.argmax(density))
    if across != upright and density[across] > 1.5 * density[upright]:
        turned = list(axes)
        turned[across], turned[upright] = axes[upright], axes[across]
        raise refused(
            "axes",
            list(axes),
            f"its compression plates lie across {axes[across][1]}, not across z, along which a breast is compressed: "
            f"permute the axes, none mirrored: axes = {','.join(kept_handed(turned, axes))}",
        )
    profile = plates[upright]
    full = profile >= WHOLE_PLATE * profile.max()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], full, [False]]).astype(np.int8)))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    stray = 1.0 - int(profile[full].sum()) / total
    if len(runs) > 2 or stray > FLAT:
        raise refused(
            "tissues",
            None,
            f"its compression plates are {len(runs)} layers along z with {stray:.0%} of their voxels elsewhere, not "
            "two flat plates: map their value to 'air' to do without, and give thickness_mm",
        )
    first, behind = _between(runs, body[upright])
    if not body[upright][first:behind].any():
        raise refused("tissues", None, "no tissue lies between its compression plates")
    return Gap(first, behind, len(runs) == 1, stray)


def _between(runs: list[tuple[int, int]], body: Profile) -> tuple[int, int]:
    if len(runs) == 2:
        return runs[0][1], runs[1][0]
    (first, behind) = runs[0]
    filled = np.flatnonzero(body)
    if int(body[:first].sum()) > int(body[behind:].sum()):
        return int(filled[0]), first
    return behind, int(filled[-1]) + 1 if len(filled) else behind


def check_thickness(thickness_mm: float, plates_mm: float, edge_mm: float) -> None:
    """raises: SpecError where a thickness is not the distance of the plates in the file, within half a voxel"""
    if abs(thickness_mm - plates_mm) > 0.5 * edge_mm:
        message = f"the plates in the file are {plates_mm:g} mm apart: leave thickness_mm out, or map them to 'air'"
        raise refused("thickness_mm", thickness_mm, message)


def refused(field: str, value: object, message: str) -> SpecError:
    """The error of an upload that is not what a specification says."""
    return SpecError(
        f"phantom.{field}{'' if value is None else f' = {value}'}: {message}",
        code="upload-mismatch",
        problems=[{"field": f"phantom.{field}", "value": value, "message": message}],
    )


def not_compressed() -> SpecError:
    """The error of a file with plates that is said not to be compressed."""
    return refused(
        "compressed",
        False,
        "the file has compression plates ('paddle', VICTRE's label 50), so that it is compressed already: say so "
        "(compressed = true, tomosim phantom add --compressed), or map their value to 'air' to do without them",
    )
