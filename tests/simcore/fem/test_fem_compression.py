"""A coarse half-ellipsoid breast between the plates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.errors import Cancelled, SolverError
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.elements.model import Model
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.linear.tangent import Guard
from simcore.fem.newton import solver
from simcore.fem.newton.path import Solution, Target, follow
from simcore.fem.plates.contact import LOWER, UPPER, Contact, Plates
from simcore.fem.report.report import verify
from simcore.mesh.structured import half_ellipsoid

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
C_CUP = (92.1, 60.2, 67.3, 53.1)
SPEC = CompressionSpec(percent=50.0)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return half_ellipsoid(C_CUP, 8)


@pytest.fixture(scope="module")
def halved(mesh: TetMesh) -> Compression:
    return compress(mesh, ANY_PHANTOM, SPEC)


def with_nodes(mesh: TetMesh, nodes: np.ndarray) -> TetMesh:
    return TetMesh(nodes, mesh.tets, mesh.wall, mesh.skin)


def test_breast_is_squeezed_flat_and_spreads(mesh: TetMesh, halved: Compression) -> None:
    report = halved.report
    deformed = mesh.nodes + halved.displacement
    assert halved.outcome == "converged"
    assert halved.thickness == pytest.approx(60.2, rel=1e-9)
    assert halved.plate_z == pytest.approx((-53.1 + 30.1, 67.3 - 30.1))
    assert np.ptp(deformed[:, 2]) == pytest.approx(60.2, abs=1e-5)
    assert (deformed[mesh.wall, 0] == 0).all()
    assert np.ptp(deformed[:, 1]) > 1.2 * 120.4
    assert deformed[:, 0].max() > 1.15 * 92.1
    assert 150 < halved.force_N < 260
    assert -0.03 < report["volume_change"] < 0
    assert 0.5 < report["min_det_F"] < 1 < report["max_det_F"] < 1.5


def test_the_plates_balance_and_the_wall_only_guides(halved: Compression) -> None:
    report = halved.report
    assert report["force_upper_N"] == pytest.approx(report["force_lower_N"], rel=1e-4)
    assert halved.force_N == pytest.approx((report["force_upper_N"] + report["force_lower_N"]) / 2)
    assert abs(report["wall_force_N"]) < 1e-3 * halved.force_N
    assert abs(report["guard_force_N"]) < 1e-3 * halved.force_N


def test_symmetry_about_the_middle_plane(mesh: TetMesh, halved: Compression) -> None:
    order = np.lexsort(np.round(mesh.nodes, 6).T)
    mirrored = np.lexsort(np.round(mesh.nodes * [1, -1, 1] + 0.0, 6).T)
    other = halved.displacement[mirrored] * [1, -1, 1]
    assert np.abs(halved.displacement[order] - other).max() < 1e-2


def test_force_is_proportional_to_the_modulus(mesh: TetMesh, halved: Compression) -> None:
    stiffer = compress(mesh, ANY_PHANTOM, SPEC.with_(material=NeoHookean(youngs_modulus_kPa=3 * 60.6)))
    assert stiffer.force_N == pytest.approx(3 * halved.force_N, rel=1e-5)
    assert np.abs(stiffer.displacement - halved.displacement).max() < 1e-3


def test_force_grows_with_the_area(mesh: TetMesh, halved: Compression) -> None:
    larger = compress(with_nodes(mesh, 1.7 * mesh.nodes), ANY_PHANTOM, SPEC)
    assert larger.force_N == pytest.approx(1.7**2 * halved.force_N, rel=1e-5)
    assert np.abs(larger.displacement - 1.7 * halved.displacement).max() < 2e-3
    assert larger.report["mean_pressure_kPa"] == pytest.approx(halved.report["mean_pressure_kPa"], rel=1e-3)


def test_equilibrium_does_not_depend_on_the_load_steps(mesh: TetMesh, halved: Compression) -> None:
    stepped = compress(mesh, ANY_PHANTOM, SPEC.with_(load_steps=5))
    curve = stepped.report["force_curve"]
    assert [point["percent"] for point in curve] == pytest.approx([0, 10, 20, 30, 40, 50])
    assert all(a["force_N"] < b["force_N"] for a, b in pairwise(curve))
    assert stepped.report["load_steps"] == 5
    assert stepped.force_N == pytest.approx(halved.force_N, rel=1e-4)
    assert np.abs(stepped.displacement - halved.displacement).max() < 1e-2


def test_forces_converge_with_the_mesh_and_do_not_lock() -> None:
    forces = {}
    for ratio in (0.475, 0.495):
        spec = SPEC.with_(percent=30.0, material=NeoHookean(poissons_ratio=ratio))
        forces[ratio] = [compress(half_ellipsoid(C_CUP, n), ANY_PHANTOM, spec).force_N for n in (5, 10)]
    coarse, fine = forces[0.475]
    assert coarse == pytest.approx(fine, rel=0.06)
    # 3 mu differs by 1.4 %; locking would show as a coarse mesh that is far too stiff.
    assert forces[0.495][0] / coarse == pytest.approx(forces[0.495][1] / fine, rel=0.03)
    assert forces[0.495][1] == pytest.approx(fine, rel=0.05)


def test_a_tall_breast_does_not_roll() -> None:
    result = compress(half_ellipsoid((60.0, 25.0, 70.0, 50.0), 6), ANY_PHANTOM, CompressionSpec(percent=36.0))
    assert np.abs(result.displacement[:, 1].mean()) < 0.05


def test_same_bytes_for_any_number_of_threads(mesh: TetMesh, threads: Callable[[int], None]) -> None:
    runs = []
    for count in (1, 2):
        threads(count)
        runs.append(compress(mesh, ANY_PHANTOM, SPEC.with_(percent=20.0)).displacement.tobytes())
    assert runs[0] == runs[1]


def test_progress_rises_and_can_cancel(mesh: TetMesh) -> None:
    seen: list[float] = []
    compress(mesh, ANY_PHANTOM, SPEC.with_(load_steps=2), lambda fraction, message: seen.append(fraction))
    assert seen[0] == 0
    assert seen[-1] == 1
    assert seen == sorted(seen)

    def cancel(fraction: float, message: str) -> None:
        if fraction > 0.3:
            raise Cancelled("stop")

    with pytest.raises(Cancelled):
        compress(mesh, ANY_PHANTOM, SPEC, cancel)


def test_a_step_that_fails_is_halved(mesh: TetMesh, halved: Compression, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "MAX_NEWTON", 5)
    result = compress(mesh, ANY_PHANTOM, SPEC)
    assert result.report["load_steps"] > 1
    assert result.force_N == pytest.approx(halved.force_N, rel=1e-4)


def test_failure_says_what_to_change(mesh: TetMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "MAX_NEWTON", 1)
    with pytest.raises(SolverError, match=r"did not converge.*take a smaller percent, a finer mesh") as error:
        compress(mesh, ANY_PHANTOM, SPEC)
    assert error.value.code == "not-converged"
    monkeypatch.setattr(solver, "SHORTEST_STEP", 2.0)
    monkeypatch.setattr(solver, "SMALLEST_VOLUME_STEP", 0.9999)
    monkeypatch.setattr(solver, "MAX_NEWTON", 5)
    with pytest.raises(SolverError, match="turn inside out") as error:
        compress(mesh, ANY_PHANTOM, SPEC)
    assert error.value.code == "inverted-element"


def test_mesh_without_a_wall_is_refused(mesh: TetMesh) -> None:
    with pytest.raises(SolverError, match="chest-wall nodes") as error:
        compress(with_nodes(mesh, mesh.nodes + np.array([1e-9, 0, 0])), ANY_PHANTOM, SPEC)
    assert error.value.code == "no-chest-wall"


@pytest.fixture(scope="module")
def solved(mesh: TetMesh) -> tuple[solver.Solver, Solution, Plates]:
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[mesh.wall, 0] = True
    model = Model.of(mesh, ElementLaws.homogeneous(SPEC.material.law(), len(mesh.tets)))
    s = solver.Solver(model, fixed, Guard.against_roll(mesh.nodes, mesh.wall), 1e-5)
    solution = follow(s, Contact.none(mesh.skin, len(mesh.nodes)), Target(30.0))
    return s, solution, Plates.at(mesh.nodes[:, 2], 30.0)


def tampered(solution: Solution, **changes: object) -> Solution:
    return replace(solution, state=replace(solution.state, **changes))


def test_verification_passes_the_solution(solved: tuple[solver.Solver, Solution, Plates]) -> None:
    verify(*solved)


def test_verification_sees_unbalanced_forces(solved: tuple[solver.Solver, Solution, Plates]) -> None:
    s, solution, plates = solved
    with pytest.raises(SolverError, match="relative residual"):
        verify(s, tampered(solution, displacement=1.001 * solution.state.displacement), plates)


def test_verification_sees_penetration(solved: tuple[solver.Solver, Solution, Plates]) -> None:
    s, solution, plates = solved
    with pytest.raises(SolverError, match="penetration of a plate"):
        verify(s, solution, Plates(plates.lower, plates.upper - 0.01))


def test_verification_sees_a_pulling_plate(solved: tuple[solver.Solver, Solution, Plates]) -> None:
    s, solution, plates = solved
    status = solution.state.contact.status
    swapped = np.where(status == UPPER, LOWER, np.where(status == LOWER, UPPER, status)).astype(np.int8)
    with pytest.raises(SolverError, match="pull"):
        # The residual is relative to the plate force, which has the wrong sign here.
        verify(
            replace(s, tolerance=1e12),
            tampered(solution, contact=replace(solution.state.contact, status=swapped)),
            plates,
        )


def test_verification_sees_an_inverted_element(mesh: TetMesh, solved: tuple[solver.Solver, Solution, Plates]) -> None:
    s, solution, plates = solved
    displacement = np.array(solution.state.displacement)
    displacement[mesh.tets[0, 0]] += 2 * (mesh.nodes[mesh.tets[0, 1:]].mean(axis=0) - mesh.nodes[mesh.tets[0, 0]])
    with pytest.raises(SolverError, match="det F") as error:
        verify(s, tampered(solution, displacement=displacement), plates)
    assert error.value.code == "inverted-element"
