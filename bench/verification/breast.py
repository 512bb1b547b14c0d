"""A half-ellipsoid breast between the plates: balance, similarity, convergence, and independent programs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.peers import calculix, scikit
from bench.support.bodies import C_CUP, ONE_TISSUE, as_quadratic
from bench.verification.check import Check, absolute, at_least, relative
from bench.verification.exact import MATERIAL
from bench.verification.explicit import relax
from simcore import phantom
from simcore.core.artifacts import Compression, TetMesh
from simcore.fem import CompressionSpec, compress
from simcore.fem.laws.published import Published
from simcore.fem.spec import SkinMembrane
from simcore.mesh import build
from simcore.mesh.spec import LatticeMesh
from simcore.mesh.structured import half_ellipsoid
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.presets import CUPS

SPEC = CompressionSpec(percent=50.0, material=MATERIAL)
SIZES = (5, 7, 10, 14, 20)


def similarity_checks(cells: int = 10) -> Iterator[Check]:
    """What must hold without knowing the answer."""
    mesh = half_ellipsoid(C_CUP, cells)
    ours = compress(mesh, ONE_TISSUE, SPEC)
    report = ours.report
    group = "Similarity"
    lower, upper = report["force_lower_N"], report["force_upper_N"]
    yield relative(group, "plates in balance: lower and upper force", lower, upper, 1e-4, "N")
    yield absolute(group, "force on the chest wall along x over the plate force", report["wall_force_N"] / lower, 1e-3)
    stiffer = SPEC.with_(material=MATERIAL.with_(youngs_modulus_kPa=3 * MATERIAL.youngs_modulus_kPa))
    yield relative(group, "F ~ E: E tripled", 3.0, compress(mesh, ONE_TISSUE, stiffer).force_N / ours.force_N, 1e-5)
    doubled = TetMesh(2 ** (1 / 3) * mesh.nodes, mesh.tets, mesh.wall, mesh.skin)
    ratio = compress(doubled, ONE_TISSUE, SPEC).force_N / ours.force_N
    yield relative(group, "F ~ V^(2/3): volume doubled", 2 ** (2 / 3), ratio, 1e-5)
    stepped = compress(mesh, ONE_TISSUE, SPEC.with_(load_steps=10))
    yield relative(group, "one load step or ten", ours.force_N, stepped.force_N, 1e-4, "N")
    furthest = float(np.abs(stepped.displacement - ours.displacement).max())
    yield absolute(group, "one load step or ten: largest difference of a node", furthest, 0.01, "mm")


def refinement(sizes: tuple[int, ...] = SIZES) -> list[tuple[int, float]]:
    """(tetrahedra, plate force, N) of finer and finer meshes."""
    meshes = [half_ellipsoid(C_CUP, n) for n in sizes]
    return [(len(m.tets), compress(m, ONE_TISSUE, SPEC).force_N) for m in meshes]


def refinement_checks(forces: list[tuple[int, float]]) -> Iterator[Check]:
    """The body of the mesh changes too: chords cut the curved outline."""
    count, force = np.array(forces).T
    # F(h) = F0 + c h^2 through the finest three
    limit = float(np.polyfit(count[-3:] ** (-2 / 3), force[-3:], 1)[1])
    errors = np.abs(force[:-1] / limit - 1)
    slope = -3 * float(np.polyfit(np.log(count[:-1]), np.log(errors), 1)[0])
    yield at_least("Order of convergence", "plate force of a cup C at 50 % with the mesh size", 1.5, slope)
    yield relative(
        "Order of convergence",
        f"plate force, {forces[-1][0]} tetrahedra against the limit",
        limit,
        force[-1],
        0.005,
        "N",
    )


def relaxation_checks(cells: int = 6) -> Iterator[Check]:
    mesh = half_ellipsoid(C_CUP, cells)
    ours = compress(mesh, ONE_TISSUE, SPEC)
    other = relax(mesh, MATERIAL.law(), SPEC.percent)
    yield from _against("Explicit relaxation", f"own contact, {len(mesh.tets)} tetrahedra", ours, other, 1e-3, 0.01)


def scikit_checks(cells: int = 10) -> Iterator[Check]:
    mesh = half_ellipsoid(C_CUP, cells)
    ours = compress(mesh, ONE_TISSUE, SPEC)
    other = scikit.hold(mesh, MATERIAL, ours)
    yield from _against("scikit-fem", f"prescribed contact, {len(mesh.tets)} tetrahedra", ours, other, 1e-3, 0.01)


def calculix_checks(cells: int = 20) -> Iterator[Check]:
    """The same nodes as ten-node tetrahedra: two discretisations of one body, so both errors count."""
    mesh, quadratic = as_quadratic(C_CUP, cells)
    ours = compress(mesh, ONE_TISSUE, SPEC)
    what = f"{len(mesh.tets)} linear, {len(quadratic)} ten-node tetrahedra"
    prescribed = calculix.hold(mesh.nodes, quadratic, MATERIAL, ours)
    yield relative("CalculiX", f"prescribed contact, {what}: plate force", prescribed.force_N, ours.force_N, 0.005, "N")
    free = calculix.compress(mesh.nodes, quadratic, MATERIAL, SPEC.percent)
    yield relative("CalculiX", f"own contact, {what}: plate force", free.force_N, ours.force_N, 0.005, "N")


def skin_checks(cells: tuple[int, int] = (14, 29)) -> Iterator[Check]:
    """From about 10 000 to 100 000 tetrahedra."""
    spec = SPEC.with_(skin=SkinMembrane(youngs_modulus_kPa=500.0))
    coarse, fine = (half_ellipsoid(C_CUP, n) for n in cells)
    what = f"cup C with skin of 1.5 mm, 500 kPa, {len(coarse.tets)} and {len(fine.tets)} tetrahedra: plate force"
    forces = [compress(mesh, ONE_TISSUE, spec).force_N for mesh in (coarse, fine)]
    yield relative("Skin", what, forces[1], forces[0], 0.02, "N")


def deep_checks(cells: int = 20) -> Iterator[Check]:
    """To 70 % in one load step and in ten."""
    mesh = half_ellipsoid(C_CUP, cells)
    spec = SPEC.with_(percent=70.0)
    once, stepped = (compress(mesh, ONE_TISSUE, s) for s in (spec, spec.with_(load_steps=10)))
    what = f"cup C at 70 %, {len(mesh.tets)} tetrahedra, one load step or ten"
    yield relative("Deep compression", f"{what}: plate force", stepped.force_N, once.force_N, 1e-4, "N")
    least = min(r.report["min_det_F"] for r in (once, stepped))
    yield at_least("Deep compression", f"{what}: smallest det F", 0.1, least)
    breast = phantom.generate(AnthropomorphicPhantom(volume_ml=CUPS["c"][0], voxel_mm=0.5), 1)
    whole = build(breast, LatticeMesh(edge_length_mm=5.5))
    by_tissue = spec.with_(material=Published(source="victre"), skin=SkinMembrane(youngs_modulus_kPa=200.0))
    result = compress(whole, breast, by_tissue)
    what = f"whole cup C with skin and a law a tissue at 70 %, lattice of {len(whole.tets)} tetrahedra: smallest det F"
    yield at_least("Deep compression", what, 0.1, result.report["min_det_F"])


def _against(
    group: str, what: str, ours: Compression, other: object, force_tolerance: float, node_tolerance: float
) -> Iterator[Check]:
    """other: with force_N and displacement."""
    force: float = other.force_N  # type: ignore[attr-defined]
    yield relative(group, f"{what}: plate force", force, ours.force_N, force_tolerance, "N")
    furthest = float(np.abs(other.displacement - ours.displacement).max())  # type: ignore[attr-defined]
    yield absolute(group, f"{what}: largest difference of a node", furthest, node_tolerance, "mm")
