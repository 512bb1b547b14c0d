"""What a detector has and keeps: gain of pixels and columns, structure, dead pixels, by its serial number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core import rng
from simcore.core.geometry import Detector
from simcore.detection.normals import normals
from simcore.detection.spec import FixedPattern

FloatArray = NDArray[np.float32]
FARTHEST = 4.0
"""Standard deviations at which gains are cut off: none becomes 0 or below."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """Of one detector.

    known: float32 (ny, nx), the gain that calibration can see, mean 1. gain: known times structure.
    dead: bool (ny, nx).
    """

    known: FloatArray
    gain: FloatArray
    dead: NDArray[np.bool_]


def pattern(spec: FixedPattern, detector: Detector) -> Pattern:
    """The same for the same serial number, size and spreads."""
    shape = (detector.ny, detector.nx)
    known = np.ones(shape, np.float32)
    if spec.gain_spread > 0:
        known += np.float32(spec.gain_spread) * _drawn(spec, "gain", shape)
    if spec.column_spread > 0:
        known *= 1 + np.float32(spec.column_spread) * _drawn(spec, "columns", (1, detector.nx))
    known /= np.float32(known.mean(dtype=np.float64))
    gain = known
    if spec.structure > 0:
        gain = known * (1 + np.float32(spec.structure) * _drawn(spec, "structure", shape))
    return Pattern(known, gain, _dead(spec, shape))


def _drawn(spec: FixedPattern, name: str, shape: tuple[int, int]) -> FloatArray:
    return np.clip(normals(rng.key(spec.serial, "detector", name), shape), -FARTHEST, FARTHEST)


def _dead(spec: FixedPattern, shape: tuple[int, int]) -> NDArray[np.bool_]:
    dead = np.zeros(shape, np.bool_)
    stream = rng.stream(spec.serial, "detector", "dead")
    count = round(spec.dead_fraction * dead.size)
    dead.ravel()[stream.choice(dead.size, count, replace=False)] = True
    columns = min(spec.dead_columns, shape[1])
    dead[:, rng.stream(spec.serial, "detector", "dead columns").choice(shape[1], columns, replace=False)] = True
    return dead
