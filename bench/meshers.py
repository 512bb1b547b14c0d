"""The two meshers on the same outline: seconds, quality, and the plate force their meshes give; one run.

    python -m bench.meshers [--edge-mm 5.5] [--percent 50] [--voxel-mm 0.5] [--convergence]

Exit code 1 where the lattice is less than 50 times as fast, has an angle of 10 degrees or less, or gives another
force. Seconds are those from the outline to tetrahedra (fTetWild with its process and files), the least of three for
the lattice; the outline itself, which both share, and the numbering and report of the mesh stage are printed apart.
``--convergence`` adds meshes from 5k to 100k tetrahedra of both (several minutes). Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any

import numba

from simcore import fem, mesh, phantom
from simcore.core.artifacts import Phantom, TetMesh
from simcore.fem.spec import CompressionSpec
from simcore.mesh.builder import LATTICE_CONSTANT_PER_EDGE
from simcore.mesh.lattice import stuffed
from simcore.mesh.spec import LatticeMesh, TetwildMesh
from simcore.mesh.surface import outline
from simcore.mesh.tetwild import tetrahedralize
from simcore.phantom.spec import AnthropomorphicPhantom
from simcore.presets import CUPS

CONVERGENCE_MM = (10.5, 8.0, 5.5, 3.9)
MIN_RATIO = 50.0
MIN_DIHEDRAL_DEG = 10.0
MAX_FORCE_DIFFERENCE = 0.01


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edge-mm", type=float, default=5.5)
    parser.add_argument("--percent", type=float, default=50.0)
    parser.add_argument("--voxel-mm", type=float, default=0.5)
    parser.add_argument("--convergence", action="store_true")
    args = parser.parse_args()
    breast = phantom.generate(AnthropomorphicPhantom(volume_ml=CUPS["c"][0], voxel_mm=args.voxel_mm), 1)
    compression = CompressionSpec(percent=args.percent)
    if args.convergence:
        print("| mesher | edge, mm | tets | smallest angle | force, N | volume change | min J | contact, mm^2 | s |")
        print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
        for edge in CONVERGENCE_MM:
            for spec in (LatticeMesh(edge_length_mm=edge), TetwildMesh(edge_length_mm=edge)):
                print(row(breast, spec, compression), flush=True)
    result = compared(breast, args.edge_mm, compression)
    lines = problems(result)
    print(json.dumps(result | {"problems": lines}))
    return 1 if lines else 0


def problems(result: dict[str, Any]) -> list[str]:
    """What the lattice does not keep of its promises."""
    lines = []
    if result["ratio"] < MIN_RATIO:
        lines.append(f"{result['ratio']} times as fast, at least {MIN_RATIO:g} wanted")
    if result["min_dihedral_deg"] <= MIN_DIHEDRAL_DEG:
        lines.append(f"an angle of {result['min_dihedral_deg']} degrees, more than {MIN_DIHEDRAL_DEG:g} wanted")
    if abs(result["force_N"] / result["peer_force_N"] - 1) > MAX_FORCE_DIFFERENCE:
        lines.append(f"{result['force_N']} N where fTetWild's mesh gives {result['peer_force_N']} N")
    return lines


def compared(breast: Phantom, edge_mm: float, compression: CompressionSpec) -> dict[str, Any]:
    seconds, outline_seconds = lattice_seconds(breast, edge_mm)
    peer_seconds = tetwild_seconds(breast, edge_mm)
    own, stage_seconds = timed_build(breast, LatticeMesh(edge_length_mm=edge_mm))
    peer, _ = timed_build(breast, TetwildMesh(edge_length_mm=edge_mm))
    return {
        "tets": len(own.tets),
        "seconds": round(seconds, 4),
        "peer_tets": len(peer.tets),
        "peer_seconds": round(peer_seconds, 2),
        "ratio": round(peer_seconds / seconds, 1),
        "outline_seconds": round(outline_seconds, 3),
        "stage_seconds": round(stage_seconds, 3),
        "min_dihedral_deg": round(own.report["dihedral_angle_deg"]["min"], 2),
        "peer_min_dihedral_deg": round(peer.report["dihedral_angle_deg"]["min"], 2),
        "force_N": round(fem.compress(own, breast, compression).force_N, 3),
        "peer_force_N": round(fem.compress(peer, breast, compression).force_N, 3),
    }


def lattice_seconds(breast: Phantom, edge_mm: float) -> tuple[float, float]:
    """(from the outline to tetrahedra, the outline), the least of three after a run that loads compiled code."""
    runs = []
    for _ in range(4):
        start = time.perf_counter()
        surface = outline(breast, edge_mm)
        middle = time.perf_counter()
        stuffed(surface.field, LATTICE_CONSTANT_PER_EDGE * edge_mm * surface.scale)
        runs.append((time.perf_counter() - middle, middle - start))
    return min(r[0] for r in runs[1:]), min(r[1] for r in runs[1:])


def tetwild_seconds(breast: Phantom, edge_mm: float) -> float:
    spec = TetwildMesh(edge_length_mm=edge_mm)
    surface = outline(breast, edge_mm)
    start = time.perf_counter()
    tetrahedralize(
        surface.points, surface.triangles, edge_length=edge_mm * surface.scale, epsilon=spec.epsilon,
        threads=numba.get_num_threads(),
    )  # fmt: skip
    return time.perf_counter() - start


def timed_build(breast: Phantom, spec: LatticeMesh | TetwildMesh) -> tuple[TetMesh, float]:
    start = time.perf_counter()
    built = mesh.build(breast, spec)
    return built, time.perf_counter() - start


def row(breast: Phantom, spec: LatticeMesh | TetwildMesh, compression: CompressionSpec) -> str:
    """A line of the convergence table."""
    built, seconds = timed_build(breast, spec)
    result = fem.compress(built, breast, compression)
    report = result.report
    return (
        f"| {spec.kind} | {spec.edge_length_mm:g} | {len(built.tets)} | "
        f"{built.report['dihedral_angle_deg']['min']:.1f} | {result.force_N:.2f} | "
        f"{100 * report['volume_change']:.3f} % | {report['min_det_F']:.3f} | {report['contact_area_mm2']:.0f} | "
        f"{seconds:.2f} |"
    )


if __name__ == "__main__":
    sys.exit(main())
