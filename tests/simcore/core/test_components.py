"""Connected components slab by slab against those of the whole array."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.ndimage import label

from simcore.core.components import Components, slabs


@pytest.mark.parametrize("corners", [False, True])
@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
@pytest.mark.parametrize("cuts", [[0, 17], [0, 3, 4, 9, 17], list(range(18))])
def test_slabs_give_the_components_of_the_whole(corners: bool, share: float, cuts: list[int]) -> None:
    mask = np.random.default_rng(1).random((17, 13, 11)) < share
    expected, count = label(mask, np.ones((3, 3, 3)) if corners else None)
    components = Components(corners)
    numbers = np.concatenate([components.add(mask[a:b]) for a, b in itertools.pairwise(cuts)])
    extents = components.extents()
    assert len(extents) == count
    of = extents.of[numbers]
    np.testing.assert_array_equal(of >= 0, mask)
    assert len(np.unique(np.stack([expected[mask], of[mask]], axis=1), axis=0)) == count
    beginnings = []
    for k in range(count):
        voxels = np.argwhere(of == k)
        assert extents.voxels[k] == len(voxels)
        np.testing.assert_array_equal(extents.first[k], voxels.min(axis=0))
        np.testing.assert_array_equal(extents.behind[k], voxels.max(axis=0) + 1)
        np.testing.assert_allclose(extents.centre[k], voxels.mean(axis=0))
        beginnings.append(tuple(voxels[0]))
    assert beginnings == sorted(beginnings)


def test_nothing_has_no_components() -> None:
    components = Components()
    for _, slab in slabs(np.zeros((4, 3, 2), np.uint8)):
        components.add(slab > 0)
    assert len(components.extents()) == 0
