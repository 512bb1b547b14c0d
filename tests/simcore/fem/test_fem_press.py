"""Plates that tilt, turn on a spring or bend."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.compression import press_of, solver_of
from simcore.fem.newton import press
from simcore.fem.newton.outcome import CompressionFailed
from simcore.fem.newton.path import Solution, Target, follow
from simcore.fem.plates.bending import BendingPlate
from simcore.fem.plates.contact import LOWER, UPPER, Contact, Plates
from simcore.fem.spec import ElasticPlates, SpringPaddle
from simcore.mesh.structured import half_ellipsoid

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
C_CUP = (92.1, 60.2, 67.3, 53.1)
SPEC = CompressionSpec(percent=40.0)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return half_ellipsoid(C_CUP, 7)


@pytest.fixture(scope="module")
def rigid(mesh: TetMesh) -> Compression:
    return compress(mesh, ANY_PHANTOM, SPEC)


def solution_of(mesh: TetMesh, spec: CompressionSpec) -> tuple[Solution, np.ndarray, np.ndarray]:
    """(solution, forces of the plates on the nodes (n, 3), positions of the nodes)"""
    solver = solver_of(mesh, ANY_PHANTOM, spec)
    contact = Contact.none(mesh.skin, len(mesh.nodes)).holding(mesh.wall)
    solution = follow(solver, contact, Target(spec.percent), press=press_of(spec))
    state = solution.state
    assert state.plates is not None
    force = solver.model.internal_force(state.displacement, state.pressure)
    return solution, state.contact.reaction(force, state.plates), mesh.nodes + state.displacement


@pytest.mark.parametrize("degrees", [-5.0, 5.0, 12.0])
def test_a_tilted_plate_pushes_along_its_normal(mesh: TetMesh, rigid: Compression, degrees: float) -> None:
    spec = SPEC.with_(paddle_angle_degrees=degrees, tolerance=1e-7)
    result = compress(mesh, ANY_PHANTOM, spec)
    report = result.report
    assert (result.force_N < rigid.force_N) == (degrees > 0)
    assert report["force_upper_N"] == pytest.approx(report["force_lower_N"], rel=1e-5)
    # Without friction the chest wall takes the part along x of the inclined force.
    assert report["wall_force_N"] == pytest.approx(report["force_upper_N"] * np.tan(np.radians(degrees)), rel=1e-3)
    points = mesh.nodes + result.displacement
    height = result.report["plates"]["upper_z_mm"] + np.tan(np.radians(degrees)) * points[:, 0]
    assert (points[:, 2] - height).max() == pytest.approx(0, abs=1e-5)
    assert (points[mesh.wall, 0] == 0).all()
    assert result.plate_z[0] == pytest.approx(report["plates"]["lower_z_mm"], abs=1e-5)
    assert result.plate_z[1] == pytest.approx(points[:, 2].max())
    assert result.thickness == pytest.approx(report["thickness_mm"])


def test_tilt_by_no_angle_is_the_level_plate(mesh: TetMesh, rigid: Compression) -> None:
    tilted = compress(mesh, ANY_PHANTOM, SPEC.with_(paddle_angle_degrees=1e-9))
    assert tilted.force_N == pytest.approx(rigid.force_N, rel=1e-6)
    assert tilted.displacement == pytest.approx(rigid.displacement, abs=1e-4)


def test_a_spring_paddle_turns_until_the_moments_balance(mesh: TetMesh, rigid: Compression) -> None:
    stiffness, pivot = 2000.0, 180.0
    spec = SPEC.with_(spring_paddle=SpringPaddle(stiffness_Nmm_per_degree=stiffness, pivot_mm=pivot))
    solution, forces, points = solution_of(mesh, spec)
    plates = solution.state.plates
    assert plates is not None
    on = solution.state.contact.status == UPPER
    # Moment about the pivot of the plate, along y, as arm x force: (x, z) relative to the pivot's line.
    arm_x, arm_z = points[on, 0] - pivot, points[on, 2] - plates.upper
    on_plate = -forces[on]
    moment = (arm_x * on_plate[:, 2] - arm_z * on_plate[:, 0]).sum()
    degrees = np.degrees(np.arctan(plates.slope))
    assert degrees < -4
    assert stiffness * degrees == pytest.approx(moment, rel=1e-3)
    assert solution.steps[-1].force < 0.9 * rigid.force_N
    stiff = spec.with_(spring_paddle=SpringPaddle(stiffness_Nmm_per_degree=1e7, pivot_mm=pivot))
    assert compress(mesh, ANY_PHANTOM, stiff).force_N == pytest.approx(rigid.force_N, rel=2e-3)


def test_thick_plexiglas_is_rigid_and_thin_one_gives_way(mesh: TetMesh, rigid: Compression) -> None:
    forces, bends = [], []
    for thickness in (50.0, 20.0, 8.0):
        spec = SPEC.with_(elastic_plates=ElasticPlates(thickness_mm=thickness))
        report = compress(mesh, ANY_PHANTOM, spec).report
        forces.append(report["force_N"])
        bends.append(report["plates"]["upper_bend_mm"])
    assert forces[0] == pytest.approx(rigid.force_N, rel=2e-3)
    assert forces[0] > forces[1] > forces[2]
    assert forces[2] < 0.9 * rigid.force_N
    # The bend of a stiff plate is the force over its stiffness, which goes with the cube of the thickness.
    assert bends[1] / bends[0] == pytest.approx(2.5**3 * forces[1] / forces[0], rel=0.02)


def test_the_bend_is_that_of_the_contact_forces(mesh: TetMesh) -> None:
    spec = SPEC.with_(elastic_plates=ElasticPlates(thickness_mm=10.0))
    solution, forces, points = solution_of(mesh, spec)
    plates, status = solution.state.plates, solution.state.contact.status
    assert plates is not None
    assert plates.upper_bend is not None
    assert plates.lower_bend is not None
    plate = BendingPlate.of(240.0, 300.0, 10.0, 3000.0, 0.37)
    for on, bend, height in (
        (status == UPPER, plates.upper_bend, plates.upper),
        (status == LOWER, plates.lower_bend, plates.lower),
    ):
        expected = plate.deflection(points[on], points[on], -forces[on, 2])
        assert bend[on] == pytest.approx(expected, abs=2e-3)
        assert points[on, 2] - height == pytest.approx(bend[on], abs=1e-5)
    # Highest at the free edge along the chest wall.
    on = np.flatnonzero(status == UPPER)
    assert plates.upper_bend[on][np.argmin(points[on, 0])] > plates.upper_bend[on][np.argmax(points[on, 0])] > 0


def test_bending_of_a_square_plate_with_one_free_edge() -> None:
    """Timoshenko's table for three edges simply supported, one free, uniform load, nu = 0.3: 0.01286 q a^4 / D at the
    middle of the free edge."""
    side, thickness, modulus = 200.0, 5.0, 3000.0
    plate = BendingPlate.of(side, side, thickness, modulus, 0.3)
    rigidity = modulus * thickness**3 / (12 * (1 - 0.3**2))
    cells = (np.arange(80) + 0.5) / 80 * side
    x, y = np.meshgrid(cells, cells - side / 2)
    load = np.full(x.size, 1e-3 * (side / 80) ** 2)
    places = np.array([[0.0, 0.0], [side, 30.0], [50.0, side / 2]])
    deflection = plate.deflection(places, np.stack([x.ravel(), y.ravel()], axis=1), load)
    assert deflection[0] == pytest.approx(0.01286 * 1e-3 * side**4 / rigidity, rel=5e-3)
    assert deflection[1:] == pytest.approx([0, 0], abs=1e-9)


def test_bending_of_a_strip_and_reciprocity() -> None:
    """Far from its ends a long plate is a beam of width 1: 5/384 q b^4 / D."""
    plate = BendingPlate.of(800.0, 200.0, 5.0, 3000.0, 0.3)
    rigidity = 3000.0 * 125 / (12 * 0.91)
    x, y = np.meshgrid((np.arange(160) + 0.5) * 5, (np.arange(40) + 0.5) * 5 - 100)
    middle = plate.deflection(
        np.array([[400.0, 0.0]]), np.stack([x.ravel(), y.ravel()], axis=1), np.full(x.size, 0.025)
    )
    assert middle[0] == pytest.approx(5 / 384 * 1e-3 * 200.0**4 / rigidity, rel=0.02)
    a, b = np.array([[30.0, 20.0]]), np.array([[300.0, -50.0]])
    assert plate.deflection(a, b, np.ones(1)) == pytest.approx(plate.deflection(b, a, np.ones(1)))


def test_heights_and_normals_of_plates() -> None:
    points = np.array([[0.0, 0, 0], [10, 5, 1], [30, 0, 2]])
    plates = Plates(-5.0, 7.0, slope=0.1, pivot=10.0)
    lower, upper = plates.heights(points)
    assert lower == -5.0
    assert upper == pytest.approx([6.0, 7.0, 9.0])
    assert plates.upper_normal @ [1.0, 0.0, 0.1] == pytest.approx(0)
    assert not plates.level
    assert Plates(-5.0, 7.0).bounds(points) == (-5.0, 7.0)
    assert plates.bounds(points) == (0.0, 2.0)


def test_a_force_is_met_by_any_press(mesh: TetMesh) -> None:
    for changes in (
        {"paddle_angle_degrees": 6.0},
        {"spring_paddle": SpringPaddle(stiffness_Nmm_per_degree=8000.0)},
        {"elastic_plates": ElasticPlates(thickness_mm=10.0)},
    ):
        result = compress(mesh, ANY_PHANTOM, CompressionSpec(force_N=60.0, **changes))
        assert result.force_N == pytest.approx(60.0, rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"spring_paddle": SpringPaddle(stiffness_Nmm_per_degree=2000.0)}, "a stiffer spring_paddle"),
        ({"elastic_plates": ElasticPlates(thickness_mm=8.0)}, "thicker elastic_plates"),
    ],
)
def test_plates_that_do_not_come_to_rest_are_named(
    mesh: TetMesh, monkeypatch: pytest.MonkeyPatch, changes: dict[str, object], advice: str
) -> None:
    """They were said to be Newton's method, which had converged in every round."""
    monkeypatch.setattr(press, "MAX_ROUNDS", 1)
    with pytest.raises(CompressionFailed, match=f"did not come to rest.*; take {advice}") as error:
        compress(mesh, ANY_PHANTOM, SPEC.with_(**changes))
    assert error.value.code == "unsettled-plates"


def test_a_breast_beyond_the_plates_is_told_which_would_do(mesh: TetMesh) -> None:
    small = ElasticPlates(thickness_mm=10.0, depth_mm=60.0, width_mm=70.0)
    result = compress(mesh, ANY_PHANTOM, SPEC.with_(elastic_plates=small))
    depth, width = result.report["least_plates_mm"]
    assert 60 < depth < 100
    assert 70 < width < 140
    enough = small.with_(depth_mm=float(depth), width_mm=float(width))
    assert "least_plates_mm" not in compress(mesh, ANY_PHANTOM, SPEC.with_(elastic_plates=enough)).report


def test_presses_exclude_one_another() -> None:
    with pytest.raises(ValidationError, match="give one of"):
        CompressionSpec(paddle_angle_degrees=3.0, elastic_plates=ElasticPlates(thickness_mm=10.0))


def test_a_plate_that_nothing_touches_stays_flat() -> None:
    plate = BendingPlate.of(240.0, 300.0, 10.0, 3000.0, 0.37)
    nothing = np.empty((0, 2))
    assert (plate.deflection(np.array([[10.0, 0.0]]), nothing, np.empty(0)) == 0).all()
    assert plate.deflection(nothing, np.array([[10.0, 0.0]]), np.array([5.0])).shape == (0,)
