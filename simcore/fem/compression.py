"""The compression stage."""

from __future__ import annotations

import math

import numpy as np

from simcore.core.advice import one_of, where
from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.errors import SolverError
from simcore.core.progress import Progress, part
from simcore.fem.chest_wall import Support
from simcore.fem.elements.model import Model
from simcore.fem.newton.path import Target, follow
from simcore.fem.newton.press import ElasticPress, Press, RigidPress, SpringPress
from simcore.fem.newton.solver import Solver
from simcore.fem.plates.bending import BendingPlate
from simcore.fem.plates.edge import PlateEdge
from simcore.fem.plates.friction import Friction
from simcore.fem.report.report import beyond_plates, report, verify
from simcore.fem.spec import MOST_PERCENT, CompressionSpec
from simcore.fem.tissues import element_laws

FRICTION_LOAD_STEPS = 10
"""Twice as many change the force of a C cup at 50 % by less than 0.5 %."""


def compress_mesh(mesh: TetMesh, phantom: Phantom, spec: CompressionSpec, progress: Progress) -> Compression:
    """See simcore.fem.compress."""
    progress(0.0, "setting up the equations")
    if len(mesh.wall) < 3 or np.any(mesh.nodes[mesh.wall, 0] != 0.0):
        raise SolverError(
            f"the mesh has {len(mesh.wall)} chest-wall nodes, some not at x = 0: at least 3 exactly there are needed",
            code="no-chest-wall",
        )
    support = Support.of(mesh, phantom, spec)
    solver = solver_of(mesh, phantom, spec, support)
    contact = support.contact(mesh)
    edge = support.plate_edge(mesh, spec.plate_edge_mm)
    target = target_of(spec, float(np.ptp(mesh.nodes[:, 2])))
    # Friction depends on the way.
    load_steps = spec.load_steps if solver.friction is None else max(spec.load_steps, FRICTION_LOAD_STEPS)
    solution = follow(solver, contact, target, load_steps, part(progress, 0.05, 0.98), press_of(spec, edge))
    plates = solution.state.plates
    assert plates is not None  # no state but that of rest is without
    verify(solver, solution, plates, spec)
    facts = report(mesh, solver, solution, plates)
    after = mesh.nodes + solution.state.displacement
    if spec.elastic_plates is not None:
        facts |= beyond_plates(spec.elastic_plates, after, solution.state.contact.status)
    progress(1.0, f"compressed to {facts['thickness_mm']:.1f} mm")
    return Compression(
        displacement=solution.state.displacement,
        plate_z=plates.bounds(after),
        force_N=0.5 * (facts["force_lower_N"] + facts["force_upper_N"]),
        outcome="converged",
        report=facts,
    )


def solver_of(mesh: TetMesh, phantom: Phantom, spec: CompressionSpec, support: Support | None = None) -> Solver:
    """The equations of ``spec`` on ``mesh``. support: that of ``spec`` where not given."""
    support = support or Support.of(mesh, phantom, spec)
    model = Model.of(
        mesh,
        element_laws(mesh, phantom, spec.material),
        skin_tension=0.0 if spec.skin is None else spec.skin.tension(),
        weight=(0.0, 0.0, 0.0) if spec.gravity is None else spec.gravity.weight(),
    )
    friction = Friction(spec.friction) if spec.friction > 0 else None
    return Solver(model, support.fixed, support.guard, spec.tolerance, friction)


def press_of(spec: CompressionSpec, edge: PlateEdge | None = None) -> Press:
    """How the plates of ``spec`` give way. edge: theirs at a fixed chest wall."""
    if spec.spring_paddle is not None:
        paddle = spec.spring_paddle
        return SpringPress(math.degrees(paddle.stiffness_Nmm_per_degree), paddle.pivot_mm, edge)
    if spec.elastic_plates is not None:
        p = spec.elastic_plates
        return ElasticPress(
            BendingPlate.of(p.depth_mm, p.width_mm, p.thickness_mm, p.youngs_modulus_MPa, p.poissons_ratio), edge
        )
    return RigidPress(math.tan(math.radians(spec.paddle_angle_degrees)), edge)


def target_of(spec: CompressionSpec, thickness_mm: float) -> Target:
    """Where the plates stop for a breast of ``thickness_mm``.

    raises: SolverError, code "target-not-reached"
    """
    percent = spec.percent
    if spec.thickness_mm is not None:
        percent = 100 * (1 - spec.thickness_mm / thickness_mm)
        if not 0 < percent <= spec.percent:
            least = thickness_mm * (1 - spec.percent / 100)
            remedy = one_of(
                f"thickness_mm below {thickness_mm:.1f}" if percent <= 0 else f"thickness_mm = {least:.1f} or more",
                where(spec.percent < percent <= MOST_PERCENT, f"percent = {math.ceil(percent)}"),
            )
            raise SolverError(
                f"thickness_mm = {spec.thickness_mm:g} is {percent:.1f} % off the uncompressed {thickness_mm:.1f} mm, "
                f"where more than 0 and at most percent = {spec.percent:g} are allowed; take {remedy}",
                code="target-not-reached",
            )
    return Target(percent, spec.force_N, spec.force_limit_N, spec)
