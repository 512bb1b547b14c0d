"""The examples of docs/client.md run against a real service, and its table names every method."""

import inspect
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.ports import free_port
from tomosim.client import AsyncClient, Client

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "client.md").read_text()


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a service with the pipeline of the service's tests."""
    for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
        monkeypatch.delenv(name)
    port = free_port()
    env = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "TOMOSIM_PIPELINE": "tests.support.fake_pipeline:run",
    }
    command = [sys.executable, "-m", "tomosim", "serve", "--data", str(tmp_path / "data"), "--port", str(port)]
    process = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, start_new_session=True)
    try:
        assert process.stdout is not None
        assert b"ready" in process.stdout.readline()
        yield f"http://127.0.0.1:{port}"
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_the_examples_run(service: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("TOMOSIM_URL", service)
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {}
    for number, code in enumerate(examples, 1):
        exec(compile(code, f"client.md, example {number}", "exec"), names)
    said = capsys.readouterr().out
    assert (tmp_path / "case" / "manifest.json").exists()
    assert "/acquisition/views" in said
    assert "2 {'acquisition.views': 5} succeeded" in said
    assert (tmp_path / "views.zip").exists()


def test_every_method_is_named() -> None:
    methods = {name for name, _ in inspect.getmembers(Client, inspect.isfunction) if not name.startswith("_")}
    table = PAGE.partition("## All methods")[2]
    assert set(re.findall(r"`(\w+)`", table)) == methods - {"close"}
    other = {name for name, _ in inspect.getmembers(AsyncClient, inspect.isfunction) if not name.startswith("_")}
    assert other == methods
