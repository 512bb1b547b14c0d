"""Many compressions drawn at random; every one must converge and be right, or fail with a name.

    python -m bench.sweep [--runs 200] [--seed 0]

Cups, outlines, 20 to 70 %, nu 0 to 0.499, every material of the specification, skin, gravity, friction, a fixed wall,
tilted and spring paddles, plates that bend; meshes of about 2k to 10k tetrahedra: structured, lattice and fTetWild
from labels. What converged is looked at afresh, without the solver: plates in balance and not absurd, nothing behind
a plate, a chest wall that neither drifts nor rolls, no element turned over, volume change within what the material
allows, and for every fourth run the same answer in load steps of a quarter. Exit code 1 where one is silently wrong or
1 % fail. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from bench.support.bodies import C_CUP, Floats, SemiAxes, ellipsoid_labels, scaled_to
from simcore import warp
from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.errors import SimulationError
from simcore.core.tissues import Tissue
from simcore.fem import CompressionSpec, compress
from simcore.fem.laws import MaterialSpec
from simcore.fem.spec import ElasticPlates, Gravity, SkinMembrane, SpringPaddle
from simcore.mesh import build
from simcore.mesh.spec import LatticeMesh, TetwildMesh
from simcore.mesh.structured import half_ellipsoid
from simcore.presets import CUPS

OUTLINES: dict[str, SemiAxes] = {
    "round": C_CUP,
    "shallow": (60.0, 75.0, 65.0, 60.0),
    "long": (130.0, 55.0, 55.0, 50.0),
    "narrow": (80.0, 40.0, 70.0, 60.0),
    "lopsided": (90.0, 60.0, 85.0, 40.0),
}
RATIOS = (0.0, 0.2, 0.3, 0.4, 0.45, 0.475, 0.475, 0.479)
"""Poisson's ratios to begin with: up to 0.02 is added, so that incompressible tissue is drawn most often."""
MESHERS = ("structured", "lattice", "tetwild")
MESHES_EACH = 5
RECHECKED = 4
"""One run in so many is done again in finer load steps."""
VOXEL_MM = 1.5
MAX_IMBALANCE = 2e-3
MAX_PENETRATION_MM = 1e-5
MAX_DRIFT_MM = 0.02
"""Of any node of a chest wall that may neither drift nor roll."""
MAX_PRESSURE_KPA = 2000.0
"""Of the plates. The stiffest laws drawn give some hundreds at 70 %; more is an element crushed beyond its law."""
MAX_STEPPING = 3e-3
"""Relative difference of the force, and of nodes relative to the thickness, between coarse and fine load steps."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A mesh, the labels it is from, and what it is."""

    name: str
    mesh: TetMesh
    phantom: Phantom


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    start = time.perf_counter()
    generator = np.random.default_rng(args.seed)
    subjects = [subject(kind, generator) for kind in MESHERS for _ in range(MESHES_EACH)]
    named: list[dict[str, str]] = []
    buckled: list[str] = []
    silent: list[str] = []
    crashes = 0
    materials: Counter[str] = Counter()
    options: Counter[str] = Counter()
    ratios: list[float] = []
    for run in range(args.runs):
        chosen, spec = subjects[run % len(subjects)], draw(generator)
        what = f"{chosen.name}, {spec.material.kind}, {spec.model_dump_json(exclude_defaults=True)}"
        materials[spec.material.kind] += 1
        options.update(spec.model_fields_set - {"percent", "material"})
        ratios.append(getattr(spec.material, "poissons_ratio", float("nan")))
        try:
            result = compress(chosen.mesh, chosen.phantom, spec)
            problems = faults(chosen.mesh, spec, result) + missing(chosen, result)
            if run % RECHECKED == 0:
                problems += disagreement(chosen, spec, result)
        except SimulationError as failure:
            if failure.code == "unstable-equilibrium" and stands_where_wider(chosen, spec):
                buckled.append(what)
                print(f"{run}: buckles: {what}: {failure}", file=sys.stderr, flush=True)
                continue
            named.append({"code": failure.code, "run": what})
            print(f"{run}: {failure.code}: {what}: {failure}", file=sys.stderr, flush=True)
            continue
        except Exception as crash:
            crashes += 1
            silent.append(f"{type(crash).__name__} without a name of ours, {crash}: {what}")
            print(f"{run}: {silent[-1]}", file=sys.stderr, flush=True)
            continue
        silent += [f"{problem}: {what}" for problem in problems]
        print(f"{run}: {result.force_N:.1f} N {problems or ''}", file=sys.stderr, flush=True)
    for problem in silent:
        print(f"silent: {problem}", file=sys.stderr)
    print(
        json.dumps(
            {
                "runs": args.runs,
                "converged": args.runs - len(named) - len(buckled) - crashes,
                "buckled": buckled,
                "named_failures": len(named),
                "silent": len(silent),
                "seconds": round(time.perf_counter() - start, 1),
                "failures": named,
                "materials": dict(materials),
                "options": dict(options),
                "poissons_ratio": [float(np.nanmin(ratios)), float(np.nanmax(ratios))],
                "tets": [len(s.mesh.tets) for s in subjects],
            }
        )
    )
    return 1 if silent or len(named) >= 0.01 * args.runs else 0


def subject(kind: str, generator: np.random.Generator) -> Subject:
    """A breast of random size and outline, meshed by ``kind``, with a core of gland."""
    cup, outline = generator.choice(list(CUPS)), generator.choice(list(OUTLINES))
    axes = scaled_to(OUTLINES[outline], CUPS[cup][0])
    phantom = with_gland(ellipsoid_labels(axes, VOXEL_MM), axes)
    if kind == "structured":
        cells = int(generator.integers(8, 14))
        return Subject(f"{kind} {cells}, cup {cup}, {outline}", half_ellipsoid(axes, cells), phantom)
    edge = round(float(generator.uniform(8.5, 13.0)), 1)
    spec = LatticeMesh(edge_length_mm=edge) if kind == "lattice" else TetwildMesh(edge_length_mm=edge, epsilon=2e-3)
    return Subject(f"{kind} {edge} mm, cup {cup}, {outline}", build(phantom, spec), phantom)


def with_gland(phantom: Phantom, semi_axes: SemiAxes) -> Phantom:
    """The inner 0.7 of the ellipsoid as gland."""
    core = ellipsoid_labels(tuple(0.7 * s for s in semi_axes), VOXEL_MM)  # type: ignore[arg-type]
    labels = phantom.labels.copy()
    offset = [round((c - p) / VOXEL_MM) for c, p in zip(core.grid.corner, phantom.grid.corner, strict=True)]
    x, y, z = offset
    nz, ny, nx = core.labels.shape
    region = labels[z : z + nz, y : y + ny, x : x + nx]
    region[core.labels[: region.shape[0], : region.shape[1], : region.shape[2]] > 0] = Tissue.GLAND
    return Phantom(labels, phantom.grid)


def draw(generator: np.random.Generator) -> CompressionSpec:
    """A specification at random: a material of the union, a compression, and now and then an option."""
    classes = get_args(get_args(MaterialSpec)[0])
    material = classes[generator.integers(len(classes))].example()
    if "poissons_ratio" in type(material).model_fields:
        material = material.with_(poissons_ratio=round(float(generator.choice(RATIOS) + generator.uniform(0, 0.02)), 4))
    percent = round(float(generator.uniform(20, 70)), 1)
    options: dict[str, Any] = {
        "skin": SkinMembrane(youngs_modulus_kPa=500.0),
        "gravity": Gravity(),
        "friction": 0.3,
        "chest_wall": "fixed",
        "paddle_angle_degrees": 3.0,
        "spring_paddle": SpringPaddle(stiffness_Nmm_per_degree=5000.0),
        "elastic_plates": ElasticPlates(thickness_mm=3.0),
        "load_steps": 3,
    }
    chosen = [name for name in options if generator.random() < 0.06]
    of_plates = [name for name in ("paddle_angle_degrees", "spring_paddle", "elastic_plates") if name in chosen]
    chosen = [name for name in chosen if name not in of_plates[1:]]
    return CompressionSpec(percent=percent, material=material, **{name: options[name] for name in chosen})


def faults(mesh: TetMesh, spec: CompressionSpec, result: Compression) -> list[str]:
    """What is wrong with a result that claims to have converged."""
    problems = []
    report = result.report
    lower, upper = report["force_lower_N"], report["force_upper_N"]
    weight = (
        np.linalg.norm(spec.gravity.weight()) * six_volumes(mesh.nodes, mesh.tets).sum() / 6 if spec.gravity else 0.0
    )
    held_by_wall = spec.chest_wall != "free_in_plane"
    if not held_by_wall and abs(upper - lower) > MAX_IMBALANCE * max(upper, lower) + weight:
        problems.append(f"plates push with {lower:.3f} and {upper:.3f} N")
    if report["mean_pressure_kPa"] > MAX_PRESSURE_KPA:
        problems.append(f"plates push with {lower:.4g} and {upper:.4g} N, {report['mean_pressure_kPa']:.4g} kPa")
    after = mesh.nodes + result.displacement
    if not np.isfinite(after).all() or result.force_N <= 0:
        return [*problems, f"force {result.force_N}, displacement finite: {np.isfinite(after).all()}"]
    skin = after[np.unique(mesh.skin)]
    low, high = result.plate_z
    flat = not (spec.paddle_angle_degrees or spec.spring_paddle or spec.elastic_plates)
    if flat:
        if held_by_wall:  # where the plates have no edge
            on_skin = np.unique(mesh.skin)
            skin = after[on_skin[mesh.nodes[on_skin, 0] >= spec.plate_edge_mm]]
        depth = max(float(skin[:, 2].max()) - high, low - float(skin[:, 2].min()))
        if depth > MAX_PENETRATION_MM:
            problems.append(f"a node is {depth:.2e} mm behind a plate")
    if (drift := wall_drift(mesh, result)) > MAX_DRIFT_MM:
        problems.append(f"the chest wall drifts and rolls by {drift:.3g} mm")
    before, now = six_volumes(mesh.nodes, mesh.tets), six_volumes(after, mesh.tets)
    if not (now / before).min() > 0:
        problems.append(f"an element has det F {(now / before).min():.3g}")
    change = float(now.sum() / before.sum() - 1)
    most = largest_loss(spec, result)
    if not -most < change < 1e-2:
        problems.append(f"volume changed by {change:.4f}, at most {most:.4f} expected")
    return problems


def missing(chosen: Subject, result: Compression) -> list[str]:
    """What the compressed phantom has lost of its tissue."""
    try:
        warp.deform(chosen.phantom, chosen.mesh, result, warp.WarpSpec())
    except SimulationError as failure:
        return [f"{failure.code}: {failure}"]
    return []


def wall_drift(mesh: TetMesh, result: Compression) -> float:
    """Largest movement along y of the chest wall as a rigid body that shifts and turns about x, mm."""
    y, z = result.displacement[mesh.wall, 1], mesh.nodes[mesh.wall, 2]
    slope, shift = np.polyfit(z - z.mean(), y, 1)
    return float(np.abs(shift + slope * (z - z.mean())).max())


def largest_loss(spec: CompressionSpec, result: Compression) -> float:
    """Share of volume that is lost where the mean pressure of the plates acts from all sides, in the softest law."""
    material = spec.material
    laws = material.laws().values() if hasattr(material, "laws") else [material.law()]
    t = result.report["mean_pressure_kPa"] / min(law.bulk for law in laws)
    around = 2.0 if spec.skin else 1.0
    return float(1 + around * t - np.sqrt(1 + (around * t) ** 2)) + 1e-3


def disagreement(chosen: Subject, spec: CompressionSpec, result: Compression) -> list[str]:
    """The same in load steps of a quarter: an equilibrium does not depend on them (with friction it may)."""
    if spec.friction:
        return []
    finer = compress(chosen.mesh, chosen.phantom, spec.with_(load_steps=4 * spec.load_steps))
    force = abs(finer.force_N / result.force_N - 1)
    nodes = float(np.abs(finer.displacement - result.displacement).max()) / result.thickness
    if max(force, nodes) > MAX_STEPPING:
        return [f"finer load steps change the force by {force:.2e} and a node by {nodes:.2e} of the thickness"]
    return []


def stands_where_wider(chosen: Subject, spec: CompressionSpec) -> bool:
    """Whether a breast that is taller than wide, and is refused because it would roll aside, keeps still where it is as
    wide as it is tall: then being slender is what made it unstable, and refusing it was right."""
    mesh, phantom = chosen.mesh, chosen.phantom
    factor = float(np.ptp(mesh.nodes[:, 2]) / np.ptp(mesh.nodes[:, 1]))
    if factor <= 1:
        return False
    wider = mesh.nodes * [1.0, factor, 1.0]
    (dx, dy, dz), (x, y, z) = phantom.grid.spacing, phantom.grid.corner
    grid = replace(phantom.grid, spacing=(dx, factor * dy, dz), corner=(x, factor * y, z))
    stretched = replace(mesh, nodes=wider)
    try:
        return not faults(stretched, spec, compress(stretched, Phantom(phantom.labels, grid), spec))
    except SimulationError:
        return False


def six_volumes(nodes: Floats, tets: NDArray[np.int64]) -> Floats:
    corners = nodes[tets]
    volumes: Floats = np.linalg.det(corners[:, 1:] - corners[:, :1])
    return volumes


if __name__ == "__main__":
    sys.exit(main())
