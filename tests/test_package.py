"""The package as it is installed: a wheel, in a new environment, outside the repository."""

import os
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = [pytest.mark.sweep, pytest.mark.timeout(1800)]

CLIENT = """
import importlib.util, tomosim
from tomosim import Client, SimulationSpec, SpecError, presets
from tomosim.client import Retrying
assert not any(importlib.util.find_spec(name) for name in ("numpy", "numba", "scipy", "fastapi", "sqlalchemy"))
assert SimulationSpec.parse(presets.get("tiny").model_dump_json()) == presets.get("tiny")
try:
    SimulationSpec.from_dict({"acquisition": {"views": 0}})
except SpecError as error:
    assert error.problems[0]["field"] == "acquisition.views"
try:
    Client("http://127.0.0.1:9", retrying=Retrying(attempts=1)).service_info()
except tomosim.ServiceError as error:
    print(tomosim.__version__, error.code)
"""


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return subprocess.run([*map(str, command)], cwd=cwd, env=env, capture_output=True, text=True)


def done(*command: str | Path, cwd: Path) -> str:
    ended = run(*command, cwd=cwd)
    assert ended.returncode == 0, ended.stderr[-4000:]
    return ended.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the wheel and the sdist, made from what git knows: nothing of the working tree is mixed in."""
    folder = tmp_path_factory.mktemp("dist")
    clone = tmp_path_factory.mktemp("clone") / "tomosim"
    done("git", "clone", "--quiet", "--no-hardlinks", ROOT, clone, cwd=folder)
    done(sys.executable, "-m", "build", "--outdir", folder, ".", cwd=clone)
    return folder


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """The Python of a new environment."""
    venv.create(tmp_path / "venv", with_pip=True)
    return tmp_path / "venv" / "bin" / "python"


def test_wheel_and_sdist_carry_what_the_readme_uses(built: Path) -> None:
    [wheel], [sdist] = built.glob("*.whl"), built.glob("*.tar.gz")
    in_wheel = set(zipfile.ZipFile(wheel).namelist())
    tracked = set(done("git", "ls-files", "simcore", "tomosim_contract", "worker", "api", "tomosim", cwd=ROOT).split())
    assert tracked - in_wheel == set()
    assert not [name for name in in_wheel if name.startswith(("tests", "bench"))]
    with tarfile.open(sdist) as archive:
        in_sdist = {name.partition("/")[2] for name in archive.getnames()}
    files = {"Makefile", "requirements.lock", "requirements-dev.lock", "tests/conftest.py", "bench/case.py", ".ci/run"}
    assert files - in_sdist == set()


def test_the_client_alone(built: Path, python: Path, tmp_path: Path) -> None:
    done(python, "-m", "pip", "install", "--quiet", *built.glob("*.whl"), cwd=tmp_path)
    version, code = done(python, "-c", CLIENT, cwd=tmp_path).split()
    command = python.with_name("tomosim")
    assert done(command, "--version", cwd=tmp_path) == f"tomosim {version}\n"
    assert code == "service-unreachable"
    assert "tiny" in done(command, "presets", cwd=tmp_path)
    assert "axes" in done(command, "study", "example", "lesion_pairs", cwd=tmp_path)
    (tmp_path / "spec.json").write_text(done(command, "presets", "tiny", cwd=tmp_path))
    for arguments, extra in ((["simulate", "spec.json", "--out", "case"], "sim"), (["serve"], "service")):
        refused = run(command, *arguments, cwd=tmp_path)
        assert refused.returncode == 2
        assert refused.stderr.endswith(f"python -m pip install 'tomosim[{extra}]'\n")
        assert len(refused.stderr.splitlines()) == 1


def test_a_case_to_dicom(built: Path, python: Path, tmp_path: Path) -> None:
    [wheel] = built.glob("*.whl")
    done(python, "-m", "pip", "install", "--quiet", "--require-hashes", "-r", ROOT / "requirements.lock", cwd=tmp_path)
    done(python, "-m", "pip", "install", "--quiet", f"{wheel}[sim,service]", cwd=tmp_path)
    done(python, "-m", "pip", "check", cwd=tmp_path)
    command = python.with_name("tomosim")
    (tmp_path / "spec.json").write_text(done(command, "presets", "tiny", cwd=tmp_path))
    done(command, "simulate", "spec.json", "--out", "case", cwd=tmp_path)
    assert (tmp_path / "case" / "tomosynthesis.dcm").stat().st_size > 0
