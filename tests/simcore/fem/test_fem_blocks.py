"""Blocks in registers against numpy, and the pattern of the tangent against a plain search."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from simcore.fem import blocks as b
from simcore.fem.elements.model import Pattern
from simcore.mesh.structured import box
from simcore.simd.vector import fma, plus, times


@njit
def _every_operation(blocks: Any, rows: Any, out: Any, sums: Any) -> None:
    row = b.row_at(rows, 1)
    block = b.block_at(blocks, 1)
    b.put(out, 0, b.in_rows(row))
    b.put(out, 1, b.in_columns(row))
    b.put(out, 2, times(block, b.in_rows(row)))
    b.put(out, 3, fma(block, b.in_columns(row), b.block_at(blocks, 0)))
    b.put(out, 4, plus(b.on_diagonal(row), block))
    b.add(out, 4, block)
    b.put(sums, 0, b.sum_of_rows(block))
    b.put(sums, 1, b.sum_of_columns(block))
    b.put(sums, 2, b.row_of(rows, 1.0, np.float32(2.5), 3, 4.0))
    b.add(sums, 2, row)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_operations_on_blocks_are_numpys(kind: type[np.floating[Any]]) -> None:
    generator = np.random.default_rng(4)
    blocks, rows = generator.normal(size=(2, 4, 4)).astype(kind), generator.normal(size=(3, 4)).astype(kind)
    out, sums = np.zeros((5, 4, 4), kind), np.zeros((3, 4), kind)
    _every_operation(blocks, rows, out, sums)
    row, block, first = (x.astype(np.float64) for x in (rows[1], blocks[1], blocks[0]))
    out, sums = out.astype(np.float64), sums.astype(np.float64)
    tolerance = float(4 * np.finfo(kind).eps)
    expected = [np.tile(row, (4, 1)), np.tile(row, (4, 1)).T, block * row, block * row[:, None] + first]
    expected.append(np.diag(row) + 2 * block)
    assert out == pytest.approx(np.array(expected, np.float64), rel=tolerance, abs=tolerance)
    assert sums[0] == pytest.approx(block.sum(axis=0), rel=tolerance, abs=4 * tolerance)
    assert sums[1] == pytest.approx(block.sum(axis=1), rel=tolerance, abs=4 * tolerance)
    assert sums[2] == pytest.approx(row + np.array([1, 2.5, 3, 4]), rel=tolerance)


def test_the_pattern_holds_every_pair_of_corners_once() -> None:
    mesh = box((30.0, 40.0, 20.0), (3, 2, 2))
    tets, count = np.sort(mesh.tets, axis=1), len(mesh.nodes)
    pattern = Pattern.of(tets, count)
    pairs = {(int(t[i]), int(t[j])) for t in tets for i in range(4) for j in range(i, 4)}
    row: NDArray[np.int64] = np.repeat(np.arange(count), np.diff(pattern.row_start))
    stored = list(zip(row.tolist(), pattern.column.tolist(), strict=True))
    assert stored == sorted(pairs)
    assert (pattern.column[pattern.row_start[:-1]] == np.arange(count)).all()
    for tet, places in zip(tets, pattern.block_of, strict=True):
        corners = [(int(tet[i]), int(tet[j])) for i in range(4) for j in range(i, 4)]
        assert [stored[k] for k in places] == corners
