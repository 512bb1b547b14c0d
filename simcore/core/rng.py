"""Random numbers come from named streams off the specification's seed.

A stream depends on the seed and its own name alone, so adding a stream (or drawing more from one) changes no other.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """A generator for the purpose ``names``, e.g. ``stream(seed, "phantom", "compartments")``.

    seed: any non-negative integer. Philox is counter-based and specified bit for bit.
    """
    text = "/".join(["tomosim", str(seed), *map(str, names)])
    key = np.frombuffer(hashlib.sha256(text.encode()).digest(), dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key[:2].copy()))
