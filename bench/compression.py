"""Our compression against CalculiX and scikit-fem in one run: the same nodes, material and plates, 50 %.

    python -m bench.compression [--tets 6000] [--runs 3] [--all-calculix | --alone]

A half-ellipsoid cup C, neo-Hookean, nu = 0.475. CalculiX gets the nodes of our mesh, grouped into quadratic
tetrahedra (C3D10): its linear ones (C3D4) lock at this Poisson's ratio and are run as well with --all-calculix. Its
contact is face to face with a linear pressure-overclosure; its load increments are its own choice of 2.5 to 10 %.
scikit-fem (the contact of ours prescribed, our weak form, direct solution) runs up to 10 000 tetrahedra. Two threads
for everybody; ours is timed warm. Exit code 1 where a force differs by more than allowed. Last line: JSON.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from typing import Any

import numba

from bench.peers import calculix, scikit
from bench.support.bodies import C_CUP, ONE_TISSUE, as_quadratic
from bench.support.timing import Stolen
from simcore.core.artifacts import Compression, TetMesh
from simcore.fem import CompressionSpec, compress
from simcore.fem.laws.neo_hookean import NeoHookean

MATERIAL = NeoHookean(youngs_modulus_kPa=60.6, poissons_ratio=0.475)
SPEC = CompressionSpec(percent=50.0, material=MATERIAL)
MAX_SCIKIT_TETS = 10_000
SAME_FORMULATION = 1e-3
OTHER_ELEMENTS = {0: 1e-2, 20_000: 5e-3}
"""Allowed difference of force from CalculiX from that many tetrahedra on: both meshes err, coarse ones more."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tets", type=int, default=6000)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--all-calculix", action="store_true", help="also linear elements, and prescribed contact")
    parser.add_argument("--alone", action="store_true", help="no peer: for sizes at which theirs take hours")
    args = parser.parse_args()
    numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
    cells = 2 * max(round((args.tets / 4) ** (1 / 3) / 2), 2)
    mesh, quadratic = as_quadratic(C_CUP, cells)
    with Stolen() as taken:
        ours, seconds = timed(mesh, args.runs)
    say(f"ours: {len(mesh.tets)} tetrahedra, {ours.force_N:.3f} N in {seconds:.3f} s")
    result: dict[str, Any] = {
        "tets": len(mesh.tets),
        "nodes": len(mesh.nodes),
        "seconds": round(seconds, 4),
        "stolen": taken.share,
        "force_N": round(ours.force_N, 4),
    }
    if args.alone:
        print(json.dumps(result))
        return 0
    problems = []
    if len(mesh.tets) <= MAX_SCIKIT_TETS:
        other = scikit.hold(mesh, MATERIAL, ours)
        result |= compared("scikit_fem", ours, seconds, other.force_N, other.seconds)
        if abs(result["scikit_fem_difference"]) > SAME_FORMULATION:
            problems.append("scikit-fem")
    if calculix.available():
        peer = calculix.compress(mesh.nodes, quadratic, MATERIAL, SPEC.percent)
        result |= compared("peer", ours, seconds, peer.force_N, peer.seconds) | {"peer": "CalculiX C3D10, own contact"}
        allowed = OTHER_ELEMENTS[max(n for n in OTHER_ELEMENTS if n <= len(mesh.tets))]
        if abs(result["peer_difference"]) > allowed:
            problems.append("CalculiX")
        if args.all_calculix:
            prescribed = calculix.hold(mesh.nodes, quadratic, MATERIAL, ours)
            result |= compared("peer_prescribed", ours, seconds, prescribed.force_N, prescribed.seconds)
            linear = calculix.compress(mesh.nodes, mesh.tets, MATERIAL, SPEC.percent)
            result |= compared("peer_linear", ours, seconds, linear.force_N, linear.seconds)
    else:
        say("CalculiX (Debian package calculix-ccx) is not installed: the peer is scikit-fem with prescribed contact")
        result |= {f"peer_{key}": result.get(f"scikit_fem_{key}") for key in ("seconds", "force_N", "difference")}
        result |= {"ratio": result.get("scikit_fem_ratio"), "peer": "scikit-fem, prescribed contact"}
    print(json.dumps(result | {"problems": problems}))
    return 1 if problems else 0


def timed(mesh: TetMesh, runs: int) -> tuple[Compression, float]:
    """(result, median seconds of ``runs`` after one that warms up)"""
    compress(mesh, ONE_TISSUE, SPEC)
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = compress(mesh, ONE_TISSUE, SPEC)
        times.append(time.perf_counter() - start)
    return result, statistics.median(times)


def compared(name: str, ours: Compression, seconds: float, force: float, peer_seconds: float) -> dict[str, Any]:
    """Fields of the last line; ratio: how many times longer the peer takes, difference: ours over theirs - 1."""
    ratio = "ratio" if name == "peer" else f"{name}_ratio"
    difference = ours.force_N / force - 1
    say(f"{name}: {force:.3f} N in {peer_seconds:.1f} s, ours differs by {difference:+.1e}")
    return {
        f"{name}_seconds": round(peer_seconds, 3),
        f"{name}_force_N": round(force, 4),
        f"{name}_difference": float(f"{difference:.2e}"),
        ratio: round(peer_seconds / seconds, 1),
    }


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
