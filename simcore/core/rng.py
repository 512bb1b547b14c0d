"""Random numbers come from named streams off the specification's seed.

A stream depends on the seed and its own name alone, so adding a stream (or drawing more from one) changes no other.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """A generator for the purpose ``names``, e.g. ``stream(seed, "phantom", "compartments")``.

    seed: any non-negative integer. Philox is counter-based and specified bit for bit.
    """
    return np.random.Generator(np.random.Philox(key=_digest(seed, names, np.uint64)[:2].copy()))


def key(seed: int, *names: str | int) -> NDArray[np.uint64]:
    """The key of a stream for kernels that count themselves: uint64 (2,), each below 2^32."""
    return _digest(seed, names, np.uint32)[:2].astype(np.uint64)


def _digest(seed: int, names: tuple[str | int, ...], word: type[np.generic]) -> NDArray[Any]:
    text = "/".join(["tomosim", str(seed), *map(str, names)])
    return np.frombuffer(hashlib.sha256(text.encode()).digest(), dtype=word)
