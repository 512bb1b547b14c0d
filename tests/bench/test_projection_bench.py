"""Orders of convergence of both samplings against closed forms (the tables of docs/projection_accuracy.md, smaller)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bench.projection import run as projection
from bench.projection.balls import balls, integrals, voxels
from bench.projection.page import page
from simcore.projection.materials import attenuation_table

MU = attenuation_table("johns-yaffe-20keV")


@pytest.fixture(scope="module")
def scene():
    return balls(count=8)


def test_closed_forms_are_the_sum_of_chords(scene):
    geometry = projection.acquisition(1.0)
    values = integrals(scene, geometry, 1, MU)
    # Straight through the middle of the ball of fat, and whatever lies on the way.
    centre = scene.centres[0] + [0.0, 0.0, 20.0]
    at = geometry.sources[1] + (centre - geometry.sources[1]) * 660.0 / (660.0 - centre[2])
    j, i = round(at[1] + (geometry.detector.ny - 1) / 2), round(at[0] - 0.5)
    assert values[j, i] >= 0.99 * 2 * scene.radii[0] * MU[1]
    assert values.max() <= 2 * scene.radii[0] * MU.max()
    phantom = voxels(scene, 0.5)
    assert phantom.labels.max() <= scene.labels.max()
    volume = np.count_nonzero(phantom.labels) * 0.5**3
    assert volume == pytest.approx(4 / 3 * np.pi * scene.radii[0] ** 3, rel=2e-3)


def test_both_samplings_converge_with_the_first_order(scene):
    table = projection.convergence_of_voxels(scene, MU, edges=(1.6, 0.8, 0.4))
    for name in ("exact", "trilinear", "difference"):
        orders = [np.log2(a[name] / b[name]) for a, b in pairwise(table)]
        assert min(orders) > 0.75, name
        assert np.mean(orders) > 0.85, name
    assert table[-1]["exact"] < 0.02


def test_the_step_converges_with_the_second_order(scene):
    errors = [row["error"] for row in projection.convergence_of_steps(scene, MU, edge=1.6)]
    assert errors[0] / errors[2] > 8
    assert errors[0] < 0.03 * projection.convergence_of_voxels(scene, MU, edges=(1.6,))[0]["trilinear"]


def test_page_of_what_was_measured():
    row = {"edge_mm": 0.2, "exact": 0.02, "trilinear": 0.01, "difference": 0.01}
    pixels = [
        {"edge_mm": edge, "form": form, "rays": 2, "rms": rms, "p999": 0.1}
        for edge, form, rms in [(0.2, "labels", 0.01), (0.2, "partial volume", 0.009), (0.1, "labels", 0.004)]
    ]
    maps = {"one_s": 1.0, "four_s": 4.0, "maps_s": 2.0, "ratio": 2.0, "largest_difference": 1e-6}
    text = page({"voxels": [row, row], "steps": [{"step": 0.45, "error": 0.1}] * 2, "pixels": pixels, "maps": maps})
    assert "takes 10% off" in text
    assert "take 60%" in text
