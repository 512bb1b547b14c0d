"""The bench of the force in steps of one percent: its bodies are there, and it sees a jump."""

from __future__ import annotations

import numpy as np
import pytest

from bench.percents import beside_neighbours, bodies


def test_a_jump_is_seen_and_a_smooth_curve_is_none() -> None:
    percents = np.arange(20.0, 61.0)
    curve = 10 * np.exp(0.05 * (percents - 20) + 4e-4 * (percents - 20) ** 2)
    assert np.nanmax(beside_neighbours(curve)) < 1e-6
    curve[20] *= 1.015
    away = beside_neighbours(curve)
    assert away[20] == pytest.approx(0.015, rel=1e-3)
    assert np.isnan(away[[0, 1, -2, -1]]).all()


@pytest.mark.parametrize("name", ["odd-muscle", "outline-round"])
def test_a_body_is_there(name: str) -> None:
    assert bodies()[name]().labels.astype(bool).mean() * 1e3 > 100
