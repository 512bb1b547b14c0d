"""Normal random numbers that are a function of key, row and column: any block can be drawn by any thread.

Philox4x32-10 (J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3",
Proc. SC11 (2011) 16); its four words make four numbers by G. E. P. Box, M. E. Muller, Ann. Math. Stat. 29 (1958) 610.
Logarithm, sine and cosine are polynomials (Cephes library, S. L. Moshier), so that the loop runs in vectors and bytes
do not hang on a mathematical library. The largest number is 6.7.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.kernels import njit

FloatArray = NDArray[np.float32]
LANES = 64
BLOCK = 4 * LANES
"""Columns whose numbers are drawn together."""
ROUNDS = 10
LOW = np.uint64(0xFFFFFFFF)
HALF_WORD = np.uint64(32)
SIGN = np.int32(-(2**31))
FIRST_FACTOR, SECOND_FACTOR = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
FIRST_STEP, SECOND_STEP = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)


@njit(inline="always")
def philox(c0: Any, c1: Any, c2: Any, c3: Any, k0: Any, k1: Any) -> Any:
    """Four words of 32 bits from a counter of four and a key of two, all uint64."""
    for _ in range(ROUNDS):
        first, second = FIRST_FACTOR * c0, SECOND_FACTOR * c2
        c0, c1, c2, c3 = (
            (second >> HALF_WORD) ^ c1 ^ k0,
            second & LOW,
            (first >> HALF_WORD) ^ c3 ^ k1,
            first & LOW,
        )
        k0, k1 = (k0 + FIRST_STEP) & LOW, (k1 + SECOND_STEP) & LOW
    return c0, c1, c2, c3


@njit(inline="always")
def _radius(word: Any) -> Any:
    """sqrt(-2 ln u), u = (word + 1/2) / 2^32, the mantissa taken between sqrt(1/2) and sqrt(2)."""
    bits = np.float32(np.float32(np.uint32(word)) + np.float32(0.5)).view(np.int32)
    exponent = np.int32(bits - np.int32(0x3F3504F3)) >> np.int32(23)
    x = np.int32(bits - (exponent << np.int32(23))).view(np.float32) - np.float32(1.0)
    y = np.float32(7.0376836292e-2) * x - np.float32(1.1514610310e-1)
    y = y * x + np.float32(1.1676998740e-1)
    y = y * x - np.float32(1.2420140846e-1)
    y = y * x + np.float32(1.4249322787e-1)
    y = y * x - np.float32(1.6668057665e-1)
    y = y * x + np.float32(2.0000714765e-1)
    y = y * x - np.float32(2.4999993993e-1)
    y = y * x + np.float32(3.3333331174e-1)
    square = x * x
    logarithm = x + (y * x * square - np.float32(0.5) * square)
    logarithm = logarithm + np.float32(exponent - np.int32(32)) * np.float32(0.69314718056)
    return np.sqrt(np.float32(np.abs(np.float32(-2.0) * logarithm)))


@njit(inline="always")
def _direction(word: Any) -> Any:
    """Cosine and sine of a turn of word / 2^32 and an eighth: two bits say the quarter, the others the place in it."""
    bits = np.int32(np.uint32(word))
    place = np.float32(bits & np.int32(0x3FFFFFFF)) * np.float32(2.0**-30) - np.float32(0.5)
    angle = place * np.float32(1.5707963267948966)
    z = angle * angle
    sine = np.float32(-1.9515295891e-4) * z + np.float32(8.3321608736e-3)
    sine = np.float32((sine * z - np.float32(1.6666654611e-1)) * z * angle + angle)
    cosine = np.float32(2.443315711809948e-5) * z - np.float32(1.388731625493765e-3)
    cosine = np.float32((cosine * z + np.float32(4.166664568298827e-2)) * z * z - np.float32(0.5) * z + np.float32(1.0))
    # Bit operations and no branches: the loop has to run in vectors.
    odd = -((bits >> np.int32(30)) & np.int32(1))
    opposite = bits & SIGN
    c, s = cosine.view(np.int32), sine.view(np.int32)
    along = np.int32(((c & ~odd) | ((s ^ SIGN) & odd)) ^ opposite)
    across = np.int32(((s & ~odd) | (c & odd)) ^ opposite)
    return along.view(np.float32), across.view(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_row(key: NDArray[np.uint64], row: int, out: FloatArray) -> None:
    """Normal numbers of one row.

    key: uint64 (2,), below 2^32. out: (n,), n a multiple of BLOCK.
    """
    words = np.empty((4, LANES), np.uint32)
    w0, w1, w2, w3 = words[0], words[1], words[2], words[3]
    k0, k1 = key[0], key[1]
    c1, zero = np.uint64(row) & LOW, np.uint64(0)
    for start in range(0, len(out), BLOCK):
        first = np.uint64(start // 4)
        for lane in range(LANES):
            a, b, c, d = philox(first + np.uint64(lane), c1, zero, zero, k0, k1)
            w0[lane], w1[lane], w2[lane], w3[lane] = np.uint32(a), np.uint32(b), np.uint32(c), np.uint32(d)
        _box_muller(w0, w1, out[start : start + 2 * LANES])
        _box_muller(w2, w3, out[start + 2 * LANES : start + BLOCK])


@njit(nogil=True, error_model="numpy")
def _box_muller(sizes: NDArray[np.uint32], turns: NDArray[np.uint32], out: FloatArray) -> None:
    first, second = out[:LANES], out[LANES:]
    for lane in range(LANES):
        radius = _radius(sizes[lane])
        along, across = _direction(turns[lane])
        first[lane] = radius * along
        second[lane] = radius * across


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(key: NDArray[np.uint64], out: FloatArray) -> None:
    rows, columns = out.shape
    line = np.empty(-(-columns // BLOCK) * BLOCK, np.float32)
    for row in range(rows):
        fill_row(key, row, line)
        out[row] = line[:columns]


def normals(key: NDArray[np.uint64], shape: tuple[int, int]) -> FloatArray:
    """Independent normal numbers, float32; those of the same key, row and column are the same in any shape."""
    numbers = np.empty(shape, np.float32)
    _fill(key, numbers)
    return numbers
