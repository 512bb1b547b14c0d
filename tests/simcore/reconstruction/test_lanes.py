"""Resampling of rows against its definition."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.reconstruction.operators.lanes import LANES, ROWS, add_resampled_rows, padded_width, padding


def by_definition(rows, offset, step, reach, count):
    distance = np.abs((offset + step * np.arange(count))[:, None] - np.arange(rows.shape[1]))
    return rows @ np.maximum(0.0, 1.0 - distance / reach).T


@pytest.mark.parametrize("columns", [1, 15, 70])
def test_equals_the_definition(columns):
    rng = np.random.default_rng(columns)
    for _ in range(400):
        step, reach = rng.choice([0.11, 0.9, 1.0, 1.07, 1.9, 3.3]), rng.choice([1.0, 1.0, 1.6, 4.2])
        # Windows begin and end anywhere about the ends of the row, at whole pixels too.
        offset = rng.uniform(-20 * step, columns + 4) if rng.random() < 0.7 else float(rng.integers(-20, columns + 2))
        count = int(rng.integers(1, 50))
        pad = padding(step, reach)
        padded = np.zeros((ROWS, columns + 2 * pad), np.float32)
        rows = rng.normal(size=(ROWS, columns)).astype(np.float32)
        padded[:, pad : pad + columns] = rows
        start = rng.normal(size=(ROWS, padded_width(count))).astype(np.float32)
        totals = start.copy()
        add_resampled_rows(padded, pad, offset, step, reach, totals)
        expected = start[:, :count] + by_definition(rows.astype(np.float64), offset, step, reach, count)
        np.testing.assert_allclose(totals[:, :count], expected, atol=2e-5)


def test_windows_read_nothing_outside_the_row():
    """The padding suffices: what stands beyond it does not matter."""
    for step, reach in [(0.11, 1.0), (1.07, 1.0), (3.3, 1.0), (3.3, 3.3), (9.0, 9.0)]:
        pad = padding(step, reach)
        around = np.full((3 * ROWS, 30 + 2 * pad), np.nan, np.float32)
        around[ROWS : 2 * ROWS] = 0.0
        around[ROWS : 2 * ROWS, pad : pad + 30] = 1.0
        for offset in np.arange(-20.0 * step, 40.0, 0.37):
            totals = np.zeros((ROWS, 3 * LANES), np.float32)
            add_resampled_rows(around[ROWS : 2 * ROWS], pad, float(offset), step, reach, totals)
            assert np.all(np.isfinite(totals))
