"""The skin membrane, and the weight of the tissue."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from simcore.core.artifacts import Phantom
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.elements.membrane import Membrane
from simcore.fem.elements.model import Model
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.spec import Gravity, SkinMembrane
from simcore.mesh.structured import box, half_ellipsoid

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
Floats = NDArray[np.float64]
TENSION = 0.25
C_CUP = (92.1, 60.2, 67.3, 53.1)


def sheet(nodes: Floats, triangles: NDArray[np.int64]) -> Membrane:
    """With a full pattern, so that any triangulation goes."""
    n = len(nodes)
    row_start = np.concatenate([[0], np.cumsum(np.arange(n, 0, -1))]).astype(np.int32)
    column = np.concatenate([np.arange(a, n) for a in range(n)]).astype(np.int32)
    return Membrane.of(nodes, triangles, row_start, column, TENSION)


def forces(membrane: Membrane, nodes: Floats, displacement: Floats) -> Floats:
    force = np.zeros_like(nodes)
    membrane.add(displacement, nodes, False, force, np.empty((0, 3, 3)))
    return force


SQUARE = np.array([[0.0, 0, 0], [3, 0, 0], [3, 2, 0], [0, 2, 0], [1.3, 0.8, 0]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


@pytest.mark.parametrize(
    ("wide", "deep"),
    [(1.2, 1.3), (1.5, 0.9), (1.5, 0.7), (1.5, 1.5**-0.5 * 1.0001), (0.8, 0.9), (0.8, 1.4), (1.0, 1.0)],
)
def test_a_rectangle_carries_the_closed_form_and_no_compression(wide: float, deep: float) -> None:
    """Nominal tension mu t (l1 - 1/(l1^3 l2^2)) where both are stretched, mu t (l1 - l1^-2) where it wrinkles."""
    membrane = sheet(SQUARE, FACES)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    stretched = (SQUARE * [wide, deep, 1]) @ turn.T
    force = forces(membrane, SQUARE, stretched - SQUARE) @ turn
    taut_x, taut_y = wide - wide**-3 * deep**-2, deep - deep**-3 * wide**-2
    if taut_x < 0 or taut_y < 0:
        taut_x = max(wide - wide**-2, 0) if wide > deep else 0.0
        taut_y = max(deep - deep**-2, 0) if deep > wide else 0.0
    assert force[[1, 2]].sum(axis=0) == pytest.approx([TENSION * taut_x * 2, 0, 0], abs=1e-12)
    assert force[[2, 3], 1].sum() == pytest.approx(TENSION * taut_y * 3, abs=1e-12)
    assert force[4] == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_balloon_has_the_pressure_of_laplace() -> None:
    """p = 2 t mu / R (1/l - 1/l^7) for a sphere inflated by l."""
    points = np.random.default_rng(2).normal(size=(900, 3))
    nodes = 10 * points / np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(nodes).simplices.astype(np.int64)
    force = forces(sheet(nodes, hull), nodes, 0.4 * nodes)
    outward = -(force * nodes / 10).sum(axis=1).sum()
    pressure = 2 * TENSION / 10 * (1 / 1.4 - 1.4**-7)
    # The membrane pulls inwards with the pressure times the inflated sphere.
    assert -outward == pytest.approx(pressure * 4 * np.pi * 14**2, rel=0.02)


@pytest.mark.parametrize("spread", [0.0, 0.25, -0.25], ids=["wrinkled and taut", "taut", "mostly slack"])
def test_tangent_is_the_derivative_of_the_force(spread: float) -> None:
    membrane = sheet(SQUARE, FACES)
    generator = np.random.default_rng(3)
    displacement = spread * SQUARE + generator.normal(0, 0.25, SQUARE.shape)
    direction = generator.normal(0, 1, SQUARE.shape)
    n = len(SQUARE)
    stiffness = np.zeros((n * (n + 1) // 2, 3, 3))
    membrane.add(displacement, SQUARE, True, np.zeros_like(SQUARE), stiffness)
    rate, k = np.zeros_like(SQUARE), 0
    for a in range(n):
        for b in range(a, n):
            rate[a] += stiffness[k] @ direction[b]
            if a != b:
                rate[b] += stiffness[k].T @ direction[a]
            k += 1
    h = 1e-6
    ahead = forces(membrane, SQUARE, displacement + h * direction)
    behind = forces(membrane, SQUARE, displacement - h * direction)
    assert rate == pytest.approx((ahead - behind) / (2 * h), rel=1e-6, abs=1e-8)
    assert np.abs(rate).max() > 1e-3


def test_a_stretched_block_with_skin_is_its_parallel_sum() -> None:
    """Uniaxial tension of a block: bulk force plus that of the four sheets around it, all wrinkle-free or uniaxial."""
    mesh = box((30.0, 40.0, 20.0), (3, 4, 2))
    law = NeoHookean(poissons_ratio=0.499).law()
    laws = ElementLaws.homogeneous(law, len(mesh.tets))
    stretch, narrow = 1.3, 1.3**-0.5
    moved = mesh.nodes * np.array([stretch, narrow, narrow]) - mesh.nodes
    end = mesh.nodes[:, 0] == 30.0
    still = np.zeros(len(mesh.nodes))
    bare = Model.of(mesh, laws).internal_force(moved, still)
    clad = Model.of(mesh, laws, skin_tension=TENSION).internal_force(moved, still)
    around = 2 * (40 + 20) * TENSION * (stretch - stretch**-2)
    # The sheet over the far end is compressed in its plane and slack.
    assert (clad - bare)[end, 0].sum() == pytest.approx(around, rel=1e-9)


def test_skin_stiffens_the_breast_by_as_much_on_any_mesh() -> None:
    forces_N = []
    for cells in (5, 10):
        spec = CompressionSpec(percent=40.0, skin=SkinMembrane(youngs_modulus_kPa=500.0))
        mesh = half_ellipsoid(C_CUP, cells)
        forces_N.append([compress(mesh, ANY_PHANTOM, s).force_N for s in (spec, spec.with_(skin=None))])
    (coarse, coarse_bare), (fine, fine_bare) = forces_N
    assert fine > 1.08 * fine_bare
    assert coarse - coarse_bare == pytest.approx(fine - fine_bare, rel=0.1)
    assert coarse == pytest.approx(fine, rel=0.04)


def test_weight_rests_on_the_lower_plate() -> None:
    mesh = half_ellipsoid(C_CUP, 6)
    spec = CompressionSpec(percent=30.0)
    bare = compress(mesh, ANY_PHANTOM, spec).report
    heavy = compress(mesh, ANY_PHANTOM, spec.with_(gravity=Gravity(density_g_ml=1.0)))
    corners = mesh.nodes[mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
    weight = volume * 1e-6 * 9.80665
    assert weight > 5
    difference = heavy.report["force_lower_N"] - heavy.report["force_upper_N"]
    assert difference == pytest.approx(weight, rel=1e-3)
    assert heavy.force_N == pytest.approx(bare["force_N"], rel=0.05)


def test_weight_towards_the_wall_is_carried_by_it() -> None:
    mesh = half_ellipsoid(C_CUP, 6)
    spec = CompressionSpec(percent=30.0, gravity=Gravity(direction="-x"), tolerance=1e-7)
    report = compress(mesh, ANY_PHANTOM, spec).report
    corners = mesh.nodes[mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
    assert abs(report["wall_force_N"]) == pytest.approx(volume * 0.98e-6 * 9.80665, rel=1e-3)
    assert report["force_upper_N"] == pytest.approx(report["force_lower_N"], rel=1e-4)
