"""The finite elements against exact solutions of the neo-Hookean law."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.elements.model import Model
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.linear.tangent import Guard, Tangent
from simcore.fem.newton.path import Target, follow
from simcore.fem.newton.solver import Solver, State
from simcore.fem.plates.constraints import Constraints
from simcore.fem.plates.contact import Contact, Plates
from simcore.mesh.quality import boundary_faces
from simcore.mesh.structured import box

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
LAW = NeoHookean(youngs_modulus_kPa=60.6, poissons_ratio=0.475)
Floats = NDArray[np.float64]


def principal_stress(stretches: Floats, law: NeoHookean) -> Floats:
    """First Piola-Kirchhoff stress, kPa, of W = mu/2 (J^(-2/3) I1 - 3) + kappa/2 ((J^2 - 1)/2 - ln J)."""
    shear, bulk = law.law().shear, law.law().bulk
    J, I1 = np.prod(stretches), np.sum(stretches**2)
    return shear * J ** (-2 / 3) * (stretches - I1 / (3 * stretches)) + bulk / 2 * (J - 1 / J) * J / stretches


def model_of(mesh: TetMesh, law: NeoHookean = LAW) -> Model:
    return Model.of(mesh, ElementLaws.homogeneous(law.law(), len(mesh.tets)))


def jittered_box(cells: tuple[int, int, int] = (3, 4, 3)) -> TetMesh:
    return box((30.0, 40.0, 20.0), cells, jitter=0.2, generator=np.random.default_rng(5))


@pytest.mark.parametrize("percent", [1.0, 20.0, 50.0, 70.0])
@pytest.mark.parametrize("poissons_ratio", [0.3, 0.475, 0.495])
def test_block_between_plates_is_in_uniaxial_stress(percent: float, poissons_ratio: float) -> None:
    law = LAW.with_(poissons_ratio=poissons_ratio)
    mesh = jittered_box()
    result = compress(mesh, ANY_PHANTOM, CompressionSpec(percent=percent, material=law, tolerance=1e-9))
    squeeze = 1 - percent / 100
    wide = brentq(lambda w: principal_stress(np.array([w, w, squeeze]), law)[0], 0.9, 3.0, xtol=1e-14)
    force = -principal_stress(np.array([wide, wide, squeeze]), law)[2] * 1e-3 * 30 * 40
    assert result.report["force_upper_N"] == pytest.approx(force, rel=1e-6)
    assert result.report["force_lower_N"] == pytest.approx(force, rel=1e-6)
    exact = mesh.nodes * np.array([wide - 1, wide - 1, squeeze - 1])
    assert np.abs(result.displacement - exact).max() < 1e-6
    assert result.report["extent_x_mm"] == pytest.approx([0.0, 30 * wide])
    assert result.report["volume_change"] == pytest.approx(wide * wide * squeeze - 1, abs=1e-8)
    assert result.report["contact_area_mm2"] == pytest.approx(1200 * wide * wide)
    assert result.report["mean_pressure_kPa"] == pytest.approx(1e3 * force / (1200 * wide * wide))
    assert result.plate_z == pytest.approx((-10 * squeeze, 10 * squeeze))


@pytest.mark.parametrize("squeeze", [0.9, 0.6])
def test_confined_compression(squeeze: float) -> None:
    mesh = jittered_box()
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[:, 0] = np.isin(mesh.nodes[:, 0], [0.0, 30.0])
    fixed[:, 1] = np.isin(mesh.nodes[:, 1], [-20.0, 20.0])
    solver = Solver(model_of(mesh), fixed, Guard.against_roll(mesh.nodes, mesh.wall), 1e-9)
    solution = follow(solver, Contact.none(mesh.skin, len(mesh.nodes)), Target(100 * (1 - squeeze)))
    stress = -principal_stress(np.array([1.0, 1.0, squeeze]), LAW) * 1e-3
    assert solution.steps[-1].force_upper == pytest.approx(stress[2] * 1200, rel=1e-7)
    state = solution.state
    reaction = solver.model.internal_force(state.displacement, state.pressure)
    assert reaction[mesh.nodes[:, 0] == 0.0, 0].sum() == pytest.approx(stress[0] * 800, rel=1e-7)


def test_patch_of_tets_takes_an_affine_deformation() -> None:
    mesh = jittered_box((4, 4, 4))
    gradient = np.array([[0.2, 0.1, -0.05], [0.08, -0.25, 0.1], [0.03, 0.06, 0.15]])
    exact = mesh.nodes @ gradient.T
    boundary = np.unique(boundary_faces(mesh.tets))
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[boundary] = True
    start = exact + 0.3 * np.random.default_rng(6).uniform(-1, 1, exact.shape) * ~fixed
    solver = Solver(model_of(mesh), fixed, Guard.against_roll(mesh.nodes, mesh.wall), 1e-10)
    nothing = Contact.none(mesh.skin[:0], len(mesh.nodes))
    state = State(start, np.zeros(len(exact)), nothing)
    solved, _ = solver.load_step(state, Plates(-1e3, 1e3))
    assert np.abs(start - exact).max() > 0.1
    assert np.abs(solved.displacement - exact).max() < 1e-8
    J = np.linalg.det(np.eye(3) + gradient)
    pressure = LAW.law().bulk * 1e-3 / 2 * (J - 1 / J)
    assert solved.pressure == pytest.approx(pressure, rel=1e-8)


def test_rotation_and_translation_cost_no_force() -> None:
    mesh = jittered_box()
    angle = 0.7
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moved = mesh.nodes @ rotation.T - mesh.nodes + [3.0, -2.0, 5.0]
    force = model_of(mesh).internal_force(moved, np.zeros(len(moved)))
    assert np.abs(force).max() < 1e-12


def dense_tangent(model: Model, blocks: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats]:
    """(K, B) of the whole model from the upper half."""
    n = len(model.nodes)
    stiffness, coupling = np.zeros((n, 3, n, 3)), np.zeros((n, 3, n))
    row = np.repeat(np.arange(n), np.diff(model.pattern.row_start))
    for block, (a, b) in enumerate(zip(row, model.pattern.column, strict=True)):
        stiffness[a, :, b] = blocks[0][block]
        stiffness[b, :, a] = blocks[0][block].T
        coupling[a, :, b] = blocks[1][block]
        coupling[b, :, a] = blocks[2][block]
    return stiffness.reshape(3 * n, 3 * n), coupling.reshape(3 * n, n)


def assembled(model: Model, u: Floats, p: Floats) -> tuple[Floats, Floats, tuple[Floats, Floats, Floats]]:
    """(force, volume residual, tangent blocks)"""
    system = model.system()
    assert model.assemble(u, p, system) > 0.3
    target = model.node_volume * model.volume_ratio_of_pressure(p)[0]
    blocks = (system.stiffness, system.coupling_upper, system.coupling_lower)
    return system.force, system.node_volume - target, blocks


def test_tangent_is_the_derivative_of_the_force() -> None:
    model = model_of(box((30.0, 40.0, 20.0), (2, 2, 2)))
    generator = np.random.default_rng(7)
    n = len(model.nodes)
    u, p = generator.normal(0, 0.6, (n, 3)), generator.normal(0, 0.05, n)
    du, dp = generator.normal(0, 1, (n, 3)), generator.normal(0, 0.1, n)
    stiffness, coupling = dense_tangent(model, assembled(model, u, p)[2])
    step = 1e-5
    ahead, behind = assembled(model, u + step * du, p + step * dp), assembled(model, u - step * du, p - step * dp)
    force_rate = (ahead[0] - behind[0]).ravel() / (2 * step)
    volume_rate = (ahead[1] - behind[1]) / (2 * step)
    compliance = model.node_volume * model.volume_ratio_of_pressure(p)[1]
    assert force_rate == pytest.approx(stiffness @ du.ravel() + coupling @ dp, rel=1e-6, abs=1e-7)
    assert volume_rate == pytest.approx(coupling.T @ du.ravel() - compliance * dp, rel=1e-6, abs=1e-5)


def test_linear_solver_agrees_with_a_dense_one() -> None:
    mesh = box((30.0, 40.0, 20.0), (3, 3, 2))
    model = model_of(mesh)
    generator = np.random.default_rng(8)
    n = len(model.nodes)
    system = model.system(single=True)
    model.assemble(generator.normal(0, 0.2, (n, 3)), np.zeros(n), system)
    stiffness, coupling = dense_tangent(model, (system.stiffness, system.coupling_upper, system.coupling_lower))
    compliance = 1 / (model.node_volume * model.volume_ratio_of_pressure(np.zeros(n))[1])
    condensed = stiffness + coupling * compliance @ coupling.T
    tangent = Tangent.of(model.pattern, system, compliance)
    x = generator.normal(0, 1, (n, 3))
    product, pressure = tangent.apply(x)
    assert product.ravel() == pytest.approx(condensed @ x.ravel(), rel=1e-4, abs=1e-4 * np.abs(product).max())
    assert pressure == pytest.approx(compliance * (coupling.T @ x.ravel()), rel=1e-3, abs=1e-5)
    assert tangent.apply_coupling(pressure).ravel() == pytest.approx(coupling @ pressure, rel=1e-3, abs=1e-5)

    free = np.ones((n, 3), dtype=bool)
    free[mesh.wall, 0] = False
    free[mesh.nodes[:, 2] == -10.0, 2] = False
    guard = Guard.against_roll(mesh.nodes, mesh.wall)
    rhs = generator.normal(0, 1, (n, 3))
    constraints_on = Constraints(free, np.zeros(n, dtype=bool), np.array([0.0, 0.0, 1.0]))
    solved, iterations, definite, converged = tangent.solve(rhs, constraints_on, guard, 1e-7)
    constraints = np.zeros((2, n, 3))
    constraints[:, guard.nodes, 1] = guard.vectors.T
    keep = free.ravel()
    saddle = np.block(
        [
            [condensed[np.ix_(keep, keep)], constraints.reshape(2, -1)[:, keep].T],
            [constraints.reshape(2, -1)[:, keep], np.zeros((2, 2))],
        ]
    )
    exact = np.linalg.solve(saddle, np.concatenate([rhs.ravel()[keep], [0.0, 0.0]]))[:-2]
    assert iterations > 5
    assert definite
    assert converged
    assert solved.ravel()[keep] == pytest.approx(exact, rel=1e-3, abs=1e-4 * np.abs(exact).max())
    assert (solved.ravel()[~keep] == 0).all()
