"""CalculiX on finer and finer meshes with the contact prescribed, and ours with the volumetric energy of CalculiX.

Linear tetrahedra with nodal volumes and quadratic ones differ on every mesh; what can be the same is the limit. So the
difference is followed over the element size h and extrapolated with d = d0 + c h^2. CalculiX's energy kappa/2 (J - 1)^2
instead of ours changes the force as well, by a share that does not fall with h: here both have it.

CalculiX takes half an hour for this, so its forces are kept in calculix_prescribed.json; ``--long`` makes them anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from bench.peers import calculix, scikit
from bench.support.bodies import C_CUP, ONE_TISSUE, Floats, as_quadratic
from bench.verification.check import Check, absolute, at_least, relative
from bench.verification.exact import MATERIAL
from simcore.core.artifacts import Compression, TetMesh
from simcore.fem import CompressionSpec, compress
from simcore.fem.compression import solver_of
from simcore.fem.elements.model import Model
from simcore.fem.newton.path import Target, follow
from simcore.fem.plates.contact import Contact
from simcore.mesh.structured import half_ellipsoid

SPEC = CompressionSpec(percent=50.0, material=MATERIAL, tolerance=1e-7)
CELLS = (16, 20, 24, 28)
RECORD = Path(__file__).with_name("calculix_prescribed.json")
COARSE, FINE = 0.01, 0.005
"""Allowed difference of force below and from 20 000 linear tetrahedra on."""


class SquaredVolume(Model):
    """With the volumetric energy kappa/2 (J - 1)^2."""

    def volume_ratio_of_pressure(self, pressure: Floats) -> tuple[Floats, Floats]:
        return 1 + pressure / self.node_bulk, 1 / self.node_bulk


@dataclass(frozen=True)
class Rung:
    """cells: of the linear mesh. tets: linear ones, eight for each of CalculiX'. force_N: of CalculiX."""

    cells: int
    tets: int
    force_N: float
    seconds: float


def squeeze(mesh: TetMesh) -> Compression:
    """Our compression with CalculiX's volumetric energy."""
    solver = solver_of(mesh, ONE_TISSUE, SPEC)
    squared = SquaredVolume(**{f.name: getattr(solver.model, f.name) for f in fields(solver.model)})
    contact = Contact.none(mesh.skin, len(mesh.nodes)).holding(mesh.wall)
    solution = follow(replace(solver, model=squared), contact, Target(SPEC.percent))
    plates = solution.state.plates
    assert plates is not None
    return Compression(
        displacement=solution.state.displacement,
        plate_z=(plates.lower, plates.upper),
        force_N=solution.steps[-1].force,
        outcome="converged",
        report={},
    )


def climb(cells: tuple[int, ...] = CELLS, *, threads: int = 2) -> Iterator[Rung]:
    """CalculiX with the contact of ``squeeze``. threads: of CalculiX."""
    for n in cells:
        mesh, quadratic = as_quadratic(C_CUP, n)
        run = calculix.hold(mesh.nodes, quadratic, MATERIAL, squeeze(mesh), threads=threads)
        yield Rung(n, len(mesh.tets), run.force_N, round(run.seconds, 1))


def record(rungs: list[Rung]) -> None:
    RECORD.write_text(json.dumps([vars(r) for r in rungs], indent=1) + "\n")


def recorded() -> list[Rung]:
    return [Rung(**row) for row in json.loads(RECORD.read_text())]


def ladder_checks(rungs: list[Rung]) -> Iterator[Check]:
    """Ours, computed now, against CalculiX."""
    group = "CalculiX, same energy"
    differences = []
    for rung in rungs:
        force = squeeze(half_ellipsoid(C_CUP, rung.cells)).force_N
        what = f"prescribed contact, {rung.tets} linear, {rung.tets // 8} ten-node tetrahedra: plate force"
        allowed = FINE if rung.tets >= 20_000 else COARSE
        yield relative(group, what, rung.force_N, force, allowed, "N")
        differences.append((1 / rung.cells, force / rung.force_N - 1))
    order, limit = fitted(differences)
    yield at_least(group, "order with which the difference falls", 1.5, order)
    yield absolute(group, "relative difference in the limit of small elements", limit, 1e-3)


def fitted(differences: list[tuple[float, float]]) -> tuple[float, float]:
    """(order p of |d| ~ h^p, d0 of d = d0 + c h^2) of [(h, d)]"""
    h, d = np.array(differences).T
    return float(np.polyfit(np.log(h), np.log(np.abs(d)), 1)[0]), float(np.polyfit(h**2, d, 1)[1])


def energy_checks(cells: int = 10) -> Iterator[Check]:
    """What the other volumetric energy does to the force, by our solver and by scikit-fem."""
    mesh = half_ellipsoid(C_CUP, cells)
    other = squeeze(mesh)
    peer = scikit.hold(mesh, MATERIAL, other, squared=True)
    group, what = "CalculiX, same energy", f"{len(mesh.tets)} tetrahedra"
    yield relative(group, f"{what}: plate force, scikit-fem with that energy", peer.force_N, other.force_N, 1e-4, "N")
    change = other.force_N / compress(mesh, ONE_TISSUE, SPEC).force_N - 1
    yield absolute(group, f"{what}: relative change of the force by that energy", change, 2e-3)
