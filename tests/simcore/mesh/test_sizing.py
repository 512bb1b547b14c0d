"""Shorter edges at borders of tissues."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.mesh import TetwildMesh, build
from simcore.mesh.quality import volumes
from simcore.mesh.sizing import SizingField, sizing_field

RADIUS, GLAND_RADIUS = 60.0, 30.0


@pytest.fixture(scope="module")
def half_ball() -> Phantom:
    """Fat of RADIUS around gland of GLAND_RADIUS, both centred on the wall."""
    voxel, n = 1.5, 84
    grid = Grid((n, n, n // 2), (voxel,) * 3, (0.0, -n * voxel / 2, -n * voxel / 2))
    x, y = grid.centres("x")[None, None, :], grid.centres("y")[None, :, None]
    r = np.sqrt(x**2 + y**2 + grid.centres("z")[:, None, None] ** 2)
    labels = np.select([r < GLAND_RADIUS, r < RADIUS], [int(Tissue.GLAND), int(Tissue.ADIPOSE)], int(Tissue.AIR))
    return Phantom(labels.astype(np.uint8), grid)


def at_radius(field: SizingField, radius: float) -> np.ndarray:
    """Edge lengths around the centre of the wall, at 0, 30 and 60 degrees from it."""
    angle = np.radians([0.0, 30.0, 60.0])
    points = radius * np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    axes = [np.unique(field.points[:, k]) for k in range(3)]
    return np.asarray(RegularGridInterpolator(axes, field.lengths.reshape([len(a) for a in axes]))(points))


def test_edges_are_shorter_at_the_two_borders(half_ball: Phantom) -> None:
    field = sizing_field(half_ball, 8.0, 2.0)
    for border in (GLAND_RADIUS, RADIUS):
        assert at_radius(field, border) == pytest.approx(4.0, rel=0.1)
    for inside in (0.0, 10.0, 45.0):
        assert at_radius(field, inside) == pytest.approx(8.0, rel=0.05)
    assert field.lengths.max() == pytest.approx(8.0)
    assert field.lengths.min() == pytest.approx(4.0)


def test_background_mesh_covers_the_body(half_ball: Phantom) -> None:
    field = sizing_field(half_ball, 8.0, 2.0)
    assert field.points[:, 0].min() < 0
    assert field.points.max() > RADIUS
    each = np.abs(volumes(field.points, field.tets.astype(np.int64)))
    assert each.sum() == pytest.approx(np.prod(np.ptp(field.points, axis=0)))
    assert len(field.lengths) == len(field.points)


def test_same_bytes_for_any_number_of_threads(half_ball: Phantom, threads: Callable[[int], None]) -> None:
    fields = []
    for count in (1, 2):
        threads(count)
        fields.append(sizing_field(half_ball, 8.0, 3.0).lengths.tobytes())
    assert fields[0] == fields[1]


def test_tetwild_follows_the_sizing_field(half_ball: Phantom) -> None:
    spec = TetwildMesh(edge_length_mm=16.0, epsilon=3e-3)
    uniform, graded = build(half_ball, spec), build(half_ball, spec.with_(border_refinement=2.0))
    assert len(graded.tets) > 1.8 * len(uniform.tets)

    def gain(*shells: tuple[float, float]) -> float:
        """Tetrahedra of the graded mesh over those of the uniform one, with their middle in one of the shells."""
        counts = []
        for mesh in (graded, uniform):
            radius = np.linalg.norm(mesh.nodes[mesh.tets].mean(axis=1), axis=1)
            counts.append(sum(np.count_nonzero((radius > low) & (radius < high)) for low, high in shells))
        return counts[0] / counts[1]

    assert gain((GLAND_RADIUS - 4, GLAND_RADIUS + 4)) > 1.4 * gain((0, 18), (40, 48))
