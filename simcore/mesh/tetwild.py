"""fTetWild (pytetwild) as a child process: everything that is awkward about it stays in this file.

It holds the interpreter lock for seconds, hangs in forked children, writes a file into the current folder, and from
0.4 imports pyvista, which it does not need. So ``tetrahedralize`` starts ``python -m simcore.mesh.tetwild`` in a
temporary folder and passes arrays as .npz files.

Source: Hu, Schneider, Wang, Zorin, Panozzo, Fast tetrahedral meshing in the wild, ACM Trans. Graph. 39 (2020).
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import types
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simcore import children
from simcore.core.errors import MeshError, MeshMemoryError
from simcore.core.progress import Progress, silent

if TYPE_CHECKING:  # the child has no use for compiled code
    from simcore.mesh.sizing import SizingField

_POLL_S = 0.2
_PR_SET_PDEATHSIG = 1


def tetrahedralize(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    edge_length: float,
    epsilon: float,
    sizing: SizingField | None = None,
    threads: int = 1,
    time_limit_s: float = 1800.0,
    progress: Progress = silent,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Tetrahedra inside a closed surface.

    points: float64 (n, 3), mm; triangles: int32 (f, 3).
    edge_length: wanted, mm; epsilon: largest distance from the surface over the diagonal of the bounding box.
    sizing: wanted edge lengths that differ from place to place; ``edge_length`` where it does not reach.
    time_limit_s: after which the child is killed.
    returns: nodes float64 (n', 3), tets int64 (m, 4), of any orientation. Not bit-reproducible.
    raises: MeshError with what is left to do and the last lines the mesher wrote; whatever ``progress`` raises (the
        child is killed).
    """
    with tempfile.TemporaryDirectory(prefix="tetwild-") as name:
        folder = Path(name)
        np.savez(
            folder / "surface.npz",
            points=points, triangles=triangles, edge_length=edge_length, epsilon=epsilon, threads=threads,
            **_background(sizing),
        )  # fmt: skip
        with (folder / "log").open("wb") as log:
            child = subprocess.Popen(
                children.command("simcore.mesh.tetwild", str(os.getpid())),
                cwd=folder, env=children.environment(), stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )  # fmt: skip
            code = _wait(child, time_limit_s, progress)
        if code != 0:
            raise _failure(code, (folder / "log").read_text(errors="replace"), time_limit_s)
        with np.load(folder / "tets.npz") as result:
            return result["nodes"], result["tets"]


def _background(sizing: SizingField | None) -> dict[str, Any]:
    """By the names of the mesher's arguments."""
    if sizing is None:
        return {}
    return {"bg_vertices": sizing.points, "bg_tets": sizing.tets, "bg_values": sizing.lengths}


def _wait(child: subprocess.Popen[bytes], time_limit_s: float, progress: Progress) -> int | None:
    """Exit status, None after ``time_limit_s``; the child never outlives this call."""
    try:
        for k in range(int(time_limit_s / _POLL_S) + 1):
            try:
                return child.wait(_POLL_S)
            except subprocess.TimeoutExpired:
                progress(1 - 0.98**k, "tetrahedralizing")
        return None
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()


def _failure(code: int | None, log: str, time_limit_s: float) -> MeshError:
    last = log.strip().splitlines()[-8:]
    said = " Its last lines: " + " | ".join(last) if last else ""
    # What C++ cannot allocate (a stack of a thread as well) ends in abort() or, where the binding caught it, in Python.
    aborted = code == -signal.SIGABRT and any(words in log for words in ("std::bad_alloc", "pthread_create has failed"))
    if aborted or (code and any("MemoryError" in line for line in last)):
        return MeshMemoryError(
            f"the mesher needed more memory than it may use; take a larger edge_length_mm or mesh.kind = "
            f"'lattice'.{said}"
        )
    if code is None:
        return MeshError(
            f"fTetWild did not finish within mesh.time_limit_s = {time_limit_s:g} s; take a larger edge_length_mm, "
            f"mesh.kind = 'lattice', which takes seconds, or a longer time_limit_s.{said}",
            code="mesh-time-limit",
        )
    if code < 0:
        what = f"was ended by {signal.Signals(-code).name}"
    else:
        what = f"failed with exit status {code}"
    return MeshError(
        f"fTetWild {what}; take mesh.kind = 'lattice', which meshes by another way, or another edge_length_mm or "
        f"epsilon.{said}"
    )


def _die_with_parent(parent: int) -> None:
    """Linux: no orphan goes on meshing when the parent is killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            sys.exit("the parent process is gone")


def main() -> None:
    """The child: reads surface.npz, writes tets.npz, in the current folder."""
    _die_with_parent(int(sys.argv[1]))
    if importlib.util.find_spec("pyvista") is None:
        sys.modules["pyvista"] = types.ModuleType("pyvista")
    import pytetwild

    with np.load("surface.npz") as surface:
        nodes, tets = pytetwild.tetrahedralize(
            surface["points"],
            surface["triangles"],
            edge_length_abs=float(surface["edge_length"]),
            epsilon=float(surface["epsilon"]),
            num_threads=int(surface["threads"]),
            quiet=True,
            **{name: surface[name] for name in surface.files if name.startswith("bg_")},
        )
    np.savez("tets.npz", nodes=np.asarray(nodes, dtype=np.float64), tets=np.asarray(tets, dtype=np.int64))


if __name__ == "__main__":
    main()
