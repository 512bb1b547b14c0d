"""The same boundary value problem assembled by scikit-fem and solved by scipy: other code, other linear algebra.

Linear displacement and a pressure at the nodes, on which the volume is averaged, written as a mixed weak form: one
point in every tetrahedron, and the corners for the term that becomes diagonal. So it agrees on the same mesh to as
many digits as either is solved for.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bmat, csc_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, LinearForm, MeshTet
from skfem.helpers import ddot, det, grad, inv, mul, transpose

from bench.support.bodies import Floats
from simcore.core.artifacts import Compression, TetMesh
from simcore.fem.laws.neo_hookean import NeoHookean

ON_PLATE_MM = 1e-5
_MAX_NEWTON = 25


@dataclass(frozen=True, eq=False)
class ScikitRun:
    """As bench.peers.calculix.CalculixRun. displacement: (n, 3) of the mesh nodes."""

    force_lower_N: float
    force_upper_N: float
    displacement: Floats
    newton_iterations: int
    seconds: float

    @property
    def force_N(self) -> float:
        return 0.5 * (self.force_lower_N + self.force_upper_N)


def _gradient(u: Any) -> Any:
    """(3, 3, elements, points); a displacement in the plane strains nothing across it."""
    in_plane = np.asarray(grad(u))
    missing = 3 - len(in_plane)
    return np.pad(in_plane, [(0, missing), (0, missing), (0, 0), (0, 0)])


def _kinematics(u: Any) -> tuple[Any, Any, Any]:
    """(F, det F, F^-T) at the quadrature points."""
    F = _gradient(u) + np.eye(3)[:, :, None, None]
    return F, det(F), transpose(inv(F))


@LinearForm
def _force(v: Any, w: Any) -> Any:
    F, J, Fit = _kinematics(w["u"])
    mu = w["mu"] * J ** (-2 / 3)
    return ddot(mu * (F - ddot(F, F) / 3 * Fit) + w["p"] * J * Fit, _gradient(v))


@BilinearForm
def _stiffness(u: Any, v: Any, w: Any) -> Any:
    F, J, Fit = _kinematics(w["u"])
    dF = _gradient(u)
    mu, I1 = w["mu"] * J ** (-2 / 3), ddot(F, F)
    rate, swapped = ddot(Fit, dF), mul(Fit, mul(transpose(dF), Fit))
    isochoric = dF - 2 / 3 * rate * F - 2 / 3 * ddot(F, dF) * Fit + I1 * (2 / 9 * rate * Fit + swapped / 3)
    return ddot(mu * isochoric + w["p"] * J * (rate * Fit - swapped), _gradient(v))


@BilinearForm
def _coupling(p: Any, v: Any, w: Any) -> Any:
    _, J, Fit = _kinematics(w["u"])
    return p * J * ddot(Fit, _gradient(v))


@LinearForm
def _volume(q: Any, w: Any) -> Any:
    return q * _kinematics(w["u"])[1]


@LinearForm
def _wanted_volume(q: Any, w: Any) -> Any:
    t = w["p"] / w["kappa"]
    return q * (1 + t if w["squared"] else t + np.sqrt(t * t + 1))


@BilinearForm
def _compliance(p: Any, q: Any, w: Any) -> Any:
    t = w["p"] / w["kappa"]
    return p * q * (1 if w["squared"] else 1 + t / np.sqrt(t * t + 1)) / w["kappa"]


def hold(
    mesh: TetMesh,
    material: NeoHookean,
    ours: Compression,
    *,
    load_steps: int = 8,
    tolerance: float = 1e-8,
    squared: bool = False,
) -> ScikitRun:
    """Contact prescribed: what lies on a plate in ``ours`` gets its z displacement, in equal load steps from rest.

    mesh: symmetric about y = 0: two wall nodes there are held along y, where ours has a guard against rolling.
    tolerance: residual relative to the largest nodal force. squared: with CalculiX's volumetric energy, see there.
    """
    start = time.perf_counter()
    problem = MixedProblem.of_tets(mesh, material, squared)
    nodes = mesh.nodes
    height = nodes[:, 2] + ours.displacement[:, 2]
    lower, upper = (np.flatnonzero(np.abs(height - plate) < ON_PLATE_MM) for plate in ours.plate_z)
    fixed, target = np.zeros(nodes.shape, dtype=bool), np.zeros(nodes.shape)
    fixed[mesh.wall, 0] = True
    middle = mesh.wall[np.abs(nodes[mesh.wall, 1]) < 1e-9]
    fixed[middle[np.argsort(nodes[middle, 2])][[0, -1]], 1] = True
    for touching in (lower, upper):
        fixed[touching, 2] = True
        target[touching, 2] = ours.displacement[touching, 2]
    displacement, pressure = np.zeros(nodes.shape), np.zeros(len(nodes))
    iterations = 0
    for share in np.linspace(0, 1, load_steps + 1)[1:]:
        displacement, pressure, taken = problem.solve(displacement, pressure, fixed, share * target, tolerance)
        iterations += taken
    force = problem.force(displacement, pressure)[:, 2]
    seconds = time.perf_counter() - start
    return ScikitRun(float(force[lower].sum()), float(-force[upper].sum()), displacement, iterations, seconds)


@dataclass(frozen=True, eq=False)
class MixedProblem:
    """Displacement and pressure. displacements, pressures, corners: bases, the last one for the term in J(p).
    shear, bulk: N/mm^2. squared: volumetric energy kappa/2 (J - 1)^2 instead of ours."""

    displacements: Any
    pressures: Any
    corners: Any
    shear: float
    bulk: float
    squared: bool = False

    @classmethod
    def of_tets(cls, mesh: TetMesh, material: NeoHookean, squared: bool = False) -> MixedProblem:
        law = material.law()
        tets = MeshTet(np.ascontiguousarray(mesh.nodes.T), np.ascontiguousarray(mesh.tets.T))
        displacements = Basis(tets, ElementVector(ElementTetP1()), intorder=1)
        points = np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
        corners = Basis(tets, ElementTetP1(), quadrature=(points, np.full(4, 1 / 24)))
        pressures = displacements.with_element(ElementTetP1())
        return cls(displacements, pressures, corners, law.shear * 1e-3, law.bulk * 1e-3, squared)

    @property
    def shape(self) -> tuple[int, int]:
        """(displacement nodes, dimensions)"""
        dimensions = self.displacements.mesh.dim()
        return self.displacements.N // dimensions, dimensions

    def force(self, displacement: Floats, pressure: Floats) -> Floats:
        """Internal force, N, in the shape of the displacement."""
        return np.asarray(_force.assemble(self.displacements, **self._state(displacement, pressure))).reshape(
            self.shape
        )

    def solve(
        self,
        displacement: Floats,
        pressure: Floats,
        fixed: NDArray[np.bool_],
        target: Floats,
        tolerance: float,
        load: Floats | None = None,
    ) -> tuple[Floats, Floats, int]:
        """Newton's method with direct solution. load: dead nodal forces. returns: (displacement, pressure, iterations)

        raises: RuntimeError where it does not converge
        """
        free = np.concatenate([~fixed.ravel(), np.ones(len(pressure), dtype=bool)])
        for iteration in range(_MAX_NEWTON):
            state, of_pressure = self._state(displacement, pressure), self._pressure_at(self.corners, pressure)
            force = _force.assemble(self.displacements, **state)
            volume = _volume.assemble(self.pressures, **state) - _wanted_volume.assemble(self.corners, **of_pressure)
            step = np.concatenate([np.where(fixed, target - displacement, 0.0).ravel(), np.zeros(len(pressure))])
            scale = np.abs(force).max()
            residual = np.concatenate([force if load is None else force - load.ravel(), volume])
            if iteration > 0 and np.abs(residual[free]).max() < tolerance * scale and np.abs(step).max() < 1e-12:
                return displacement, pressure, iteration
            coupling = _coupling.assemble(self.pressures, self.displacements, **state)
            tangent = bmat(
                [
                    [_stiffness.assemble(self.displacements, **state), coupling],
                    [coupling.T, -_compliance.assemble(self.corners, **of_pressure)],
                ],
                format="csc",
            )
            rhs = -(residual + tangent @ step)
            step[free] = splu(csc_matrix(tangent)[free][:, free]).solve(rhs[free])
            displacement = displacement + step[: displacement.size].reshape(self.shape)
            pressure = pressure + step[displacement.size :]
        raise RuntimeError(f"scikit-fem: no convergence in {_MAX_NEWTON} iterations")

    def _state(self, displacement: Floats, pressure: Floats) -> dict[str, Any]:
        return {
            "u": self.displacements.interpolate(displacement.ravel()),
            "mu": self.shear,
            **self._pressure_at(self.pressures, pressure),
        }

    def _pressure_at(self, basis: Any, pressure: Floats) -> dict[str, Any]:
        return {"p": basis.interpolate(pressure), "kappa": self.bulk, "squared": self.squared}
