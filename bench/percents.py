"""The force of one body in steps of one percent: neighbours must agree, and the chest wall may not move.

    python -m bench.percents [--bodies victre-p_1,...] [--edges 4,5.5,8] [--from 20] [--to 60] [--step 1]

Bodies: VICTRE's sample phantom, those of tests/fieldcases/uploads/odd_bodies.py, and the outlines of bench.sweep, each
meshed by the lattice. Every percent is a compression of its own from rest. A converged force is compared with the
parabola through the logarithms of its four neighbours: more than 1 % beside it is a jump; a chest wall that drifts or
rolls by more than 0.02 mm is a fault, and so is a volume outside what the material allows. A named failure is counted,
not silent. Exit code 1 where anything is silently wrong. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import runpy
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import chdir
from functools import partial
from pathlib import Path

import numpy as np

from bench.support.bodies import Floats, ellipsoid_labels, scaled_to
from bench.sweep import OUTLINES, VOXEL_MM, faults, with_gland
from simcore import phantom as phantoms
from simcore.core.artifacts import Phantom
from simcore.core.errors import SimulationError
from simcore.fem import CompressionSpec, compress
from simcore.mesh import build
from simcore.mesh.spec import LatticeMesh
from simcore.phantom.upload import registry
from simcore.presets import CUPS
from simcore.store.store import Store

CASES = Path(__file__).parents[1] / "tests" / "fieldcases"
ODD = ("spicule", "tunnel", "hole_through", "two_touching", "thin_breast", "muscle", "nipple_off", "aniso_04_04_2")
EDGES_MM = (4.0, 5.5, 7.0, 8.0)
MAX_JUMP = 0.01
"""Of a force beside the parabola through its neighbours."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", default="", help="names, comma separated; all where not given")
    parser.add_argument("--edges", default=",".join(f"{e:g}" for e in EDGES_MM), help="mean edges of the lattice, mm")
    parser.add_argument("--from", dest="first", type=float, default=20.0)
    parser.add_argument("--to", dest="last", type=float, default=60.0)
    parser.add_argument("--step", type=float, default=1.0)
    args = parser.parse_args()
    start = time.perf_counter()
    known = bodies()
    names = args.bodies.split(",") if args.bodies else list(known)
    percents = np.arange(args.first, args.last + 1e-9, args.step)
    silent: list[str] = []
    named: Counter[str] = Counter()
    converged = 0
    largest = 0.0
    for name in names:
        body = known[name]()
        for edge in (float(text) for text in args.edges.split(",")):
            curve, problems, failures = force_curve(body, edge, percents)
            jumps = beside_neighbours(curve)
            problems += [
                f"{p:g} %: the force jumps by {j:.4f}" for p, j in zip(percents, jumps, strict=True) if j > MAX_JUMP
            ]
            silent += [f"{name}, {edge:g} mm, {problem}" for problem in problems]
            named.update(failures)
            converged += int(np.isfinite(curve).sum())
            jump = float(np.nanmax(jumps, initial=0.0))
            largest = max(largest, jump)
            row = " ".join(f"{force:.4g}" for force in curve[::5])
            print(
                f"{name}, {edge:g} mm: largest jump {jump:.5f}, {dict(failures)}, N: {row}", file=sys.stderr, flush=True
            )
            for problem in problems:
                print(f"  silent: {problem}", file=sys.stderr, flush=True)
    seconds = round(time.perf_counter() - start, 1)
    facts = {"converged": converged, "named_failures": dict(named), "silent": silent, "largest_jump": largest}
    print(json.dumps({**facts, "seconds": seconds}))
    return 1 if silent else 0


def bodies() -> dict[str, Callable[[], Phantom]]:
    """Every body, by name."""
    known: dict[str, Callable[[], Phantom]] = {"victre-p_1": partial(uploaded, CASES / "victre" / "p_1.mhd")}
    for name in ODD:
        known[f"odd-{name}"] = partial(odd_body, name)
    for name in OUTLINES:
        known[f"outline-{name}"] = partial(outline, name)
    return known


def uploaded(path: Path) -> Phantom:
    """The file as ``tomosim phantom add`` and a case read it."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder), min_free_bytes=0)
        spec = registry.add_file(store, path).spec
        with registry.open_file(store, spec) as file:
            return phantoms.load(spec, file)


def odd_body(name: str) -> Phantom:
    """A file that tests/fieldcases/uploads/odd_bodies.py writes."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        Path("files/r19").mkdir(parents=True)
        sys.path.insert(0, str(CASES / "uploads"))
        try:
            runpy.run_path(str(CASES / "uploads" / "odd_bodies.py"))
        finally:
            sys.path.pop(0)
        return uploaded(Path("files/r19", f"{name}.nrrd"))


def outline(name: str) -> Phantom:
    axes = scaled_to(OUTLINES[name], CUPS["c"][0])
    return with_gland(ellipsoid_labels(axes, VOXEL_MM), axes)


def force_curve(phantom: Phantom, edge: float, percents: Floats) -> tuple[Floats, list[str], Counter[str]]:
    """(force at every percent, N, nan where there is none; what is silently wrong; named failures)."""
    curve = np.full(len(percents), np.nan)
    problems: list[str] = []
    failures: Counter[str] = Counter()
    try:
        mesh = build(phantom, LatticeMesh(edge_length_mm=edge))
    except SimulationError as failure:
        return curve, problems, Counter({failure.code: len(percents)})
    for index, percent in enumerate(percents):
        spec = CompressionSpec(percent=float(percent))
        try:
            result = compress(mesh, phantom, spec)
        except SimulationError as failure:
            failures[failure.code] += 1
            continue
        problems += [f"{percent:g} %: {problem}" for problem in faults(mesh, spec, result)]
        curve[index] = result.force_N if result.force_N is not None else np.nan
    return curve, problems, failures


def beside_neighbours(curve: Floats) -> Floats:
    """How far each force is from the parabola through the logarithms of the two before and the two after it, as a share
    of it; nan where one of the five is missing."""
    away = np.full(len(curve), np.nan)
    logarithm = np.log(curve)
    # Lagrange's weights of a parabola fitted to -2, -1, 1, 2, at 0.
    fitted = (-logarithm[:-4] + 4 * logarithm[1:-3] + 4 * logarithm[3:-1] - logarithm[4:]) / 6
    away[2:-2] = np.abs(np.expm1(logarithm[2:-2] - fitted))
    return away


if __name__ == "__main__":
    sys.exit(main())
