"""Outline, skin and grid against closed forms and an independent distance to the ellipsoid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from simcore.core.errors import PhantomError
from simcore.phantom.outline import _inner_surface_depth, outline, similar_radius
from simcore.phantom.spec import AnthropomorphicPhantom, OutlineSpec


def distance_to_ellipsoid(point: np.ndarray, axes: np.ndarray) -> float:
    """Distance of an inner point to the surface, from the secular equation by bisection (Eberly)."""

    def secular(t: float) -> float:
        return float(np.sum((axes * point / (t + axes**2)) ** 2)) - 1.0

    # For an inner point the largest root lies between -min(axes)^2 and 0.
    t = brentq(secular, -(min(axes) ** 2) * (1 - 1e-12), 0.0, xtol=1e-13, rtol=1e-14)
    foot = axes**2 * point / (t + axes**2)
    return float(np.linalg.norm(foot - point))


@pytest.mark.parametrize("thickness", [0.5, 1.45, 5.0])
def test_skin_has_the_normal_thickness(thickness: float) -> None:
    axes = (92.0, 60.0, 67.0, 53.0)
    random = np.random.default_rng(0)
    y, z = random.uniform(-60, 60, 400), random.uniform(-53, 67, 400)
    x = _inner_surface_depth(axes, y, z, thickness)
    reached = x > 0
    assert np.count_nonzero(reached) > 200
    for point in np.stack([x, y, z], axis=1)[reached]:
        c = axes[2] if point[2] > 0 else axes[3]
        assert distance_to_ellipsoid(np.abs(point), np.array([axes[0], axes[1], c])) == pytest.approx(
            thickness, abs=1e-5
        )


def test_no_tissue_where_the_chest_wall_itself_is_nearer_to_the_surface_than_the_skin() -> None:
    axes = (92.0, 60.0, 67.0, 53.0)
    y = np.linspace(1.0, 59.9, 300)
    x = _inner_surface_depth(axes, y, np.full_like(y, 10.0), 1.45)
    wall = np.array([distance_to_ellipsoid(np.array([0.0, v, 10.0]), np.array([92.0, 60.0, 67.0]))
                     if (v / 60) ** 2 + (10 / 67) ** 2 < 1 else 0.0 for v in y])  # fmt: skip
    np.testing.assert_array_equal(x > 0, wall > 1.45)


@pytest.mark.parametrize(("volume_ml", "voxel_mm"), [(700.0, 1.0), (5.0, 2.0), (20.0, 0.7), (1.0, 0.5)])
def test_voxels_count_up_to_the_volume(volume_ml: float, voxel_mm: float) -> None:
    shape = outline(AnthropomorphicPhantom(volume_ml=volume_ml, voxel_mm=voxel_mm))
    assert shape.breast_voxels * shape.grid.voxel_volume * 1e-3 == pytest.approx(volume_ml, rel=0.01)


def test_fine_voxels_leave_the_semi_axes_as_specified() -> None:
    spec = AnthropomorphicPhantom(volume_ml=100.0, voxel_mm=0.5)
    assert outline(spec).axes == spec.semi_axes()


def test_grid_stands_on_the_chest_wall_with_air_around() -> None:
    spec = AnthropomorphicPhantom(volume_ml=60.0, voxel_mm=1.0, outline=OutlineSpec(upper=1.2, lower=0.6))
    shape = outline(spec)
    grid, rows = shape.grid, shape.breast_rows
    assert grid.corner[0] == 0.0
    assert grid.corner[1] == -grid.upper[1]
    assert (grid.corner[2] / spec.voxel_mm).is_integer()  # the equator lies between two slices
    x = grid.centres("x")[None, None, :]
    y, z = grid.centres("y")[None, :, None], grid.centres("z")[:, None, None]
    inside = similar_radius(shape.axes, x, y, z) <= 1
    np.testing.assert_array_equal(inside, np.arange(grid.shape[2]) < rows[:, :, None])
    # Air: one to two voxels above, below, beside and in front; one beside each, none behind the chest wall.
    used = np.argwhere(inside)
    low, high = used.min(axis=0), np.array(grid.shape) - 1 - used.max(axis=0)
    assert low[2] == 0
    for margin in (low[0], low[1], *high):
        assert 1 <= margin <= 2


def test_skin_thicker_than_the_breast_is_refused_with_advice() -> None:
    with pytest.raises(PhantomError, match=r"skin_mm = 5 mm is thicker .* thinner skin"):
        outline(AnthropomorphicPhantom(volume_ml=2.0, voxel_mm=0.5, skin_mm=5.0))


def test_voxels_too_coarse_for_the_volume_are_refused_with_advice() -> None:
    with pytest.raises(PhantomError, match=r"voxels of 5 mm .* smaller voxels"):
        outline(AnthropomorphicPhantom(volume_ml=1.1, voxel_mm=5.0, skin_mm=0.1))
