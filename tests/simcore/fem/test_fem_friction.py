"""Coulomb friction of skin on the plates."""

from __future__ import annotations

import numpy as np
import pytest

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.elements.model import Model
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.linear.tangent import Guard
from simcore.fem.newton.path import Solution, Target, follow
from simcore.fem.newton.solver import Solver
from simcore.fem.plates.contact import FREE, LOWER, UPPER, Contact, Plates
from simcore.fem.plates.friction import STICK_MM, Friction
from simcore.mesh.structured import box, half_ellipsoid

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
C_CUP = (92.1, 60.2, 67.3, 53.1)


def solved(mesh: TetMesh, coefficient: float | None, percent: float, load_steps: int, anchors: np.ndarray) -> Solution:
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[mesh.wall, 0] = True
    fixed[anchors, :2] = True
    model = Model.of(mesh, ElementLaws.homogeneous(NeoHookean().law(), len(mesh.tets)))
    friction = None if coefficient is None else Friction(coefficient)
    guard = Guard.none() if len(anchors) else Guard.against_roll(mesh.nodes, mesh.wall)
    solver = Solver(model, fixed, guard, 1e-6, friction)
    return follow(solver, Contact.none(mesh.skin, len(mesh.nodes)), Target(percent), load_steps)


def test_a_block_that_sticks_is_a_bonded_block() -> None:
    """Wide and flat: friction of 1 holds it but for the elastic slip."""
    mesh = box((60.0, 60.0, 12.0), (8, 8, 3))
    nobody = np.empty(0, np.int64)
    ends = np.flatnonzero(np.abs(mesh.nodes[:, 2]) == 6)
    bonded = solved(mesh, None, 5.0, 1, ends).steps[-1].force
    sliding = solved(mesh, None, 5.0, 1, nobody).steps[-1].force
    stuck = solved(mesh, 1.0, 5.0, 5, nobody)
    assert bonded > 1.5 * sliding
    assert stuck.steps[-1].force < bonded
    assert stuck.steps[-1].force == pytest.approx(bonded, rel=0.05)


def test_forces_stay_in_coulombs_cone_and_oppose_the_slip() -> None:
    mesh = half_ellipsoid(C_CUP, 6)
    solution = solved(mesh, 0.05, 40.0, 10, np.empty(0, np.int64))
    state = solution.state
    assert state.slip is not None
    assert state.plates is not None
    model = Model.of(mesh, ElementLaws.homogeneous(NeoHookean().law(), len(mesh.tets)))
    push = state.contact.push(model.internal_force(state.displacement, state.pressure), state.plates)
    tangential = Friction(0.05).resistance(state.slip, push)
    size = np.linalg.norm(tangential, axis=1)
    pushed = push > 1e-3
    assert (size <= 0.05 * np.maximum(push, 0) * (1 + 1e-9)).all()
    sliding = pushed & (state.slip.length > STICK_MM)
    assert sliding.sum() > 0.5 * pushed.sum()
    assert size[sliding] == pytest.approx(0.05 * push[sliding])
    # The breast spreads away from its middle, friction (as an internal force) points along the way it went.
    outward = np.sign(mesh.nodes[:, 1]) * tangential[:, 1]
    assert (outward[sliding & (np.abs(mesh.nodes[:, 1]) > 10)] > 0).mean() > 0.95
    assert np.abs(tangential[:, 2]).max() == 0


def test_friction_stiffens_and_its_forces_balance() -> None:
    mesh = half_ellipsoid(C_CUP, 6)
    spec = CompressionSpec(percent=40.0)
    forces = [compress(mesh, ANY_PHANTOM, spec.with_(friction=mu)) for mu in (0.0, 0.1, 0.5)]
    assert forces[0].report["friction"] is None
    assert 1.01 * forces[0].force_N < forces[1].force_N
    assert 1.01 * forces[1].force_N < forces[2].force_N
    report = forces[1].report
    along = [report["friction"][plate] for plate in ("lower_N", "upper_N")]
    # The breast grows away from the wall, the plates hold it back, the wall pulls as much.
    assert along[0][0] < 0
    assert along[1][0] < 0
    assert report["wall_force_N"] == pytest.approx(along[0][0] + along[1][0], rel=1e-2)
    assert report["force_upper_N"] == pytest.approx(report["force_lower_N"], rel=1e-3)


def test_the_way_is_resolved() -> None:
    mesh = half_ellipsoid(C_CUP, 6)
    spec = CompressionSpec(percent=40.0, friction=0.3)
    forces = [compress(mesh, ANY_PHANTOM, spec.with_(load_steps=n)).force_N for n in (10, 20)]
    assert forces[0] == pytest.approx(forces[1], rel=5e-3)


def test_the_way_to_a_force_is_resolved_too() -> None:
    """In steps that doubled the force at this percentage came out 0.9 % larger than in ten steps."""
    mesh = half_ellipsoid(C_CUP, 7)
    spec = CompressionSpec(percent=60.0, force_N=150.0, friction=0.6)
    report = compress(mesh, ANY_PHANTOM, spec).report
    percents = [point["percent"] for point in report["force_curve"]]
    assert max(np.diff(percents)) < 6.0 + 1e-9
    alone = compress(mesh, ANY_PHANTOM, CompressionSpec(percent=percents[-1], friction=0.6))
    assert report["force_N"] == pytest.approx(alone.force_N, rel=2e-3)


def test_slip_is_cut_and_remembered() -> None:
    status = np.array([FREE, UPPER, LOWER, UPPER], np.int8)
    contact = Contact(np.arange(4), status, np.zeros(4, np.int16))
    before = np.array([[0, 0, 0], [0.01, 0, 0], [0.04, 0, 0], [0, 0, 0]])
    moved = np.array([[1.0, 1, 1], [0.02, 0, -3], [-0.06, 0, 2], [0.3, 0.4, -3]])
    slip = Friction(0.5).slip(before, moved, contact, Plates(2.0, 7.0), Plates(0.0, 10.0))
    assert slip.elastic == pytest.approx(
        np.array([[0, 0, 0], [0.03, 0, 0], [-0.02, 0, 0], [0.6 * STICK_MM, 0.8 * STICK_MM, 0]])
    )
    assert slip.length == pytest.approx([0, 0.03, 0.02, 0.5])
    resistance = Friction(0.5).resistance(slip, np.array([0.0, 10.0, 10.0, 10.0]))
    assert resistance[3] == pytest.approx([3.0, 4.0, 0.0])
    assert resistance[1] == pytest.approx([0.5 * 10 * 0.03 / STICK_MM, 0, 0])


def test_stiffness_of_friction_is_its_derivative() -> None:
    contact = Contact(np.arange(2), np.array([UPPER, LOWER], np.int8), np.zeros(2, np.int16))
    plates, push = Plates(0.0, 10.0, slope=0.2), np.array([3.0, 4.0])
    friction, still = Friction(0.4), np.zeros((2, 3))
    for moved in (np.array([[0.01, 0.02, 0.0], [0.3, -0.4, 0.0]]), np.array([[0.5, 0.2, 0.1], [0.001, 0, 0]])):
        slip = friction.slip(still, moved, contact, plates, plates)
        nodes, blocks = friction.stiffness(slip, push, contact, plates, along=0.0)
        assert list(nodes) == [0, 1]
        for k in range(3):
            step = np.zeros((2, 3))
            step[:, k] = 1e-7
            ahead, behind = (
                friction.resistance(friction.slip(still, moved + s * step, contact, plates, plates), push)
                for s in (1, -1)
            )
            assert blocks[:, :, k] == pytest.approx((ahead - behind) / 2e-7, abs=1e-5)
