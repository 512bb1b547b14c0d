"""CalculiX on our meshes: large deformation, neo-Hookean law, its own contact or prescribed contact.

Units mm, N, N/mm^2. CalculiX: U = C10 (I1 - 3) + (J - 1)^2 / D1, ours has ((J^2 - 1)/2 - ln J) instead of (J - 1)^2,
which is the same up to third order; C10 = mu / 2, D1 = 2 / kappa.
Debian package calculix-ccx (2.20). Source of the input: Dhondt, CalculiX CrunchiX User's Manual 2.20.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.support.bodies import Floats
from simcore.core.artifacts import Compression
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.mesh.quality import boundary_faces

CONTACT_STIFFNESS = 5.0
"""Pressure for 1 mm of penetration, N/mm^2: a plate pressure of 30 kPa pushes the skin 6 um into the plate."""
ON_PLATE_MM = 1e-5
_FACES = ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3))
_PLATE_HALF_WIDTH = 500.0
_PLATE_THICKNESS = 20.0


@dataclass(frozen=True, eq=False)
class CalculixRun:
    """force_lower_N, force_upper_N: on the plates, positive when pushed away. displacement: (n, 3) of the mesh nodes.
    increments: load increments. seconds: wall time of the program."""

    force_lower_N: float
    force_upper_N: float
    displacement: Floats
    increments: int
    seconds: float

    @property
    def force_N(self) -> float:
        return 0.5 * (self.force_lower_N + self.force_upper_N)


def available() -> bool:
    return shutil.which("ccx") is not None


def compress(
    nodes: Floats, tets: NDArray[np.int64], material: NeoHookean, percent: float, *, threads: int = 2
) -> CalculixRun:
    """Contact of CalculiX (face to face, linear pressure-overclosure) between the skin and two plates that move.

    nodes: (n, 3), mm, symmetric about y = 0: two wall nodes there are held along y, where ours has a guard against
    rolling. tets: (m, 4) for C3D4, (m, 10) for C3D10.
    """
    travel = 0.5 * float(np.ptp(nodes[:, 2])) * percent / 100
    motion = [f"N{name},1,2\nN{name},3,3,{way:.12g}" for name, way in (("LOWER", travel), ("UPPER", -travel))]
    lines = [*_body_lines(nodes, tets, material), *_plate_lines(nodes, tets), *_supports(nodes), *_step(motion)]
    return _run(lines, len(nodes), threads)


def hold(
    nodes: Floats, tets: NDArray[np.int64], material: NeoHookean, ours: Compression, *, threads: int = 2
) -> CalculixRun:
    """Contact prescribed: the nodes that lie on a plate in ``ours`` get its z displacement, no contact search."""
    z = nodes[:, 2] + ours.displacement[:, 2]
    lines, motion = _body_lines(nodes, tets, material), []
    for name, plate in (("LOWER", ours.plate_z[0]), ("UPPER", ours.plate_z[1])):
        touching = np.flatnonzero(np.abs(z - plate) < ON_PLATE_MM)
        lines += [f"*NSET,NSET=N{name}", *(str(i + 1) for i in touching)]
        motion += [f"{i + 1},3,3,{ours.displacement[i, 2]:.12g}" for i in touching]
    return _run([*lines, *_supports(nodes), *_step(motion)], len(nodes), threads)


def _body_lines(nodes: Floats, tets: NDArray[np.int64], material: NeoHookean) -> list[str]:
    law = material.law()
    return [
        "*NODE,NSET=BODY",
        *_node_lines(nodes, 1),
        f"*ELEMENT,TYPE=C3D{tets.shape[1]},ELSET=BREAST",
        *(f"{e + 1}," + ",".join(map(str, tet)) for e, tet in enumerate((tets + 1).tolist())),
        "*MATERIAL,NAME=TISSUE",
        "*HYPERELASTIC,NEO HOOKE",
        f"{law.shear * 1e-3 / 2:.12g},{2 / (law.bulk * 1e-3):.12g}",
        "*SOLID SECTION,ELSET=BREAST,MATERIAL=TISSUE",
    ]


def _supports(nodes: Floats) -> list[str]:
    """The wall held along x; its lowest and highest node in the middle plane along y."""
    wall = np.flatnonzero(nodes[:, 0] == 0.0)
    middle = wall[np.abs(nodes[wall, 1]) < 1e-9]
    ends = middle[np.argsort(nodes[middle, 2])][[0, -1]]
    return ["*BOUNDARY", *(f"{i + 1},1,1" for i in wall), *(f"{i + 1},2,2" for i in ends)]


def _node_lines(nodes: Floats, first: int) -> list[str]:
    return [f"{first + i},{x:.12g},{y:.12g},{z:.12g}" for i, (x, y, z) in enumerate(nodes)]


def _facing_plates(nodes: Floats, tets: NDArray[np.int64]) -> dict[str, list[str]]:
    """Element faces of the skin, "element,Sface", by the plate that they look at."""
    boundary = {tuple(sorted(face)) for face in boundary_faces(tets[:, :4]).tolist()}
    facing: dict[str, list[str]] = {"LOWER": [], "UPPER": []}
    for e, tet in enumerate(tets.tolist()):
        for s, corners in enumerate(_FACES):
            face = sorted(tet[c] for c in corners)
            if tuple(face) in boundary and nodes[face, 0].max() > 0.0:
                facing["UPPER" if nodes[face, 2].mean() > 0 else "LOWER"].append(f"{e + 1},S{s + 1}")
    return facing


def _plate_lines(nodes: Floats, tets: NDArray[np.int64]) -> list[str]:
    """Two bricks whose nodes are all prescribed, and the contact of the skin with them."""
    facing = _facing_plates(nodes, tets)
    lines = ["*MATERIAL,NAME=PLATE", "*ELASTIC", "3000.,0.3", "*SURFACE INTERACTION,NAME=SMOOTH"]
    lines += ["*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR", f"{CONTACT_STIFFNESS:g}"]
    low, high = nodes[:, 2].min() - _PLATE_THICKNESS, nodes[:, 2].max()
    w = _PLATE_HALF_WIDTH
    for k, (name, bottom, brick_face) in enumerate((("LOWER", low, 2), ("UPPER", high, 1))):
        first = len(nodes) + 1 + 8 * k
        heights = (bottom, bottom + _PLATE_THICKNESS)
        bricks = np.array([(x, y, z) for z in heights for x, y in ((-w, -w), (w, -w), (w, w), (-w, w))])
        lines += [
            f"*NODE,NSET=N{name}",
            *_node_lines(bricks, first),
            f"*ELEMENT,TYPE=C3D8,ELSET=E{name}",
            f"{len(tets) + 1 + k}," + ",".join(str(first + i) for i in range(8)),
            f"*SOLID SECTION,ELSET=E{name},MATERIAL=PLATE",
            f"*SURFACE,NAME=PLATE{name},TYPE=ELEMENT",
            f"E{name},S{brick_face}",
            f"*SURFACE,NAME=SKIN{name},TYPE=ELEMENT",
            *facing[name],
            "*CONTACT PAIR,INTERACTION=SMOOTH,TYPE=SURFACE TO SURFACE",
            f"SKIN{name},PLATE{name}",
        ]
    return lines


def _step(motion: Iterable[str]) -> list[str]:
    """One static step; CalculiX chooses its increments between 2.5 and 10 % of the way."""
    output = [f"*NODE PRINT,NSET=N{name},TOTALS=ONLY,FREQUENCY=100000\nRF" for name in ("LOWER", "UPPER")]
    output += ["*NODE PRINT,NSET=BODY,FREQUENCY=100000\nU"]
    return ["*STEP,NLGEOM,INC=2000", "*STATIC", "0.05,1.,1e-7,0.1", "*BOUNDARY", *motion, *output, "*END STEP"]


def _run(lines: Iterable[str], node_count: int, threads: int) -> CalculixRun:
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case"
        case.with_suffix(".inp").write_text("\n".join(lines) + "\n")
        start = time.perf_counter()
        done = subprocess.run(
            ["ccx", "-i", "case"],
            cwd=folder,
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": str(threads)},
        )
        seconds = time.perf_counter() - start
        data = case.with_suffix(".dat").read_text().splitlines() if case.with_suffix(".dat").exists() else []
        totals = [float(data[k + 2].split()[2]) for k, line in enumerate(data) if "total force" in line]
        if len(totals) != 2:
            raise RuntimeError(f"CalculiX did not reach the end:\n{done.stdout[-2000:]}")
        increments = len(case.with_suffix(".sta").read_text().splitlines()) - 2
    start_of_table = next(k for k, line in enumerate(data) if "displacements" in line) + 2
    rows = np.array([line.split() for line in data[start_of_table : start_of_table + node_count]], dtype=np.float64)
    return CalculixRun(totals[0], -totals[1], rows[:, 1:4], increments, seconds)
