"""Stored values of an image: histogram in words, and what was clipped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report

LEVELS = 65536
"""Different values of a 16-bit image."""
PERCENTILES = (1.0, 50.0, 99.0)


def value_counts(values: NDArray[np.uint16]) -> NDArray[np.int64]:
    """How often each 16-bit value occurs, int64 (65536,). Counts of several images may be added."""
    return np.bincount(values.ravel(), minlength=LEVELS)


def percentile(counts: NDArray[np.int64], percent: float) -> int:
    """The smallest value that at least ``percent`` of all values do not exceed."""
    running = np.cumsum(counts)
    return int(np.searchsorted(running, max(1.0, running[-1] * percent / 100.0)))


def summary(counts: NDArray[np.int64], slope: float = 1.0, intercept: float = 0.0) -> Report:
    """Minimum, percentiles, mean and maximum, each as slope x stored value + intercept; empty without any value."""
    present = np.flatnonzero(counts)
    if len(present) == 0:
        return {}
    mean = float(counts @ np.arange(LEVELS, dtype=np.float64)) / float(counts.sum())
    stored = {
        "min": float(present[0]),
        **{f"p{p:g}": float(percentile(counts, p)) for p in PERCENTILES},
        "mean": mean,
        "max": float(present[-1]),
    }
    return {name: slope * value + intercept for name, value in stored.items()}


def clipped(counts: NDArray[np.int64], highest: int = LEVELS - 1) -> Report:
    """Fractions of the values that stand at the lowest and at the highest value that can be stored."""
    total = int(counts.sum())
    return {"low": int(counts[0]) / total, "high": int(counts[highest]) / total} if total else {}
