"""Where the compressed breast lies between, and beyond, the plates."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Body:
    """Heights, mm.

    thickness: distance of the plates; the lower one is the breast support. below, above: how far tissue reaches beyond
    the lower and the upper plate, as beside the rim of a fixed chest wall.
    """

    thickness: float
    below: float = 0.0
    above: float = 0.0
