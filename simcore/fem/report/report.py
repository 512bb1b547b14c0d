"""Facts about a compression, and the checks that no wrong answer passes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Report, TetMesh
from simcore.core.errors import SolverError
from simcore.fem.elements.geometry import volume_ratios
from simcore.fem.elements.model import Floats
from simcore.fem.linear.tangent import norm
from simcore.fem.newton.outcome import remedy_of_unverified
from simcore.fem.newton.path import Solution
from simcore.fem.newton.solver import GAP_MM, Solver
from simcore.fem.plates.constraints import Constraints
from simcore.fem.plates.contact import FREE, LOWER, MAX_PULL, UPPER, Plates
from simcore.fem.plates.friction import STICK_MM
from simcore.fem.report.summary import shape_summary, strain_summary
from simcore.fem.spec import CompressionSpec, ElasticPlates

_BALANCE = 1e-3
_DRIFT_MM = 1e-6
"""Movement along y of a chest wall that may neither drift nor roll: rounding."""


def verify(solver: Solver, solution: Solution, plates: Plates, spec: CompressionSpec | None = None) -> None:
    """Looks at the final state afresh: residual, penetration, sign and balance of the plate forces, volumes.

    spec: what was asked for; a failure does not advise what it has already.

    raises: SolverError, code "not-converged" or "inverted-element"
    """
    model, state = solver.model, solution.state
    remedy = remedy_of_unverified(spec or CompressionSpec())
    carried = model.internal_force(state.displacement, state.pressure)
    force = solver.with_friction(state, carried)
    constraints = Constraints.of(solver.fixed, state.contact, plates)
    points = model.nodes + state.displacement
    low, high = state.contact.forces(carried[:, 2])
    weight = 0.0 if model.load is None else float(model.load[:, 2].sum())
    support = float(carried[solver.fixed[:, 2], 2].sum())
    balance = max(_BALANCE, np.sqrt(len(points)) * solver.tolerance)
    values = [
        ("relative residual", solver.relative_residual(force, constraints, state.contact), solver.tolerance),
        ("penetration of a plate [mm]", state.contact.penetration(points, plates), 2 * GAP_MM),
        ("pull of a plate on a node, relative", state.contact.relative_pull(carried, plates), MAX_PULL),
        (
            "imbalance of the plates, relative",
            abs(low - high + support + weight) / max(high, low, 1e-12),
            balance,
        ),
        ("drift or roll of the chest wall [mm]", solver.guard.drift(state.displacement), _DRIFT_MM),
        (
            "relative residual where the guard of the chest wall takes no more than a force and a moment",
            _residual_without_guard(solver, force, constraints) / solver.scale(force, state.contact),
            2 * solver.tolerance,
        ),
    ]
    smallest = float(volume_ratios(state.displacement, model.tets, model.gradients).min())
    if not (smallest > 0 and np.isfinite(state.displacement).all()):
        raise SolverError(f"the smallest det F is {smallest:.3g}; take {remedy}", code="inverted-element")
    for name, value, allowed in values:
        if not value <= allowed:
            raise SolverError(
                f"{name} is {value:.2e} where {allowed:.2e} is allowed; take {remedy}",
                code="not-converged",
            )


def report(mesh: TetMesh, solver: Solver, solution: Solution, plates: Plates) -> Report:
    """JSON-ready facts of a verified solution."""
    model, state = solver.model, solution.state
    ratios = volume_ratios(state.displacement, model.tets, model.gradients)
    deformed = model.nodes + state.displacement
    last = solution.steps[-1]
    mean = last.force
    area_lower, area_upper = (
        _contact_area(deformed, mesh.skin, state.contact.status == plate) for plate in (LOWER, UPPER)
    )
    area = 0.5 * (area_lower + area_upper)
    carried = model.internal_force(state.displacement, state.pressure)
    force = solver.with_friction(state, carried)
    wall_nodes = np.flatnonzero(solver.fixed[:, 0])
    wall = force[wall_nodes, 0] - state.contact.reaction(carried, plates)[wall_nodes, 0]
    drift, roll = _guarded(mesh, force)
    return {
        "percent": last.percent,
        "thickness_mm": float(np.subtract(*plates.bounds(deformed)[::-1])),
        "plates": _plate_facts(plates, state.contact.status),
        "uncompressed_thickness_mm": float(np.ptp(model.nodes[:, 2])),
        "force_N": mean,
        "force_upper_N": last.force_upper,
        "force_lower_N": last.force_lower,
        "force_balance": abs(last.force_upper - last.force_lower) / max(mean, 1e-12),
        "force_curve": solution.force_curve,
        "contact_nodes": {
            "lower": int(np.count_nonzero(state.contact.status == LOWER)),
            "upper": int(np.count_nonzero(state.contact.status == UPPER)),
        },
        "friction": _friction_facts(solver, solution, plates, carried),
        "contact_area_mm2": area,
        "mean_pressure_kPa": 1e3 * mean / area if area > 0 else 0.0,
        "min_det_F": float(ratios.min()),
        "max_det_F": float(ratios.max()),
        "log_strain": strain_summary(model, state.displacement),
        "mesh_quality": shape_summary(deformed, model.tets),
        "volume_change": float((ratios * model.volumes).sum() / model.volumes.sum() - 1),
        "extent_x_mm": [float(deformed[:, 0].min()), float(deformed[:, 0].max())],
        "extent_y_mm": [float(deformed[:, 1].min()), float(deformed[:, 1].max())],
        "uncompressed_extent_x_mm": [float(model.nodes[:, 0].min()), float(model.nodes[:, 0].max())],
        "uncompressed_extent_y_mm": [float(model.nodes[:, 1].min()), float(model.nodes[:, 1].max())],
        "wall_force_N": float(-wall.sum()),
        "guard_force_N": drift,
        "guard_moment_Nmm": roll,
        "wall_drift_mm": solver.guard.drift(state.displacement),
        "relative_residual": last.residual,
        "load_steps": len(solution.steps),
        "newton_iterations": solution.counters.newton,
        "cg_iterations": solution.counters.cg,
    }


def beyond_plates(plate: ElasticPlates, points: Floats, status: NDArray[np.int8]) -> Report:
    """{"least_plates_mm": (depth, width) that would reach as far as the skin that touches}, where ``plate`` does not:
    it counts as held there. points: (n, 3), present, mm. status: of Contact."""
    x, y, _ = points[status != FREE].T
    least = [math.ceil(x.max(initial=0.0)), 2 * math.ceil(np.abs(y).max(initial=0.0))]
    small = plate.depth_mm < x.max(initial=0.0) or plate.width_mm < 2 * np.abs(y).max(initial=0.0)
    return {"least_plates_mm": least} if small else {}


def _plate_facts(plates: Plates, status: NDArray[np.int8]) -> Report:
    """Travel, tilt and bending of the plates, and the rise of their edge at a fixed chest wall."""
    bends = [
        0.0 if bend is None else float(np.abs(bend[status == plate]).max(initial=0.0))
        for bend, plate in ((plates.lower_bend, LOWER), (plates.upper_bend, UPPER))
    ]
    rises = [0.0 if rise is None else float(np.abs(rise).max()) for rise in (plates.lower_rise, plates.upper_rise)]
    return {
        "lower_z_mm": plates.lower,
        "upper_z_mm": plates.upper,
        "upper_angle_degrees": float(np.degrees(np.arctan(plates.slope))),
        "upper_pivot_x_mm": plates.pivot,
        "lower_bend_mm": bends[0],
        "upper_bend_mm": bends[1],
        "lower_rise_mm": rises[0],
        "upper_rise_mm": rises[1],
    }


def _friction_facts(solver: Solver, solution: Solution, plates: Plates, carried: Floats) -> Report | None:
    """Tangential force of each plate along (x, y, z), N, as it acts on the breast, and the share of the pushed nodes
    that slide."""
    state = solution.state
    if solver.friction is None or state.slip is None:
        return None
    push = state.contact.push(carried, plates)
    resistance = solver.friction.resistance(state.slip, push)
    pushed = push > 0
    return {
        "lower_N": [float(f) for f in -resistance[state.contact.status == LOWER].sum(axis=0)],
        "upper_N": [float(f) for f in -resistance[state.contact.status == UPPER].sum(axis=0)],
        "sliding_share": float((state.slip.length[pushed] > STICK_MM).mean()) if pushed.any() else 0.0,
    }


def _contact_area(nodes: Floats, faces: NDArray[np.int64], touching: NDArray[np.bool_]) -> float:
    """Area of the deformed skin on a plate, mm^2: a third of each triangle, seen along z, for each of its nodes that
    touches."""
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    area = 0.5 * np.abs(np.cross(b - a, c - a)[:, 2])
    return float((area * touching[faces].sum(axis=1)).sum() / 3)


def _residual_without_guard(solver: Solver, force: Floats, constraints: Constraints) -> float:
    """Norm, N, of what is out of balance beside a force along y and a moment about x on the chest wall: fitted here to
    its nodes, so that nothing else can hide in the guard of the solver. force: (n, 3), N."""
    unbalanced, wall = force.copy(), solver.guard.nodes
    constraints.project(unbalanced)
    if not len(wall):
        return 0.0  # no guard: relative_residual says it
    rigid = np.stack([np.ones(len(wall)), solver.model.nodes[wall, 2]], axis=1)
    unbalanced[wall, 1] -= rigid @ np.linalg.lstsq(rigid, unbalanced[wall, 1], rcond=None)[0]
    return norm(unbalanced)


def _guarded(mesh: TetMesh, force: Floats) -> tuple[float, float]:
    """(force along y, N; moment about x, N mm) that keep the chest wall from drifting and rolling."""
    along_y = force[mesh.wall, 1]
    arm = mesh.nodes[mesh.wall, 2] - mesh.nodes[mesh.wall, 2].mean()
    return float(along_y.sum()), float(-(along_y * arm).sum())
