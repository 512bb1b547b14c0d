"""What bench.same says of two runs, and where it refuses; the runs themselves take minutes."""

import subprocess
import sys
from typing import Any

import pytest

from bench.same import run as same
from bench.same.run import compared


def stage(seconds: float, **digests: str) -> dict[str, Any]:
    return {
        "version": 1,
        "seconds": seconds,
        "outputs": {name: {"sha256": d, "size": 1} for name, d in digests.items()},
    }


def test_files_that_differ_are_named_and_the_first_round_is_not_timed() -> None:
    runs = [
        ({"warp": stage(a, x="1", y="2")}, {"warp": stage(b, x="1", y="3", z="4")}) for a, b in [(9, 1), (2, 1), (4, 3)]
    ]
    row = compared("warp", runs)
    assert row == {"same": False, "differing": ["y", "z"], "seconds": [3.0, 2.0], "ratio": 0.625}


def test_equal_bytes_of_another_version_are_not_the_same() -> None:
    first, second = stage(1.0, x="1"), {**stage(1.0, x="1"), "version": 2}
    assert compared("warp", [({"warp": first}, {"warp": first})] * 2)["same"]
    assert compared("warp", [({"warp": first}, {"warp": second})] * 2)["differing"] == ["version: 1 and 2"]
    assert not compared("warp", [({"warp": first}, {})])["same"]


def test_no_revision() -> None:
    command = [sys.executable, "-m", "bench.same", "no-such-revision"]
    ended = subprocess.run(command, cwd=same.ROOT, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (1, "no-such-revision is no revision of this repository\n")


@pytest.mark.parametrize("room", ["store", "core"])
def test_the_driver_runs_the_program_of_the_folder_it_is_in(tmp_path: Any, room: str) -> None:
    """Another revision's, not the one that it lies in."""
    (tmp_path / "tree" / "simcore" / room).mkdir(parents=True)
    for name in ("__init__", f"{room}/__init__"):
        (tmp_path / "tree" / "simcore" / f"{name}.py").touch()
    (tmp_path / "tree" / "simcore" / room / "store.py").write_text("Store = lambda root, min_free_bytes: root")
    (tmp_path / "tree" / "simcore" / "spec.py").write_text(
        "class SimulationSpec:\n    from_dict = staticmethod(lambda d: type('Spec', (), {'mesh': type('M', (), d)}))"
    )
    (tmp_path / "tree" / "simcore" / "pipeline.py").write_text(
        "from types import SimpleNamespace\n"
        "run = lambda spec, store: SimpleNamespace(manifest={'stages': [{'name': spec.mesh.kind}]})"
    )
    with same.Revision("old", tmp_path / "tree", tmp_path / "store") as revision:
        assert revision.run({"kind": "lattice"}) == {"lattice": {"name": "lattice"}}


@pytest.mark.parametrize("kind", ["mesh", "fem"])
def test_only_a_mesh_is_handed_over(tmp_path: Any, kind: str) -> None:
    record = tmp_path / "a" / "stages" / "ab" / "abc.json"
    record.parent.mkdir(parents=True)
    record.write_text(f'{{"stage": "{kind}", "outputs": {{"x": {{"sha256": "0123", "size": 3}}}}}}')
    (tmp_path / "a" / "objects" / "01").mkdir(parents=True)
    (tmp_path / "a" / "objects" / "01" / "0123").write_text("abc")
    same.hand_over_mesh(tmp_path / "a", tmp_path / "b")
    copies = sorted(p.name for p in (tmp_path / "b").rglob("*") if p.is_file())
    assert copies == (["0123", "abc.json"] if kind == "mesh" else [])
