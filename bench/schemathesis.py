"""Schemathesis against the whole OpenAPI description: the real application on a port of this machine, with a pipeline
that ends in no time and an administrator's key. Last line: {"operations", "cases", "failures"}.

    python -m bench.schemathesis --seconds 600
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import logging
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import uvicorn

from api.app import create_app
from bench._schemathesis_resources import Values, configuration, make, make_dicom_cases
from simcore.core.errors import SimulationError
from simcore.spec import SimulationSpec
from worker.settings import Settings

ROOT = Path(__file__).parent.parent
CONFIGURATION = Path(__file__).with_suffix(".toml")
FAKE_PIPELINE = ROOT / "tests" / "worker" / "fake_pipeline.py"
SECRET = "a-key-for-tests-that-may-do-everything"
START_SECONDS = 60.0


class MemoryBroker:
    """Takes messages and forgets them: ``Finisher`` looks into the database."""

    def send(self, identifier: str, queue: str = "interactive") -> None: ...

    def waiting(self, queue: str) -> int:
        return 1

    def ping(self) -> None: ...


class Finisher(threading.Thread):
    """A worker in a thread: runs every queued case with the fake pipeline, and lets every delivery fail."""

    def __init__(self, app: Any) -> None:
        super().__init__(name="finisher", daemon=True)
        self.app = app
        self.stopping = threading.Event()

    def run(self) -> None:
        pipeline = _fake_pipeline()
        served = self.app.state.services
        while not self.stopping.wait(0.02):
            served.fleet.beat("finisher", 1)
            for job in served.jobs.unsent() + served.jobs.sent_before(time.time() + 1):
                if served.jobs.claim(job.id, "finisher") is None:
                    continue
                try:
                    specification = SimulationSpec.from_dict(served.jobs.specification(job.id))
                    # The name asks the fake pipeline for misbehaviour.
                    result = pipeline.run(specification.with_(name=""), served.store, lambda *a, **k: None)
                    served.jobs.succeed(job.id, "finisher", result.manifest)
                except SimulationError as error:
                    served.jobs.fail(job.id, "finisher", error.to_dict())
            for delivery in served.deliveries.unsent() + served.deliveries.sent_before(time.time() + 1):
                if served.deliveries.claim(delivery.id, "finisher") is not None:
                    error = {"kind": "system", "code": "no-answer", "message": "nothing listens there"}
                    served.deliveries.fail(delivery.id, "finisher", error)


@dataclass(frozen=True)
class Target:
    """A running service. values: of parameters of paths, by dictionary: what there is to ask for."""

    url: str
    values: Values


@contextmanager
def service() -> Iterator[Target]:
    """A running service that holds a few of everything."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        settings = Settings.load(
            data_folder=Path(folder),
            admin_key=SECRET,
            min_free_bytes=0,
            upload_limit_bytes=100_000,
            rate_per_second=0,
            gpu=True,
            # Schemathesis repeats requests with their keys, and would be given what it has deleted meanwhile.
            idempotency_seconds=1e-6,
        )
        app = create_app(settings, MemoryBroker(), sweep=False)
        server = uvicorn.Server(uvicorn.Config(app, log_config=None, access_log=False, timeout_graceful_shutdown=1))
        thread = threading.Thread(target=server.run, args=([listening],), name="server", daemon=True)
        thread.start()
        _wait_until_it_answers(f"{url}/livez")
        finisher = Finisher(app)
        try:
            with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {SECRET}"}, timeout=60) as http:
                dicom_cases = make_dicom_cases(http, app.state.services, Path(folder))
                finisher.start()
                values = make(http, dicom_cases)
            yield Target(url, values)
        finally:
            finisher.stopping.set()
            if finisher.is_alive():
                finisher.join(10)
            server.should_exit = True
            thread.join(20)


def run(target: Target, arguments: list[str]) -> tuple[int, str]:
    """Exit code and output of Schemathesis against a service."""
    # It keeps examples that failed in the folder where it runs.
    with tempfile.TemporaryDirectory() as folder:
        chosen = Path(folder) / "schemathesis.toml"
        chosen.write_text(f"{CONFIGURATION.read_text()}\n{configuration(target.values)}")
        command = [
            *(sys.executable, "-m", "schemathesis.cli", "--config-file", str(chosen)),
            *("run", f"{target.url}/openapi.json", "--header", f"Authorization: Bearer {SECRET}", "--no-color"),
            *arguments,
        ]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env={**os.environ, "COLUMNS": "160"})
    return done.returncode, done.stdout + done.stderr


def _wait_until_it_answers(url: str) -> None:
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            urllib.request.urlopen(url, timeout=5).close()
            return
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def _fake_pipeline() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fake_pipeline", FAKE_PIPELINE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fake_pipeline"] = module
    spec.loader.exec_module(module)
    return module


def main() -> int:
    """Runs for as long as asked; 0 where nothing was found."""
    parser = argparse.ArgumentParser(prog="python -m bench.schemathesis", description=__doc__)
    parser.add_argument("--seconds", type=int, default=600, help="time budget (default 600)")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the random cases (default: the clock)")
    parser.add_argument("--include-path", action="append", default=[], help="only these paths")
    args = parser.parse_args()
    logging.disable(logging.CRITICAL)
    more = [f"--include-path={path}" for path in args.include_path]
    with service() as target:
        code, output = run(
            target, [f"--max-time={args.seconds}", f"--seed={args.seed}", "--continue-on-failure", *more]
        )
    print(output)
    print(json.dumps({"seed": args.seed, "exit_code": code}))
    return code


if __name__ == "__main__":
    sys.exit(main())
