"""The client and the command beside modules of the user's that have the names of our packages, and without numerics."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import ClassVar

import httpx
import pytest

from simcore import presets

ROOT = Path(__file__).parents[2]
SERVICE_AND_NUMERICS = (
    *("api", "worker", "alembic", "celery", "fastapi", "redis", "sqlalchemy", "starlette", "uvicorn"),
    *("numpy", "numba", "llvmlite", "scipy", "skimage", "pydicom", "pynetdicom", "zstandard", "PIL", "meshio"),
    *("fcntl", "resource"),
)
WITHOUT = f"""
import sys

class Nowhere:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {SERVICE_AND_NUMERICS!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

for name in [n for n in sys.modules if n.split(".")[0] in {SERVICE_AND_NUMERICS!r}]:
    del sys.modules[name]
sys.meta_path.insert(0, Nowhere())
"""


def python(code: str, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, *options, "-c", code], cwd=folder, env=env, capture_output=True, text=True)


@pytest.fixture
def crowded(tmp_path: Path) -> Path:
    """A folder of a user who calls things as we do."""
    for name in ("api", "simcore"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"raise RuntimeError('the {name} of the user')\n")
    (tmp_path / "worker.py").write_text("raise RuntimeError('the worker of the user')\n")
    return tmp_path


class _Answers(BaseHTTPRequestHandler):
    """Just enough of a service."""

    documents: ClassVar = {
        "/v1/presets/tiny": {
            "name": "tiny",
            "description": "",
            "href": "/v1/presets/tiny",
            "specification": presets.get("tiny").model_dump(mode="json"),
        }
    }

    def do_GET(self) -> None:
        body = json.dumps(self.documents[self.path]).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def url() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), _Answers) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_program_with_an_api_and_a_worker_of_its_own_asks_the_service(crowded: Path, url: str) -> None:
    (crowded / "simcore" / "__init__.py").unlink()  # an empty folder of that name is no package
    code = f"from tomosim import Client\nwith Client({url!r}) as c: print(c.preset('tiny').with_(seed=7).seed)"
    ended = python(code, crowded)
    assert (ended.returncode, ended.stdout) == (0, "7\n"), ended.stderr


@pytest.mark.parametrize("code", ["import tomosim.client", "import tomosim; tomosim.Client"])
def test_a_package_called_as_the_specification_is_named(crowded: Path, code: str) -> None:
    ended = python(code, crowded)
    last = ended.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ImportError: Python takes {crowded / 'simcore' / '__init__.py'} for the package 'simcore'")


@pytest.mark.parametrize("arguments", [["--help"], ["presets"], ["presets", "tiny"]])
@pytest.mark.parametrize("on_path", [False, True])
def test_the_command_runs_beside_them(crowded: Path, arguments: list[str], on_path: bool) -> None:
    path = os.pathsep.join([str(crowded), str(ROOT)] if on_path else [str(ROOT)])
    command = [sys.executable, "-m", "tomosim", *arguments]
    ended = subprocess.run(command, cwd=crowded, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_the_service_starts_beside_them(crowded: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "tomosim", "serve", "--port", str(port), "--data", "data"]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    service = subprocess.Popen(command, cwd=crowded, env=env, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        for _ in range(900):
            assert service.poll() is None, service.stderr and service.stderr.read()
            try:
                if httpx.get(f"http://127.0.0.1:{port}/readyz").is_success:
                    break
            except httpx.HTTPError:
                pass
            time.sleep(0.1)
        else:
            pytest.fail("not ready after a minute and a half")
        service.terminate()
        assert service.wait(60) == 0
    finally:
        if service.poll() is None:
            os.killpg(service.pid, signal.SIGKILL)
        service.communicate()


def test_client_specification_and_command_need_neither_numerics_nor_service(tmp_path: Path) -> None:
    code = f"""{WITHOUT}
import tomosim
from tomosim.client import Client
from simcore.phantom.upload.reading import Reading
names = tomosim.presets.names()
specs = [tomosim.SimulationSpec.parse(tomosim.presets.get(name).model_dump_json()) for name in names]
Client("http://127.0.0.1:1").close()
tomosim.StudySpec.parse(open({str(ROOT / "tomosim" / "examples" / "lesion_pairs.json")!r}).read())
Reading.parse('{{"tissues": "victre", "raw": {{"shape": [2, 2, 2], "spacing_mm": [1.0, 1.0, 1.0]}}}}')
try:
    tomosim.SimulationSpec.from_dict({{"acquisition": {{"views": 0}}}})
except tomosim.SpecError as error:
    print(error.problems[0]["field"])
from tomosim.cli import main
sys.exit(main(["presets", "tiny"]))
"""
    ended = python(code, tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "acquisition.views" in ended.stdout


@pytest.mark.parametrize(
    ("missing", "arguments", "sentence"),
    [
        ("numba", ["simulate", "spec.json", "--out", "case"], "pip install 'tomosim[sim]'"),
        ("numpy", ["estimate", "spec.json"], "pip install 'tomosim[sim]'"),
        ("sqlalchemy", ["serve"], "pip install 'tomosim[service]'"),
        ("fcntl", ["serve"], "Windows lacks"),
        ("fcntl", ["simulate", "spec.json", "--out", "case"], "Windows lacks"),
    ],
)
def test_a_command_says_in_one_sentence_what_it_lacks(
    tmp_path: Path, missing: str, arguments: list[str], sentence: str
) -> None:
    (tmp_path / "spec.json").write_text(presets.get("tiny").model_dump_json())
    code = f"""{WITHOUT.replace(repr(SERVICE_AND_NUMERICS), repr((missing,)))}
from tomosim.cli import main
sys.exit(main({arguments!r}))
"""
    ended = python(code, tmp_path, "-P")
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith(f"tomosim: this needs {'the module ' if missing == 'fcntl' else ''}{missing}")
    assert sentence in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


def test_version_and_names_of_the_package() -> None:
    import simcore
    import tomosim

    assert tomosim.__version__ == simcore.__version__
    assert set(tomosim.__all__) <= set(dir(tomosim))
    for name in tomosim.__all__:
        assert getattr(tomosim, name)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = tomosim.nothing
