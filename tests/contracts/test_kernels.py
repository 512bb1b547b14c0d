"""Kernels are compiled anew when anything that they are made of is edited, and by one door."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import simcore
from simcore import kernels

ROOT = Path(simcore.__file__).parent
KERNEL = """
from simcore.kernels import njit
from simcore.part import part
from simcore.below import constants

@njit(cache=True)
def whole(x):
    return part(x) + constants.ONE

print(whole(1), *whole.stats.cache_hits.values())
"""
PART = """
from simcore.kernels import njit

@njit({options})
def part(x):
    return {factor} * x
"""


def _value(folder: Path, environment: dict[str, str]) -> str:
    command = [sys.executable, "-m", "simcore.whole"]
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.strip()


def test_a_kernel_follows_the_files_that_it_is_made_of(tmp_path: Path) -> None:
    package = tmp_path / "simcore"
    (package / "below").mkdir(parents=True)
    shutil.copy(ROOT / "kernels.py", package)
    shutil.copy(ROOT / "__init__.py", package)
    (package / "below" / "__init__.py").write_text("")
    (package / "below" / "constants.py").write_text("ONE = 1")
    (package / "whole.py").write_text(KERNEL)
    part = package / "part.py"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    for options in ('inline="always"', "cache=True"):
        part.write_text(PART.format(options=options, factor=10))
        assert _value(tmp_path, environment) == "11"
        assert _value(tmp_path, environment) == "11 1", "read from the file"
        part.write_text(PART.format(options=options, factor=20))
        assert _value(tmp_path, environment) == "21"
    (package / "below" / "constants.py").write_text("ONE = 2")
    assert _value(tmp_path, environment) == "22"


def test_kernels_come_by_one_door() -> None:
    """An own import of numba's decorator would be a kernel whose file is stale after an edit elsewhere."""
    for path in ROOT.rglob("*.py"):
        if path.name == "kernels.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == "numba":
                assert not {name.name for name in node.names} & {"njit", "jit", "vectorize", "guvectorize"}, path
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "numba":
                assert node.attr not in ("njit", "jit", "vectorize", "guvectorize"), path


def test_sources_are_those_that_python_imports() -> None:
    for path in ROOT.rglob("*.py"):
        expected = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: a relative import"
                for name in node.names:
                    expected.add(_file(f"{node.module}.{name.name}") or _file(str(node.module)))
            elif isinstance(node, ast.Import):
                expected.update(_file(name.name) for name in node.names)
        assert kernels._imported(path) >= expected - {None}, path


def _file(module: str) -> Path | None:
    place = ROOT.parent.joinpath(*module.split("."))
    files = [file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()]
    return files[0] if files and module.split(".")[0] == "simcore" else None


def test_the_sources_of_a_kernel_are_few() -> None:
    """An edit compiles what it changes, not everything."""
    sources = kernels.sources_of(ROOT / "fem" / "laws" / "energies.py")
    assert ROOT / "fem" / "laws" / "plain.py" in sources
    assert ROOT / "projection" / "rays.py" not in sources
