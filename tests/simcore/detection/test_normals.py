"""Counter-based normal numbers against the published words and against the mathematical library."""

import math

import numpy as np
import pytest
from numba import njit
from scipy import stats

from simcore.core import rng
from simcore.detection.normals import BLOCK, LANES, normals, philox

KEY = rng.key(7, "test")


@njit
def words_of(counter, key):
    return philox(counter[0], counter[1], counter[2], counter[3], key[0], key[1])


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        ((0,) * 4, (0,) * 2, (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_known_answers_of_the_publication(counter, key, words):
    assert words_of(np.array(counter, np.uint64), np.array(key, np.uint64)) == words


def test_numbers_are_those_of_box_and_muller():
    row, column = 5, 300
    drawn = normals(KEY, (row + 1, 2 * BLOCK))
    block, lane = divmod(column, BLOCK)
    quarter, place = divmod(lane, LANES)
    counter = np.array([block * LANES + place, row, 0, 0], np.uint64)
    words = words_of(counter, KEY)
    size, turn = words[2 * (quarter // 2) : 2 * (quarter // 2) + 2]
    radius = math.sqrt(-2 * math.log((size + 0.5) / 2**32))
    # Two bits are the quarter turn, the others the place in it, an eighth turn back.
    angle = 2 * math.pi * ((turn >> 30) / 4 + (turn & 0x3FFFFFFF) / 2**32) - math.pi / 4
    expected = radius * (math.sin(angle) if quarter % 2 else math.cos(angle))
    assert drawn[row, column] == pytest.approx(expected, abs=2e-6)


def test_they_are_normal_and_independent():
    drawn = normals(KEY, (1024, 1024)).astype(np.float64)
    assert drawn.mean() == pytest.approx(0, abs=4e-3)
    assert drawn.var() == pytest.approx(1, abs=6e-3)
    assert stats.kurtosis(drawn.ravel()) == pytest.approx(0, abs=0.02)
    assert stats.kstest(drawn.ravel()[:100000], "norm").pvalue > 1e-3
    for down, across in ((0, 1), (1, 0), (0, LANES), (0, BLOCK), (3, 7)):
        shifted = drawn[down:, across:]
        rest = drawn[: 1024 - down, : 1024 - across]
        assert abs(np.mean(shifted * rest)) < 4e-3
        assert abs(np.mean((shifted**2 - 1) * (rest**2 - 1))) < 8e-3


def test_a_number_is_a_function_of_key_row_and_column():
    assert np.array_equal(normals(KEY, (40, 700))[:30, :500], normals(KEY, (30, 500)))
    assert not np.array_equal(normals(rng.key(8, "test"), (30, 500)), normals(KEY, (30, 500)))


def test_keys_are_words_of_32_bits_and_leave_the_streams_as_they_were():
    assert KEY.dtype == np.uint64
    assert KEY.max() < 2**32
    assert rng.stream(0, "phantom").integers(0, 2**62) == rng.stream(0, "phantom").integers(0, 2**62)
