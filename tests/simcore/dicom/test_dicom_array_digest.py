import numpy as np
import pytest

from simcore.dicom.content import array_digest

GENERATOR = np.random.default_rng(5)
ARRAY = GENERATOR.integers(0, 65536, (3, 50, 41), np.uint16)


def test_it_is_that_of_the_content():
    assert array_digest(ARRAY) == array_digest(ARRAY.copy()) == array_digest(np.asfortranarray(ARRAY))
    assert len(array_digest(ARRAY)) == 64


@pytest.mark.parametrize("bit", [0, 7, 15])
def test_every_bit_of_every_pixel_counts(bit):
    """The last pixels of a plane are beyond its last whole group of words."""
    seen = {array_digest(ARRAY)}
    pixels = [tuple(GENERATOR.integers(0, ARRAY.shape)) for _ in range(200)] + [(1, 49, k) for k in range(41)]
    for pixel in pixels:
        other = ARRAY.copy()
        other[pixel] ^= np.uint16(1 << bit)
        seen.add(array_digest(other))
    assert len(seen) == len(set(pixels)) + 1


def test_order_shape_and_type_count():
    rows = ARRAY[:, ::-1]
    planes = ARRAY[::-1]
    swapped = ARRAY.copy()
    swapped[0, 0, [3, 35]] = swapped[0, 0, [35, 3]]  # the same lane of two groups of words
    others = [rows, planes, swapped, ARRAY.reshape(3, 41, 50), ARRAY.view(np.int16), np.zeros_like(ARRAY)]
    others += [np.zeros((3, 50, 40), np.uint16), np.zeros((0, 50, 41), np.uint16)]
    assert len({array_digest(a) for a in [ARRAY, *others]}) == len(others) + 1
