"""The tissues of a label volume. The value is what stands in a voxel."""

from __future__ import annotations

from enum import IntEnum


class Tissue(IntEnum):
    """Label values, uint8. Small and contiguous: kernels look them up in a table of MAX_TISSUES entries."""

    AIR = 0
    ADIPOSE = 1
    GLAND = 2
    SKIN = 3
    LIGAMENT = 4
    MASS = 5
    CALCIFICATION = 6
    MUSCLE = 7
    NIPPLE = 8
    DUCT = 9
    TDLU = 10
    ARTERY = 11
    VEIN = 12


MAX_TISSUES = 16
