"""The chest wall that may neither drift nor roll, and linear systems that reach their limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench import percents
from bench.support.bodies import ONE_TISSUE
from simcore.core.artifacts import TetMesh
from simcore.core.errors import SolverError
from simcore.fem import CompressionSpec, compress
from simcore.fem.compression import solver_of
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.linear.tangent import MAX_ITERATIONS, Guard, Solved, Tangent
from simcore.fem.newton.outcome import CompressionFailed
from simcore.fem.newton.path import Solution, Target, follow
from simcore.fem.newton.solver import Solver
from simcore.fem.plates.constraints import Constraints
from simcore.fem.plates.contact import Contact, Plates
from simcore.fem.report.report import verify
from simcore.fem.spec import Gravity
from simcore.mesh import build
from simcore.mesh.spec import LatticeMesh
from simcore.mesh.structured import half_ellipsoid

C_CUP = (92.1, 60.2, 67.3, 53.1)
LOPSIDED = (90.0, 60.0, 85.0, 40.0)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return half_ellipsoid(C_CUP, 8)


@pytest.fixture(scope="module")
def solver(mesh: TetMesh) -> Solver:
    return solver_of(mesh, ONE_TISSUE, CompressionSpec())


@pytest.fixture(scope="module")
def squeezed(solver: Solver, mesh: TetMesh) -> Solution:
    return follow(solver, Contact.none(mesh.skin, len(mesh.nodes)).holding(mesh.wall), Target(40.0))


@pytest.fixture(scope="module")
def tangent(solver: Solver, squeezed: Solution) -> tuple[Tangent, Constraints]:
    model, state = solver.model, squeezed.state
    system = model.system(single=True)
    model.assemble(state.displacement, state.pressure, system)
    compliance = model.volume_ratio_of_pressure(state.pressure)[1]
    assert state.plates is not None
    constraints = Constraints.of(solver.fixed, state.contact, state.plates)
    return Tangent.of(model.pattern, system, 1 / (model.node_volume * compliance)), constraints


def load(solver: Solver, constraints: Constraints) -> np.ndarray:
    v = np.random.default_rng(4).normal(0, 1e-4, solver.model.nodes.shape)
    constraints.project(v)
    solver.guard.project(v)
    return v


@pytest.mark.parametrize("size", [1.0, 1e3])
def test_a_load_that_the_guard_carries_does_not_disturb_the_solution(
    solver: Solver, tangent: tuple[Tangent, Constraints], size: float
) -> None:
    """Near equilibrium what keeps the wall from rolling is millions of times the rest of the residual."""
    matrix, constraints = tangent
    rhs = load(solver, constraints)
    alone = matrix.solve(rhs, constraints, solver.guard, 1e-4)
    carried = rhs.copy()
    carried[solver.guard.nodes, 1] += size * solver.guard.vectors[:, 1]
    both = matrix.solve(carried, constraints, solver.guard, 1e-4)
    assert both.converged
    assert both.iterations <= alone.iterations + 2
    assert both.x == pytest.approx(alone.x, abs=1e-3 * np.abs(alone.x).max())
    assert solver.guard.drift(both.x) < 1e-12 * np.abs(both.x).max()


def test_the_limit_of_iterations_is_no_solution(solver: Solver, tangent: tuple[Tangent, Constraints]) -> None:
    matrix, constraints = tangent
    rhs = load(solver, constraints)
    cut = matrix.solve(rhs, constraints, solver.guard, 1e-6, max_iterations=5)
    assert cut.definite
    assert not cut.converged
    whole = matrix.solve(rhs, constraints, solver.guard, 1e-4)
    assert (whole.definite, whole.converged) == (True, True)


def test_a_solve_that_reaches_the_limit_starts_again_from_there(
    solver: Solver, tangent: tuple[Tangent, Constraints]
) -> None:
    matrix, constraints = tangent
    rhs = load(solver, constraints)
    whole = matrix.solve(rhs, constraints, solver.guard, 1e-4)
    again = matrix.solve(rhs, constraints, solver.guard, 1e-4, max_iterations=int(0.7 * whole.iterations))
    assert again.converged
    assert again.iterations > int(0.7 * whole.iterations)
    assert again.x == pytest.approx(whole.x, abs=2e-3 * np.abs(whole.x).max())


def test_a_compression_whose_linear_systems_are_not_solved_has_a_name(
    mesh: TetMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = Tangent.solve

    def limited(self: Tangent, *args: object) -> Solved:
        return solve(self, *args, max_iterations=3)  # type: ignore[arg-type]

    monkeypatch.setattr(Tangent, "solve", limited)
    with pytest.raises(CompressionFailed, match=f"within {MAX_ITERATIONS} iterations") as error:
        compress(mesh, ONE_TISSUE, CompressionSpec(percent=40.0))
    assert error.value.code == "linear-system"


@pytest.mark.parametrize("vector", [0, 1])
def test_a_wall_that_drifts_or_rolls_does_not_pass_as_equilibrium(
    solver: Solver, squeezed: Solution, vector: int
) -> None:
    """The residual does not see it: between frictionless plates a breast may lie anywhere."""
    assert isinstance(squeezed.state.plates, Plates)
    verify(solver, squeezed, squeezed.state.plates)
    moved = squeezed.state.displacement.copy()
    moved[:, 1] += 1e-4
    if vector:
        moved[:, 1] += 1e-6 * solver.model.nodes[:, 2] - 1e-4
    state = replace(squeezed.state, displacement=moved)
    with pytest.raises(SolverError, match="drift or roll of the chest wall"):
        verify(solver, replace(squeezed, state=state), squeezed.state.plates)


def test_a_guard_that_carries_more_than_drift_and_roll_does_not_pass(mesh: TetMesh, solver: Solver) -> None:
    """The solver's own residual does not see it: it leaves out what the guard carries."""
    y, z = mesh.nodes[solver.guard.nodes, 1:].T
    vectors = np.linalg.qr(np.stack([np.ones(len(z)), z, y], axis=1))[0]  # keeps the wall from spreading, too
    wrong = replace(solver, guard=Guard(solver.guard.nodes, np.ascontiguousarray(vectors)))
    solution = follow(wrong, Contact.none(mesh.skin, len(mesh.nodes)).holding(mesh.wall), Target(20.0))
    assert isinstance(solution.state.plates, Plates)
    with pytest.raises(SolverError, match="takes no more than a force and a moment"):
        verify(wrong, solution, solution.state.plates)


def test_a_breast_that_its_wall_alone_holds_is_in_balance() -> None:
    """Its weight draws it off the plates: there is no plate force that residuals could be relative to."""
    heavy = CompressionSpec(
        percent=0.5,
        gravity=Gravity(direction="+y", density_g_ml=2.0),
        material=NeoHookean(youngs_modulus_kPa=3.0),
    )
    report = compress(half_ellipsoid(LOPSIDED, 7), ONE_TISSUE, heavy).report
    assert report["contact_nodes"] == {"lower": 0, "upper": 0}
    assert report["guard_force_N"] < -10.0


def test_the_guard_needs_no_force_along_y() -> None:
    mesh = half_ellipsoid(LOPSIDED, 8)
    report = compress(mesh, ONE_TISSUE, CompressionSpec(percent=45.0)).report
    assert abs(report["guard_force_N"]) < 1e-3 * report["force_N"]
    assert report["wall_drift_mm"] < 1e-9


def test_the_sample_phantom_of_victre_is_pressed_smoothly() -> None:
    """At 43, 44, 44.1 and 44.2 % the wall drifted by 13.7 mm and rolled by 13 degrees, and 44 % took 67.9 N."""
    body = percents.uploaded(percents.CASES / "victre" / "p_1.mhd")
    steps = np.arange(40.0, 49.0)
    curve, problems, failures = percents.force_curve(body, 5.5, steps)
    assert problems == []
    assert not failures
    assert np.nanmax(percents.beside_neighbours(curve)) < 2e-3
    assert curve[4] == pytest.approx(66.7, abs=0.1)
    mesh = build(body, LatticeMesh(edge_length_mm=5.5))
    for percent, force in ((44.1, 67.07), (44.2, 67.46)):
        result = compress(mesh, body, CompressionSpec(percent=percent))
        assert percents.faults(mesh, CompressionSpec(percent=percent), result) == []
        assert result.force_N == pytest.approx(force, abs=0.05)


def test_the_guard_measures_movement_of_the_wall_alone(mesh: TetMesh) -> None:
    guard = Guard.against_roll(mesh.nodes, mesh.wall)
    v = np.zeros_like(mesh.nodes)
    v[:, 1] = 0.25
    assert guard.drift(v) == pytest.approx(0.25)
    v[:, 1] = 0.0
    v[np.setdiff1d(np.arange(len(v)), mesh.wall), 1] = 3.0
    assert guard.drift(v) == 0.0
