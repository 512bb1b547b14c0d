"""Whether an array leads from a flat chest wall to the nipple, and how its axes would."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simcore.phantom.upload.paddle import refused
from simcore.phantom.upload.spec import Axes, along, kept_handed

LEAST_WALL = 0.2
"""Least area of the tissue at the chest wall relative to that of the largest plane across x."""


class Ends(NamedTuple):
    """Voxels of tissue in the first, the largest and the last plane across an axis of the array."""

    first: int
    largest: int
    last: int

    @classmethod
    def of(cls, areas: NDArray[np.int64]) -> Ends:
        """areas: of the planes from the first to the last with tissue."""
        return cls(int(areas[0]), int(areas.max()), int(areas[-1]))

    def is_wall(self, sign: str) -> bool:
        """Whether x may lead along this axis ("+") or against it ("-")."""
        near, far = (self.first, self.last) if sign == "+" else (self.last, self.first)
        return near >= LEAST_WALL * self.largest and near >= far


def check(ends: tuple[Ends, Ends, Ends], axes: Axes) -> None:
    """raises: SpecError where x does not lead from a flat chest wall to the nipple, with axes that do"""
    n = along(axes, "x")
    sign = axes[n][0]
    if ends[n].is_wall(sign):
        return
    near, far = (ends[n].first, ends[n].last) if sign == "+" else (ends[n].last, ends[n].first)
    raise refused(
        "axes",
        list(axes),
        f"the tissue covers {near} voxels of the first plane across x, {ends[n].largest} of the largest and {far} of "
        f"the last: the first must be a flat chest wall, the last the nipple; {_remedy(ends, axes, n)}",
    )


def _remedy(ends: tuple[Ends, Ends, Ends], axes: Axes, n: int) -> str:
    other = "-" if axes[n][0] == "+" else "+"
    if ends[n].is_wall(other):
        turned = [f"{other}x" if k == n else axis for k, axis in enumerate(axes)]
        return f"turn x, and y with it so that the breast is not mirrored: axes = {','.join(kept_handed(turned, axes))}"
    # Of the axes with a flat end, the one whose ends differ most.
    flat = [
        (abs(e.first - e.last) / e.largest, k, sign)
        for k, e in enumerate(ends)
        for sign in "+-"
        if k != n and e.is_wall(sign)
    ]
    if not flat:
        return "no side of it is flat: cut the volume where the breast begins"
    _, k, sign = max(flat)
    permuted = list(axes)
    permuted[n], permuted[k] = axes[k], f"{sign}x"  # type: ignore[call-overload]
    return f"permute the axes, none mirrored: axes = {','.join(kept_handed(permuted, axes))}"


def check_kept(areas: NDArray[np.int64], axes: Axes) -> None:
    """As ``check`` for the planes across x of what was cut out, counted from the chest wall on."""
    ends = Ends.of(areas)
    if not ends.is_wall("+"):
        raise refused(
            "axes",
            list(axes),
            f"the tissue that is kept covers {ends.first} voxels of the first plane across x, {ends.largest} of the "
            f"largest and {ends.last} of the last: the first must be a flat chest wall, the last the nipple; permute "
            "or turn the axes, or cut the volume where the breast begins",
        )
