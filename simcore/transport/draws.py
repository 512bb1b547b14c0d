"""Random numbers of the photon histories: a hashed counter for each, so that no number depends on another history.

splitmix64 (G. L. Steele, D. Lea, C. H. Flood, OOPSLA 2014): the n-th number of a history is a hash of its start plus n
times an odd constant; the start is a hash of the key of the run and the index of the history.
"""

from __future__ import annotations

import numpy as np

from simcore.transport.compiled import inner

GAMMA = np.uint64(0x9E3779B97F4A7C15)
FIRST, SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
INDEX = np.uint64(0xD1342543DE82EF95)
UNIT = 2.0**-53


@inner
def hashed(word: np.uint64) -> np.uint64:
    """64 bits that each depend on all bits of ``word``."""
    word = (word ^ (word >> np.uint64(30))) * FIRST
    word = (word ^ (word >> np.uint64(27))) * SECOND
    return word ^ (word >> np.uint64(31))


@inner
def start(key: np.uint64, index: int) -> np.uint64:
    """The state before the first number of a history."""
    return hashed(key ^ hashed(np.uint64(index) * INDEX + GAMMA))  # type: ignore[no-any-return]


@inner
def uniform(state: np.uint64) -> tuple[np.uint64, float]:
    """The next state and a number in (0, 1)."""
    state = state + GAMMA
    return state, (float(hashed(state) >> np.uint64(11)) + 0.5) * UNIT
