"""Exact solutions: affine deformations, a tangent, a manufactured solution, Hertz' contact."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.support.bodies import ONE_TISSUE, Floats, cushion
from bench.verification.boundary_value import equilibrium, residual_and_tangent
from bench.verification.check import Check, absolute, at_least, relative
from bench.verification.closed_forms import hertz, piola_stress, uniaxial
from simcore.core.artifacts import TetMesh
from simcore.fem import CompressionSpec, compress
from simcore.fem.elements.model import Model
from simcore.fem.laws.law import Law
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.mesh.quality import boundary_faces, volumes
from simcore.mesh.structured import box

MATERIAL = NeoHookean(youngs_modulus_kPa=60.6, poissons_ratio=0.475)
BLOCK = (30.0, 40.0, 20.0)


def model_of(mesh: TetMesh, law: Law) -> Model:
    return Model.of(mesh, ElementLaws.homogeneous(law, len(mesh.tets)))


def jittered_block(cells: tuple[int, int, int] = (3, 4, 3)) -> TetMesh:
    return box(BLOCK, cells, jitter=0.2, generator=np.random.default_rng(5))


def affine(gradient: Floats) -> tuple[TetMesh, Floats, Floats, Floats]:
    """Block of distorted tetrahedra whose surface follows u = gradient X.

    returns: (mesh, displacement found, exact displacement, mean first Piola-Kirchhoff stress found, kPa)
    """
    mesh = jittered_block((4, 4, 4))
    exact = mesh.nodes @ gradient.T
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[np.unique(boundary_faces(mesh.tets))] = True
    solution = equilibrium(model_of(mesh, MATERIAL.law()), fixed, exact, load_steps=4)
    stress = 1e3 * solution.reaction.T @ mesh.nodes / volumes(mesh.nodes, mesh.tets).sum()
    return mesh, solution.displacement, exact, stress


def affine_checks() -> Iterator[Check]:
    """Patch test, simple shear, confined compression: the surface is given, inside must be affine."""
    cases = {
        "patch test, general gradient": np.array([[0.2, 0.1, -0.05], [0.08, -0.25, 0.1], [0.03, 0.06, 0.15]]),
        "simple shear 0.3": np.array([[0, 0, 0.3], [0, 0, 0], [0, 0, 0]]),
        "simple shear 1.0": np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]),
        "confined compression to 0.9": np.diag([0.0, 0.0, -0.1]),
        "confined compression to 0.6": np.diag([0.0, 0.0, -0.4]),
    }
    for name, gradient in cases.items():
        _, displacement, exact, stress = affine(gradient)
        expected = piola_stress(np.eye(3) + gradient, MATERIAL.law())
        yield absolute("Affine", f"{name}: largest nodal error", float(np.abs(displacement - exact).max()), 1e-7, "mm")
        i, j = (0, 2) if "shear" in name else (2, 2)
        yield relative("Affine", f"{name}: stress P_{'xyz'[i]}{'xyz'[j]}", expected[i, j], stress[i, j], 1e-7, "kPa")


def uniaxial_checks() -> Iterator[Check]:
    """A block between the plates, through the public function."""
    mesh = jittered_block()
    for nu in (0.3, 0.475, 0.495, 0.499):
        material = MATERIAL.with_(poissons_ratio=nu)
        for percent in (1.0, 20.0, 50.0, 70.0):
            spec = CompressionSpec(percent=percent, material=material, tolerance=1e-9)
            force = compress(mesh, ONE_TISSUE, spec).force_N
            stress, _ = uniaxial(1 - percent / 100, material.law())
            expected = -stress * 1e-3 * BLOCK[0] * BLOCK[1]
            yield relative("Uniaxial", f"block, {percent:g} %, nu = {nu}: plate force", expected, force, 1e-6, "N")


def tangent_checks() -> Iterator[Check]:
    """Tangent against central differences at a random state."""
    model = model_of(box(BLOCK, (2, 2, 2)), MATERIAL.law())
    generator = np.random.default_rng(7)
    n = len(model.nodes)
    state = np.concatenate([generator.normal(0, 0.6, 3 * n), generator.normal(0, 0.05, n)])
    direction = np.concatenate([generator.normal(0, 1, 3 * n), generator.normal(0, 0.1, n)])

    def at(x: Floats) -> tuple[Floats, Floats]:
        residual, tangent = residual_and_tangent(model, x[: 3 * n].reshape(n, 3), x[3 * n :], model.system())
        return residual, tangent @ direction

    step = 1e-5
    rate = (at(state + step * direction)[0] - at(state - step * direction)[0]) / (2 * step)
    exact = at(state)[1]
    error = float(np.abs(rate - exact).max() / np.abs(exact).max())
    yield absolute("Tangent", "central differences against the tangent, relative", error, 1e-7)


def manufactured_field(points: Floats) -> tuple[Floats, Floats]:
    """A smooth, volume-preserving displacement of the block: three shears one after the other.

    points: (..., 3), mm. returns: (displacement (..., 3), deformation gradient (..., 3, 3))
    """
    wave = 2 / np.array(BLOCK)
    moved = points.copy()
    gradient = np.broadcast_to(np.eye(3), (*points.shape, 3)).copy()
    for i, j, k, amplitude in ((0, 1, 2, 2.0), (1, 2, 0, -2.0), (2, 0, 1, 1.5)):
        first, second = wave[j] * moved[..., j] + 0.3, wave[k] * moved[..., k] + 0.8
        slope_j = amplitude * wave[j] * np.cos(first) * np.sin(second)
        slope_k = amplitude * wave[k] * np.sin(first) * np.cos(second)
        gradient[..., i, :] += slope_j[..., None] * gradient[..., j, :] + slope_k[..., None] * gradient[..., k, :]
        moved[..., i] += amplitude * np.sin(first) * np.sin(second)
    return moved - points, gradient


def body_force(points: Floats, law: Law) -> Floats:
    """-Div P of the manufactured field, N/mm^3, by sixth-order differences. points: (..., 3)"""
    weights, step = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}, 0.05

    def stress(x: Floats) -> Floats:
        return 1e-3 * piola_stress(manufactured_field(x)[1], law)

    force = np.zeros(points.shape)
    for j in range(3):
        for k, weight in weights.items():
            offset = k * step * np.eye(3)[j]
            force -= weight / step * (stress(points + offset) - stress(points - offset))[..., j]
    return force


def manufactured_error(cells: int, law: Law) -> tuple[float, float]:
    """(element size, mm; root mean square nodal error over root mean square displacement)"""
    mesh = box(BLOCK, (3 * cells // 2, 2 * cells, cells))
    exact, _ = manufactured_field(mesh.nodes)
    # Four points of the second order in every tetrahedron.
    near, far = (5 + 3 * 5**0.5) / 20, (5 - 5**0.5) / 20
    shares = np.full((4, 4), far) + (near - far) * np.eye(4)
    points = np.einsum("qa,eai->eqi", shares, mesh.nodes[mesh.tets])
    per_point = volumes(mesh.nodes, mesh.tets)[:, None, None] / 4 * body_force(points, law)
    load = np.zeros(mesh.nodes.shape)
    np.add.at(load, mesh.tets, np.einsum("qa,eqi->eai", shares, per_point))
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[np.unique(boundary_faces(mesh.tets))] = True
    displacement = equilibrium(model_of(mesh, law), fixed, exact, load, load_steps=2).displacement
    return BLOCK[2] / cells, float(np.sqrt(((displacement - exact) ** 2).sum() / (exact**2).sum()))


def manufactured_orders(cells: tuple[int, ...] = (8, 10, 12)) -> dict[float, list[tuple[float, float]]]:
    """Errors over element sizes for each Poisson's ratio."""
    return {
        nu: [manufactured_error(n, MATERIAL.with_(poissons_ratio=nu).law()) for n in cells] for nu in (0.475, 0.499)
    }


def order(errors: list[tuple[float, float]]) -> float:
    """Slope of log error over log size."""
    size, error = np.log(np.array(errors)).T
    return float(np.polyfit(size, error, 1)[0])


def manufactured_checks(errors: dict[float, list[tuple[float, float]]]) -> Iterator[Check]:
    for nu, values in errors.items():
        yield at_least(
            "Order of convergence", f"displacement of a manufactured solution, nu = {nu}", 1.8, order(values)
        )


def hertz_ratios(cells: int = 12, poissons_ratio: float = 0.475) -> list[tuple[float, float]]:
    """(contact radius over half width of the body, plate force over Hertz' force) at compressions of 0.2 to 2 %."""
    half_width, radius = 60.0, 240.0
    mesh = cushion(half_width, radius, cells)
    material = NeoHookean(youngs_modulus_kPa=60.6, poissons_ratio=poissons_ratio)
    ratios = []
    for percent in np.geomspace(0.2, 2.0, 9):
        approach = half_width * percent / 100
        force = compress(mesh, ONE_TISSUE, CompressionSpec(percent=float(percent), material=material)).force_N
        exact = hertz(radius, approach, 60.6e-3, poissons_ratio) / 2
        ratios.append((float(np.sqrt(radius * approach)) / half_width, force / exact))
    return ratios


def hertz_checks(ratios: list[tuple[float, float]]) -> Iterator[Check]:
    """Hertz' body is a half space: the ratio is read where the contact has become small against the body."""
    size, ratio = np.array(ratios).T
    limit = float(np.polyfit(size, ratio, 1)[1])
    yield relative("Hertz", "plate force over Hertz' force, limit of small contact", 1.0, limit, 0.05)
