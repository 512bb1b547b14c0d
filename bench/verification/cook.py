"""Cook's membrane, nearly incompressible, at large strain and in plane strain.

Source: Simo, Armero, Geometrically non-linear enhanced strain mixed methods, Int. J. Numer. Meth. Engng 33 (1992).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from skfem import Basis, ElementTriP1, ElementTriP2, ElementVector, LinearForm, MeshTri

from bench.peers.scikit import MixedProblem
from bench.support.bodies import Floats
from bench.verification.boundary_value import equilibrium
from bench.verification.check import Check, at_least, relative
from bench.verification.exact import model_of, order
from simcore.core.artifacts import TetMesh
from simcore.fem.laws import neo_hookean
from simcore.fem.laws.law import Law
from simcore.mesh.quality import boundary_faces
from simcore.mesh.structured import box

SHEAR_KPA, BULK_KPA = 80.1938, 400889.8
"""nu = 0.4999"""
TRACTION = 100.0 / 16.0 * 1e-3
"""Upward shear on the right edge, N/mm^2; 100 N on 16 mm in the source's units."""
CELLS = (8, 16, 32, 64)


def membrane(s: Floats, t: Floats) -> tuple[Floats, Floats]:
    """(x, y) of the trapezoid, mm, from the unit square."""
    return 48 * s, 44 * s + t * (44 - 28 * s)


def tip_of_tets(cells: int) -> float:
    """Vertical displacement of the upper right corner with our tetrahedra, one layer of them, mm."""
    square = box((1.0, 1.0, 1.0), (cells, cells, 1))
    s, t = square.nodes[:, 0], square.nodes[:, 1] + 0.5
    thickness = 48 / cells
    nodes = np.stack([*membrane(s, t), thickness * square.nodes[:, 2]], axis=1)
    mesh = TetMesh(nodes, square.tets, square.wall, square.skin)
    fixed = np.zeros(nodes.shape, dtype=bool)
    fixed[:, 2] = True
    fixed[s == 0] = True
    faces = boundary_faces(mesh.tets)
    faces = faces[(s[faces] == 1).all(axis=1)]
    area = 0.5 * np.linalg.norm(
        np.cross(nodes[faces[:, 1]] - nodes[faces[:, 0]], nodes[faces[:, 2]] - nodes[faces[:, 0]]), axis=1
    )
    load = np.zeros(nodes.shape)
    np.add.at(load[:, 1], faces.ravel(), np.repeat(TRACTION * area / 3, 3))
    law = Law(neo_hookean.ENERGY, (SHEAR_KPA,), SHEAR_KPA, BULK_KPA)
    solution = equilibrium(model_of(mesh, law), fixed, np.zeros(nodes.shape), load, load_steps=5)
    return float(solution.displacement[(s == 1) & (t == 1), 1].mean())


def tip_of_taylor_hood(cells: int = 32) -> float:
    """The same with quadratic displacement and linear pressure on triangles, by scikit-fem, mm."""
    axis = np.linspace(0, 1, cells + 1)
    square = MeshTri.init_tensor(axis, axis)
    mesh = MeshTri(np.stack(membrane(*square.p)), square.t)
    displacements = Basis(mesh, ElementVector(ElementTriP2()), intorder=4)
    pressures = displacements.with_element(ElementTriP1())
    problem = MixedProblem(displacements, pressures, pressures, SHEAR_KPA * 1e-3, BULK_KPA * 1e-3)
    right = displacements.boundary(mesh.facets_satisfying(lambda x: np.abs(x[0] - 48) < 1e-9))
    load = LinearForm(lambda v, w: TRACTION * v[1]).assemble(right).reshape(problem.shape)
    location = displacements.doflocs[:, ::2]
    fixed = np.zeros(problem.shape, dtype=bool)
    fixed[location[0] < 1e-9] = True
    u, p = np.zeros(problem.shape), np.zeros(pressures.N)
    for share in np.linspace(0, 1, 6)[1:]:
        u, p, _ = problem.solve(u, p, fixed, np.zeros(problem.shape), 1e-7, share * load)
    return float(u[np.argmax(location[0] + location[1]), 1])


def tips() -> tuple[float, list[tuple[int, float]]]:
    """(Taylor-Hood, [(cells, ours)]), mm"""
    return tip_of_taylor_hood(), [(n, tip_of_tets(n)) for n in CELLS]


def cook_checks(reference: float, ours: list[tuple[int, float]]) -> Iterator[Check]:
    """Linear tetrahedra are stiff in bending, so it is the way to the reference that counts."""
    group = "Cook's membrane"
    cells, tip = ours[-1]
    yield relative(group, "tip of the reference (Taylor-Hood), against published 6.9", 6.9, reference, 0.005, "mm")
    yield relative(group, f"tip, nu = 0.4999, {cells} x {cells} cells, against Taylor-Hood", reference, tip, 0.02, "mm")
    errors = [(48 / n, abs(tip - reference)) for n, tip in ours]
    yield at_least(group, "order of convergence of the tip", 1.2, order(errors))
