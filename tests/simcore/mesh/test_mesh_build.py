"""The mesh stage from labels to tetrahedra, and the child process in which the mesher runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.advice import one_of
from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.errors import Cancelled, MeshError, MeshMemoryError
from simcore.core.grid import Grid
from simcore.mesh import LatticeMesh, TetwildMesh, build, tetwild
from simcore.mesh.quality import boundary_faces, radius_ratios, volumes
from simcore.mesh.structured import box
from simcore.mesh.surface import enclosed_volume
from tests.support.waiting import wait_for

SEMI_AXES = (34.0, 22.0, 25.0, 20.0)
VOLUME = np.pi / 3 * 34 * 22 * 45


def ellipsoid(voxel: float, scale: float = 1.0) -> Phantom:
    a, b, upper, lower = (scale * s for s in SEMI_AXES)
    nx, ny = int(np.ceil(a / voxel)) + 2, 2 * int(np.ceil(b / voxel)) + 4
    below, above = int(np.ceil(lower / voxel)) + 2, int(np.ceil(upper / voxel)) + 2
    grid = Grid((below + above, ny, nx), (voxel,) * 3, (0.0, -ny * voxel / 2, -below * voxel))
    x, y = grid.centres("x")[None, None, :], grid.centres("y")[None, :, None]
    z = grid.centres("z")[:, None, None]
    inside = (x / a) ** 2 + (y / b) ** 2 + (z / np.where(z > 0, upper, lower)) ** 2 <= 1
    return Phantom(inside.astype(np.uint8), grid)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return build(ellipsoid(1.0), TetwildMesh(edge_length_mm=14.0, epsilon=4e-3))


def test_volume(mesh: TetMesh) -> None:
    assert volumes(mesh.nodes, mesh.tets).sum() == pytest.approx(VOLUME, rel=0.01)
    assert abs(mesh.report["volume_before_correction"] - 1) < 0.02


def test_wall_is_exact(mesh: TetMesh) -> None:
    assert (mesh.nodes[mesh.wall, 0] == 0.0).all()
    assert mesh.nodes[:, 0].min() == 0.0
    faces = boundary_faces(mesh.tets)
    corners = mesh.nodes[faces[np.isin(faces, mesh.wall).all(axis=1)]]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    assert area == pytest.approx(np.pi * 22 * 22.5, rel=0.02)


def test_skin_and_wall_close_the_body(mesh: TetMesh) -> None:
    faces = boundary_faces(mesh.tets)
    assert len(mesh.skin) < len(faces)
    assert enclosed_volume(mesh.nodes, faces.astype(np.int32)) == pytest.approx(mesh.report["volume_ml"] * 1e3)
    # The wall contributes nothing to the integral of x n_x: the skin alone gives the volume.
    a, b, c = (mesh.nodes[mesh.skin[:, k]] for k in range(3))
    x_normal = np.cross(b - a, c - a)[:, 0] / 2
    assert (x_normal * (a + b + c)[:, 0] / 3).sum() == pytest.approx(mesh.report["volume_ml"] * 1e3)


def test_skin_lies_on_the_ellipsoid(mesh: TetMesh) -> None:
    a, b, upper, lower = SEMI_AXES
    points = mesh.nodes[np.unique(mesh.skin)] / [a, b, 1.0]
    points[:, 2] /= np.where(points[:, 2] > 0, upper, lower)
    distance = (np.linalg.norm(points, axis=1) - 1) * min(SEMI_AXES)
    assert np.abs(distance).max() < 0.5


def test_quality(mesh: TetMesh) -> None:
    assert volumes(mesh.nodes, mesh.tets).min() > 0
    assert radius_ratios(mesh.nodes, mesh.tets).min() > 0.01
    assert mesh.report["radius_ratio"]["percentile_1"] > 0.3
    assert mesh.report["radius_ratio"]["mean"] > 0.7
    assert 500 < len(mesh.tets) < 8000
    assert len(np.unique(mesh.tets)) == len(mesh.nodes)


def test_tiny_phantom_of_coarse_voxels() -> None:
    phantom = ellipsoid(2.0, scale=(5e3 / VOLUME) ** (1 / 3))
    mesh = build(phantom, TetwildMesh(edge_length_mm=14.0, epsilon=4e-3))
    labels_ml = np.count_nonzero(phantom.labels) * phantom.grid.voxel_volume / 1e3
    assert mesh.report["volume_ml"] == pytest.approx(labels_ml, rel=1e-3)
    assert abs(mesh.report["volume_before_correction"] - 1) < 0.02


def test_nothing_is_left_in_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cube = box((10.0, 10.0, 10.0), (1, 1, 1))
    nodes, tets = tetwild.tetrahedralize(
        cube.nodes, boundary_faces(cube.tets).astype(np.int32), edge_length=5.0, epsilon=1e-2
    )
    assert np.abs(volumes(nodes, tets)).sum() == pytest.approx(1000.0, rel=0.02)
    assert not list(tmp_path.iterdir())


def test_failure_carries_the_last_lines_of_the_child() -> None:
    with pytest.raises(
        MeshError, match=r"fTetWild failed with exit status 1; take mesh.kind = 'lattice'.*lines.*Error"
    ) as error:
        tetwild.tetrahedralize(np.zeros((3, 3)), np.zeros((0, 3), np.int32), edge_length=-1.0, epsilon=np.str_("x"))  # type: ignore[arg-type]
    assert error.value.code == "mesh-failed"


def test_a_mesher_without_memory_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the child a mesher that asks for more than any machine has: limits of a process differ between kernels."""
    (tmp_path / "pytetwild.py").write_text("def tetrahedralize(*_, **options): return bytearray(1 << 62)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(MeshMemoryError, match=r"the mesher needed more memory.*edge_length_mm.*MemoryError") as error:
        tetwild.tetrahedralize(np.eye(3), np.array([[0, 1, 2]], np.int32), edge_length=1.0, epsilon=1e-3)
    assert (error.value.to_dict()["kind"], error.value.code) == ("system", "out-of-memory")


@pytest.mark.parametrize(
    ("code", "log", "out_of_memory"),
    [
        (-6, "terminate called after throwing an instance of 'std::bad_alloc'", True),
        (1, "Traceback\nMemoryError: std::bad_alloc", True),
        (-6, "free(): invalid pointer", False),
        (1, "MemoryError\n" + "a line\n" * 8, False),
        (None, "std::bad_alloc", False),
    ],
)
def test_what_is_for_want_of_memory(code: int | None, log: str, out_of_memory: bool) -> None:
    assert (tetwild._failure(code, log, 1.0).code == "out-of-memory") is out_of_memory


def test_timeout() -> None:
    cube = box((10.0, 10.0, 10.0), (1, 1, 1))
    with pytest.raises(MeshError, match=r"time_limit_s = 0\.01 s; .*mesh.kind = 'lattice'.*time_limit_s\.$") as error:
        tetwild.tetrahedralize(
            cube.nodes, boundary_faces(cube.tets).astype(np.int32), edge_length=0.2, epsilon=1e-3, time_limit_s=0.01
        )
    assert error.value.code == "mesh-time-limit"


def test_the_time_limit_is_that_of_the_specification_and_no_part_of_the_mesh() -> None:
    labels = np.zeros((80, 80, 60), np.uint8)
    labels[10:70, 10:70, :50] = 1  # a cube takes fTetWild minutes
    phantom = Phantom(labels, Grid(labels.shape, (1.0, 1.0, 1.0), (0.0, -40.0, -40.0)))
    spec = TetwildMesh(time_limit_s=1.0)
    with pytest.raises(MeshError, match=r"mesh\.time_limit_s = 1 s"):
        build(phantom, spec)
    assert spec.parameters() == TetwildMesh().parameters()
    assert "time_limit_s" not in spec.parameters()
    with pytest.raises(ValidationError, match="time_limit_s"):
        TetwildMesh(time_limit_s=0.0)


def test_a_mesh_that_is_as_fine_as_can_be_is_not_advised_to_be_finer() -> None:
    assert one_of(*TetwildMesh(edge_length_mm=2.0, epsilon=1e-5).finer()) == "mesh.kind = 'lattice'"
    assert one_of(*TetwildMesh(edge_length_mm=2.0).finer()) == "an epsilon below 0.001 or mesh.kind = 'lattice'"
    assert "epsilon" not in one_of(*LatticeMesh().finer())
    assert "edge_length_mm" not in one_of(*LatticeMesh(edge_length_mm=2.0).finer())


def _children(pid: int) -> list[int]:
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _slow_cube() -> str:
    return (
        "from simcore.mesh import tetwild; from simcore.mesh.structured import box\n"
        "from simcore.mesh.quality import boundary_faces\n"
        "cube = box((10.0, 10.0, 10.0), (1, 1, 1))\n"
        "tetwild.tetrahedralize(cube.nodes, boundary_faces(cube.tets).astype('int32'), edge_length=0.1, epsilon=1e-4)"
    )


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")
def test_cancelling_ends_the_child() -> None:
    before = set(_children(os.getpid()))

    def cancel(fraction: float, message: str) -> None:
        assert set(_children(os.getpid())) - before
        raise Cancelled("stop")

    cube = box((10.0, 10.0, 10.0), (1, 1, 1))
    with pytest.raises(Cancelled):
        tetwild.tetrahedralize(
            cube.nodes, boundary_faces(cube.tets).astype(np.int32), edge_length=0.1, epsilon=1e-4, progress=cancel
        )
    assert set(_children(os.getpid())) == before


@pytest.mark.skipif(sys.platform != "linux", reason="PR_SET_PDEATHSIG is Linux's")
def test_child_dies_with_its_parent() -> None:
    root = str(Path(tetwild.__file__).parents[2])
    parent = subprocess.Popen([sys.executable, "-c", _slow_cube()], env={**os.environ, "PYTHONPATH": root})
    try:
        # It has asked for the signal once it maps the mesher's library.
        mesher = wait_for(
            lambda: next((p for p in _children(parent.pid) if _is_mesher(p) and "PyfTetWild" in _maps(p)), None),
            "the start of the mesher",
        )
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    try:
        wait_for(lambda: not _is_mesher(mesher), "the end of the mesher", seconds=10.0)
    except AssertionError:
        os.kill(mesher, signal.SIGKILL)
        raise


def _is_mesher(pid: int) -> bool:
    return b"simcore.mesh.tetwild" in _command(pid)


def _command(pid: int) -> bytes:
    """Empty for a process that is gone or a zombie."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def _maps(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return ""
