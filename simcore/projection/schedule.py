"""The order in which rows are worked on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def spread(count: int) -> NDArray[np.int64]:
    """A permutation of range(count) in which any run of consecutive entries is spread evenly over the whole range.

    Threads get consecutive runs; rays that miss the breast cost nothing, so that plain order would leave one thread
    with most of the work. Multiples of the golden ratio modulo ``count``."""
    stride = max(1, round(count * (math.sqrt(5.0) - 1.0) / 2.0))
    while math.gcd(stride, count) != 1:
        stride += 1
    return (np.arange(count, dtype=np.int64) * stride) % count
