"""Plates that bend: Ritz' plate against Plexiglas meshed with bricks, and the compression against rigid plates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementHex2, ElementVector, LinearForm, MeshHex
from skfem.helpers import ddot, sym_grad, trace

from bench.support.bodies import C_CUP, ONE_TISSUE, Floats
from bench.verification.check import Check, relative
from bench.verification.exact import MATERIAL
from simcore.fem import CompressionSpec, compress
from simcore.fem.plates.bending import BendingPlate
from simcore.fem.spec import ElasticPlates
from simcore.mesh.structured import half_ellipsoid

PLATE = ElasticPlates(thickness_mm=10.0)
PATCH = (100.0, 100.0)
"""Extent of a uniform pressure along x from the chest wall, and along y, centred, mm: where a breast presses."""
PRESSURE = 5e-3
"""N/mm^2"""
CELL_MM = 20.0
POINTS = np.array([[0.0, 0.0], [60.0, 0.0], [120.0, 50.0]])
RIGID_MM = 50.0


def ritz_deflection() -> Floats:
    """At POINTS, mm."""
    plate = BendingPlate.of(
        PLATE.depth_mm, PLATE.width_mm, PLATE.thickness_mm, PLATE.youngs_modulus_MPa, PLATE.poissons_ratio
    )
    step = 2.0
    x, y = np.arange(step / 2, PATCH[0], step), np.arange((step - PATCH[1]) / 2, PATCH[1] / 2, step)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return plate.deflection(POINTS, at, np.full(len(at), PRESSURE * step**2))


def meshed_deflection() -> Floats:
    """The same by linear elasticity in three dimensions: a layer of 27-node bricks, hard simple supports, mm."""
    half = PLATE.thickness_mm / 2
    x = np.arange(0.0, PLATE.depth_mm + 1, CELL_MM)
    y = np.arange(-PLATE.width_mm / 2, PLATE.width_mm / 2 + 1, CELL_MM)
    mesh = MeshHex.init_tensor(x, y, np.array([-half, half]))
    basis = Basis(mesh, ElementVector(ElementHex2()), intorder=4)
    mu = PLATE.youngs_modulus_MPa / (2 * (1 + PLATE.poissons_ratio))
    lame = 2 * mu * PLATE.poissons_ratio / (1 - 2 * PLATE.poissons_ratio)

    @BilinearForm
    def stiffness(u: Any, v: Any, _: Any) -> Any:
        return lame * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(sym_grad(u), sym_grad(v))

    def pressed(centre: Floats) -> Any:
        inside = (centre[0] < PATCH[0]) & (np.abs(centre[1]) < PATCH[1] / 2)
        return inside & (np.abs(centre[2] - half) < 1e-9)

    patch = basis.boundary(mesh.facets_satisfying(pressed))
    load = LinearForm(lambda v, _: PRESSURE * v[2]).assemble(patch)
    # Degrees of freedom of a node follow one another: x, y, z.
    at, component = basis.doflocs, np.arange(basis.N) % 3
    sides, end = np.abs(np.abs(at[1]) - PLATE.width_mm / 2) < 1e-9, np.abs(at[0] - PLATE.depth_mm) < 1e-9
    supported = (sides | end) & (component == 2) & (np.abs(at[2]) < 1e-9)
    supported |= (sides & (component == 0)) | (end & (component == 1))
    free = ~supported
    u = np.zeros(basis.N)
    matrix = stiffness.assemble(basis).tocsc()
    u[free] = splu(matrix[free][:, free]).solve(load[free])
    values = [
        u[(component == 2) & (np.abs(at - np.array([*point, 0.0])[:, None]).max(axis=0) < 1e-9)] for point in POINTS
    ]
    return np.concatenate(values)


def plate_checks(cells: int = 10) -> Iterator[Check]:
    group = "Bending plates"
    for point, exact, ours in zip(POINTS, meshed_deflection(), ritz_deflection(), strict=True):
        where = f"deflection at x = {point[0]:g}, y = {point[1]:g} mm"
        yield relative(group, f"Plexiglas of 10 mm under 5 kPa on 100 x 100 mm: {where}", exact, ours, 0.03, "mm")
    mesh = half_ellipsoid(C_CUP, cells)
    spec = CompressionSpec(percent=50.0, material=MATERIAL)
    rigid = compress(mesh, ONE_TISSUE, spec).force_N
    elastic = compress(mesh, ONE_TISSUE, spec.with_(elastic_plates=ElasticPlates(thickness_mm=RIGID_MM))).force_N
    yield relative(group, f"cup C at 50 %, plates of {RIGID_MM:g} mm against rigid ones", rigid, elastic, 5e-3, "N")
