"""Compiles the kernels of all stages by several processes at once, so that no case has to wait for it.

    python -m simcore.warmup PART      (one part, in this process)

numba keeps what it compiles in files beside the sources (or in NUMBA_CACHE_DIR), which all processes share
(simcore/kernels.py). Every stage is a part: it runs on a small breast that is made here, so that no part waits for the
kernels of another stage.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from simcore import children, detection, dicom, fem, phantom, presets, preview, projection, reconstruction, warp
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.errors import SimulationError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.detection.stack import Expected
from simcore.detection.transfer import RationalTransfer
from simcore.mesh.spec import LatticeMesh
from simcore.mesh.structured import half_ellipsoid
from simcore.phantom.spec import AnthropomorphicPhantom, CompartmentSpec, DuctSpec, TextureSpec
from simcore.projection.spec import PhysicsSpec, SlabSpec

TINY = presets.get("tiny")
MONOENERGETIC = PhysicsSpec()
GROWN = AnthropomorphicPhantom(volume_ml=60.0, voxel_mm=1.0, compartments=CompartmentSpec(count=60, ligament_mm=1.0))
THICKNESS_MM = 30.0
AXES_MM = (40.0, 30.0, 15.0, 15.0)
VOXEL_MM = 1.0


def is_cold() -> bool:
    """Whether nothing was compiled yet of the sources as they are, where this installation keeps it."""
    from simcore.kernels import is_compiled
    from simcore.phantom.raster import label_voxels

    return not is_compiled(label_voxels)


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_all(processes: int, tell: Callable[[str, float], None], names: Sequence[str] | None = None) -> None:
    """Runs every part, or those of ``names``, in a process of its own, ``processes`` at a time.

    tell: told of each part that is done, and which fraction of all that makes.
    raises: SimulationError where one failed, with what it said.
    """
    with ThreadPoolExecutor(processes) as pool:
        parts = {pool.submit(_in_a_process, name): name for name in names or PARTS}
        for done, part in enumerate(as_completed(parts), 1):
            part.result()
            tell(parts[part], done / len(parts))


def _in_a_process(part: str) -> None:
    # One thread: the parts have the cores already.
    environment = children.environment(NUMBA_NUM_THREADS="1", OMP_NUM_THREADS="1")
    ended = subprocess.run(children.command("simcore.warmup", part), env=environment, capture_output=True, text=True)
    if ended.returncode:
        raise SimulationError(f"the kernels of {part} could not be compiled: {ended.stderr.strip()[-2000:]}")


# A small breast


def _breast() -> Phantom:
    """A half ellipsoid of fat with some gland in skin, breast frame."""
    depth, half_width, upper, lower = AXES_MM
    shape = (int(upper + lower) + 4, int(2 * half_width) + 4, int(depth) + 2)
    grid = Grid(shape, (VOXEL_MM,) * 3, (0.0, -shape[1] / 2, -shape[0] / 2))
    z, y, x = np.meshgrid(grid.centres("z"), grid.centres("y"), grid.centres("x"), indexing="ij")
    radius = np.sqrt((x / depth) ** 2 + (y / half_width) ** 2 + (z / upper) ** 2)
    labels = np.select([radius < 0.4, radius < 0.9, radius < 1.0], [Tissue.GLAND, Tissue.ADIPOSE, Tissue.SKIN], 0)
    return Phantom(labels.astype(np.uint8), grid)


def _compressed() -> Phantom:
    """The same in the support frame."""
    breast = _breast()
    return Phantom(breast.labels, breast.grid.moved(z=THICKNESS_MM / 2))


def _compression(nodes: int) -> Compression:
    half = THICKNESS_MM / 2
    return Compression(np.zeros((nodes, 3)), (-half, half), 10.0, "converged", {"thickness_mm": THICKNESS_MM})


def _stack() -> ProjectionStack:
    geometry = projection.geometry_of(TINY.acquisition)
    shape = (geometry.views, geometry.detector.ny, geometry.detector.nx)
    data = np.full(shape, 60000, np.uint16)
    data[:, 40:-40, :60] = 20000
    return ProjectionStack(data, 60000.0, geometry)


def _volume() -> Volume:
    grid = Grid((15, 256, 160), (0.7, 0.7, 2.0), (0.0, -89.6, 20.0))
    data = np.zeros(grid.shape, np.uint16)
    data[:, 40:-40, :60] = 25000
    return Volume(data, grid, 1e-5, -0.2)


# The parts: longest first, so that they fill several processors


def _fem() -> None:
    tetrahedra = half_ellipsoid(AXES_MM, 4)
    compression = fem.compress(tetrahedra, _breast(), TINY.compression)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "compression.vtu"
        fem.write_vtu(target, tetrahedra, compression, _breast(), TINY.compression.material)


def _phantom() -> None:
    phantom.generate(GROWN, 1)


def _warp() -> None:
    tetrahedra = half_ellipsoid(AXES_MM, 4)
    warp.deform(_breast(), tetrahedra, _compression(len(tetrahedra.nodes)), TINY.warp)


def _projection() -> None:
    projection.project(_compressed(), TINY.acquisition, MONOENERGETIC)


def _detection() -> None:
    stack = _stack()
    signal = np.ones(stack.data.shape, np.float32)
    expected = Expected(signal, signal, signal[0])
    # Lag and correlated noise, then neither.
    system = detection.detector_of("ge-pristina").with_(transfer=RationalTransfer(half_per_mm=3.0))
    detection.detect(expected, system, stack.geometry, 0)
    detection.detect(expected, detection.DetectionSpec(), stack.geometry, 0)


def _reconstruction() -> None:
    reconstruction.reconstruct(_stack(), TINY.reconstruction, THICKNESS_MM)


def _files() -> None:
    case = dicom.CaseDescription("0" * 64, 1, "", MONOENERGETIC.energy_keV)
    stack, volume = _stack(), _volume()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        dicom.export(root, TINY.export, case, stack, volume, _compressed(), _compression(1))
        preview.write_previews(root, phantom=_breast(), compressed=_compressed(), stack=stack, volume=volume)


def _mesh() -> None:
    from simcore import mesh

    mesh.build(_breast(), LatticeMesh(edge_length_mm=16.0))


def _other_phantoms() -> None:
    phantom.generate(GROWN.with_(texture=TextureSpec(amplitude_mm=1.0), ducts=DuctSpec()), 1)


def _other_projections() -> None:
    breast = _compressed()
    rays = MONOENERGETIC.with_(sampling="trilinear", rays_per_pixel_edge=2)
    projection.project(breast, TINY.acquisition, rays)
    turning = TINY.acquisition.with_(detector_range_degrees=4.0, paddle=SlabSpec())
    projection.project(breast, turning, MONOENERGETIC)


PARTS: dict[str, Callable[[], None]] = {
    "fem": _fem,
    "phantom": _phantom,
    "warp": _warp,
    "projection": _projection,
    "files": _files,
    "reconstruction": _reconstruction,
    "mesh": _mesh,
    "detection": _detection,
    "other phantoms": _other_phantoms,
    "other projections": _other_projections,
}
OF_MOST_CASES = ("fem", "phantom", "warp", "projection", "files", "reconstruction", "mesh")


if __name__ == "__main__":
    PARTS[sys.argv[1]]()
