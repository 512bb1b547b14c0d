"""The whole house with the real pipeline: ``tomosim serve``, ``tomosim submit``, an ordered stop."""

import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from simcore import presets
from simcore.mesh.spec import LatticeMesh
from tests.support.ports import free_port
from tests.support.servers import answers, program

TOMOSIM = [sys.executable, "-m", "tomosim"]


@pytest.fixture(scope="module")
def service(
    tmp_path_factory: pytest.TempPathFactory, module_backend: dict[str, object]
) -> Iterator[tuple[str, Path, subprocess.Popen[bytes]]]:
    data = tmp_path_factory.mktemp("data")
    port = free_port()
    env = {**os.environ, **{f"TOMOSIM_{name.upper()}": str(value) for name, value in module_backend.items()}}
    command = [*TOMOSIM, "serve", "--data", str(data), "--port", str(port)]
    url = f"http://127.0.0.1:{port}"
    log = tmp_path_factory.mktemp("log") / "log"
    with program(command, lambda: answers(f"{url}/readyz"), log, env) as process:
        yield url, data, process


def digests(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != "manifest.json"
    }


def submit(url: str, spec: str, *options: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*TOMOSIM, "submit", "-", "--url", url, *options],
        input=spec,
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
    )


def test_a_case_through_the_service_is_the_case_of_the_command_line(service, module_backend, tmp_path: Path):
    url, data, _ = service
    tiny = presets.get("tiny")
    if module_backend:  # computed twice, and the default mesher makes another mesh every time
        tiny = tiny.with_(reproducible=True, mesh=LatticeMesh(edge_length_mm=12.0))
    spec = tiny.model_dump_json()
    done = submit(url, spec, "--wait", "--out", "served", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{url}/v1/simulations/")
    (tmp_path / "spec.json").write_text(spec)
    local = subprocess.run(
        [*TOMOSIM, "simulate", "spec.json", "--out", "local", "--data", str(data)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=300,
    )
    assert local.returncode == 0, local.stderr
    computed = json.loads((tmp_path / "local" / "manifest.json").read_text())["computed_stages"]
    # Where the service keeps its stages in the folder, the command line had nothing to compute.
    assert (computed == 0) == (not module_backend)
    served = digests(tmp_path / "served")
    assert served == digests(tmp_path / "local")
    assert "tomosynthesis.dcm" in served


def test_a_refused_specification_is_explained(service, tmp_path: Path):
    url, _, _ = service
    spec = json.loads(presets.get("tiny").model_dump_json())
    spec["acquisition"]["detector"]["pixels_y"] = 20
    done = submit(url, json.dumps(spec), cwd=tmp_path)
    assert done.returncode == 2
    assert "pixels_y" in done.stderr
    assert "at least" in done.stderr


def test_a_second_instance_on_the_same_folder_is_refused(service, tmp_path: Path):
    _, data, _ = service
    second = subprocess.run(
        [*TOMOSIM, "serve", "--data", str(data), "--port", str(free_port())], capture_output=True, text=True, timeout=60
    )
    assert second.returncode != 0
    assert str(data) in second.stderr


def test_ctrl_c_stops_in_order(service):
    url, _, process = service
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{url}/livez")
