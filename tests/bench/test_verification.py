"""The quick part of the verification of the compression, and the peers that it compares with."""

from __future__ import annotations

import numpy as np
import pytest

from bench.peers import calculix
from bench.support.bodies import C_CUP, ONE_TISSUE, as_quadratic
from bench.verification import breast, calculix_ladder, exact, plates, wall
from bench.verification.check import Check, absolute, at_least, relative
from bench.verification.explicit import relax
from bench.verification.page import page
from simcore.fem import CompressionSpec, compress
from simcore.mesh.structured import box, half_ellipsoid
from tests.support.services import need


def assert_all_hold(checks: list[Check]) -> None:
    assert checks
    assert [f"{c.what}: {c.got} for {c.expected}" for c in checks if not c.passed] == []


def test_affine_deformations_and_tangent() -> None:
    assert_all_hold([*exact.affine_checks(), *exact.tangent_checks()])


def test_manufactured_solution_converges_without_locking() -> None:
    for nu, errors in exact.manufactured_orders((4, 6)).items():
        # Half of the asymptotic order would mean a mistake; the long verification reaches 1.8.
        assert exact.order(errors) > 1.5, nu
        assert errors[-1][1] < 1e-3


def test_manufactured_field_preserves_volume() -> None:
    points = np.random.default_rng(1).uniform(-10, 30, (50, 3))
    displacement, gradient = exact.manufactured_field(points)
    assert np.linalg.det(gradient) == pytest.approx(np.ones(50), rel=1e-12)
    for j in range(3):
        step = 1e-5 * np.eye(3)[j]
        slope = (exact.manufactured_field(points + step)[0] - exact.manufactured_field(points - step)[0]) / 2e-5
        assert np.abs(slope + np.eye(3)[j] - gradient[..., j]).max() < 1e-8
    assert np.abs(displacement).max() > 0.5


def test_explicit_relaxation_and_scikit_fem_find_the_same_equilibrium() -> None:
    assert_all_hold([*breast.relaxation_checks(cells=4), *breast.scikit_checks(cells=4)])


def test_explicit_relaxation_of_another_material_differs() -> None:
    mesh = half_ellipsoid(C_CUP, 4)
    softer = relax(mesh, exact.MATERIAL.with_(youngs_modulus_kPa=60.0).law(), 50.0)
    ours = compress(mesh, ONE_TISSUE, breast.SPEC)
    assert softer.force_N == pytest.approx(60.0 / 60.6 * ours.force_N, rel=1e-4)


def test_quadratic_tetrahedra_have_the_same_nodes() -> None:
    mesh, quadratic = as_quadratic(C_CUP, 6)
    assert len(quadratic) == len(mesh.tets) / 8
    assert set(quadratic.ravel()) == set(range(len(mesh.nodes)))
    corners = mesh.nodes[quadratic]
    assert (np.linalg.det(corners[:, 1:4] - corners[:, :1]) > 0).all()
    bent = corners[:, 4:] - 0.5 * (corners[:, [0, 1, 0, 0, 1, 2]] + corners[:, [1, 2, 2, 3, 3, 3]])
    edge = np.linalg.norm(corners[:, [0, 1, 0, 0, 1, 2]] - corners[:, [1, 2, 2, 3, 3, 3]], axis=-1)
    assert (np.linalg.norm(bent, axis=-1) < 0.35 * edge).all()


def test_another_volumetric_energy_changes_the_force_a_little_and_scikit_fem_agrees() -> None:
    same, change = calculix_ladder.energy_checks(cells=6)
    assert_all_hold([same, change])
    # Lost volume: 1.7 %, of which the third order of the energy makes a share.
    assert -2e-3 < change.error < -3e-4


def test_a_difference_that_falls_with_the_square_of_the_size_has_no_limit_but_its_own() -> None:
    order, limit = calculix_ladder.fitted([(h, -2.0 * h**2) for h in (0.1, 0.07, 0.05)])
    assert order == pytest.approx(2)
    assert limit == pytest.approx(0, abs=1e-12)
    assert calculix_ladder.fitted([(h, 3e-3 - 2.0 * h**2) for h in (0.1, 0.07, 0.05)])[1] == pytest.approx(3e-3)


def test_forces_of_calculix_are_kept_for_every_mesh_and_ours_are_near_them() -> None:
    rungs = calculix_ladder.recorded()
    assert tuple(r.cells for r in rungs) == calculix_ladder.CELLS
    assert [r.tets for r in rungs] == [4 * n**3 for n in calculix_ladder.CELLS]
    assert_all_hold(list(calculix_ladder.ladder_checks(rungs[:2]))[:2])


def test_a_plate_of_ritz_bends_like_meshed_plexiglas() -> None:
    assert_all_hold(list(plates.plate_checks(cells=6)))


def test_an_edge_at_the_fixed_wall_and_none() -> None:
    edged, flat = wall.force(wall.SPEC, 8), wall.force(wall.SPEC.with_(plate_edge_mm=wall.NONE_MM), 8)
    assert edged < 0.7 * flat


@pytest.mark.needs_calculix
def test_calculix_agrees_on_a_block_and_nearly_on_a_breast() -> None:
    need("ccx", "calculix-ccx")
    block = box((30.0, 40.0, 20.0), (2, 4, 2))
    ours = compress(block, ONE_TISSUE, CompressionSpec(percent=30.0, material=exact.MATERIAL, tolerance=1e-8))
    theirs = calculix.hold(block.nodes, block.tets, exact.MATERIAL, ours)
    # Affine, so the elements do not matter; its volumetric energy is another one.
    assert theirs.force_lower_N == pytest.approx(theirs.force_upper_N, rel=1e-4)
    assert theirs.force_N == pytest.approx(ours.force_N, rel=1e-3)
    assert np.abs(theirs.displacement - ours.displacement).max() < 0.02
    mesh, quadratic = as_quadratic(C_CUP, 6)
    free = calculix.compress(mesh.nodes, quadratic, exact.MATERIAL, 50.0)
    assert free.force_N == pytest.approx(compress(mesh, ONE_TISSUE, breast.SPEC).force_N, rel=0.04)


def test_a_failed_check_is_seen_on_the_page() -> None:
    checks = [
        relative("Group", "near", 2.0, 2.01, 0.01, "N"),
        relative("Group", "far", 2.0, 2.03, 0.01, "N"),
        absolute("Group", "small", -0.1, 0.2, "mm"),
        at_least("Group", "order", 1.8, 1.7),
    ]
    assert [c.passed for c in checks] == [True, False, True, False]
    text = page(checks, ["A note."])
    assert "2 of 4 hold." in text
    assert "| Group | near | 2 N | 2.01 N | 5.0e-03 | 0.01 | holds |" in text
    assert "|  | far | 2 N | 2.03 N | 1.5e-02 | 0.01 | **fails** |" in text
