"""Vectors as values of kernels, lane by lane against numpy; memory on cache lines."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from simcore.simd import aligned
from simcore.simd.vector import (
    fma,
    load,
    magnitude,
    maximum,
    minimum,
    minus,
    negative,
    plus,
    ramp,
    splat,
    store,
    times,
    word_at,
)


def kernel(width):
    @njit
    def run(one, other, place, out):
        a, b = load(one, place, width), load(other, place, width)
        store(out, 0 * width, plus(a, b))
        store(out, 1 * width, minus(a, b))
        store(out, 2 * width, times(a, b))
        store(out, 3 * width, minimum(a, b))
        store(out, 4 * width, maximum(a, b))
        store(out, 5 * width, magnitude(negative(a)))
        store(out, 6 * width, fma(a, b, splat(one[0], width)))

    return run


@pytest.mark.parametrize("width", [4, 16])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_arithmetic_is_that_of_every_lane(width: int, kind: type) -> None:
    one, other = np.random.default_rng(1).normal(size=(2, 40)).astype(kind)
    out = np.zeros((8, width), kind)
    kernel(width)(one, other, 3, out)
    a, b = one[3 : 3 + width], other[3 : 3 + width]
    expected = [a + b, a - b, a * b, np.minimum(a, b), np.maximum(a, b), abs(a)]
    np.testing.assert_array_equal(out[:6], expected)
    np.testing.assert_allclose(out[6], a * b + one[0], rtol=1e-6)
    assert not out[7].any()


def test_the_other_one_of_what_is_not_a_number() -> None:
    one, other = np.full(16, np.nan, np.float32), np.ones(16, np.float32)
    out = np.zeros((8, 16), np.float32)
    kernel(16)(one, other, 0, out)
    assert (out[3:5] == 1.0).all()


def test_a_ramp_and_eight_bytes_at_once() -> None:
    @njit
    def run(out, labels):
        store(out, 2, ramp(4))
        return word_at(labels, 1) == word_at(labels, 2), word_at(labels, 1) == word_at(labels, 3)

    out = np.zeros(8, np.float32)
    assert run(out, np.array([1, 7, 7, 7, 7, 7, 7, 7, 7, 7, 8], np.uint8)) == (True, False)
    assert out.tolist() == [0, 0, 0, 1, 2, 3, 0, 0]


def test_vectors_of_two_kinds_and_widths_that_vary_are_refused() -> None:
    @njit
    def mixed(array):
        return plus(load(array, 0, 4), load(array, 0, 8))

    @njit
    def varying(array, width):
        store(array, 0, load(array, 0, width))

    with pytest.raises(TypingError, match="vectors of one kind: float32x4, float32x8"):
        mixed(np.zeros(16, np.float32))
    with pytest.raises(TypingError, match="the width of a vector must be a constant"):
        varying(np.zeros(16, np.float32), 4)


@pytest.mark.parametrize("count", [1, 15, 16, 1000])
def test_memory_begins_on_a_cache_line(count: int) -> None:
    for _ in range(5):
        for array in (aligned.row(count), aligned.zeros(count), aligned.empty(count, 3)):
            assert array.ctypes.data % aligned.LINE_BYTES == 0
            assert array.flags.c_contiguous
    assert not aligned.zeros(count).any()
    assert aligned.empty(count, 3).shape == (count, 3)
