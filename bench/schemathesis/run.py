"""Schemathesis against the whole OpenAPI description: the real application on a port of this machine, with a pipeline
that ends in no time and an administrator's key. Last line: {"operations", "cases", "failures"}.

    python -m bench.schemathesis --seconds 600
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from api.app import create_app
from bench.schemathesis.resources import Values, configuration, make, make_dicom_cases
from simcore.core.errors import SimulationError
from simcore.spec import SimulationSpec
from tests.support import fake_pipeline
from tests.support.brokers import SilentBroker
from tests.support.servers import served
from worker.settings import Settings

CONFIGURATION = Path(__file__).with_name("configuration.toml")
SECRET = "a-key-for-tests-that-may-do-everything"


class Finisher(threading.Thread):
    """A worker in a thread: runs every queued case with the fake pipeline, and lets every delivery fail."""

    def __init__(self, app: Any) -> None:
        super().__init__(name="finisher", daemon=True)
        self.app = app
        self.stopping = threading.Event()

    def run(self) -> None:
        services = self.app.state.services
        while not self.stopping.wait(0.02):
            services.fleet.beat("finisher", 1)
            for job in services.jobs.unsent() + services.jobs.sent_before(time.time() + 1):
                if services.jobs.claim(job.id, "finisher") is None:
                    continue
                try:
                    specification = SimulationSpec.from_dict(services.jobs.specification(job.id))
                    # The name asks the fake pipeline for misbehaviour.
                    result = fake_pipeline.run(specification.with_(name=""), services.store, lambda *a, **k: None)
                    services.jobs.succeed(job.id, "finisher", result.manifest)
                except SimulationError as error:
                    services.jobs.fail(job.id, "finisher", error.to_dict())
            for delivery in services.deliveries.unsent() + services.deliveries.sent_before(time.time() + 1):
                if services.deliveries.claim(delivery.id, "finisher") is not None:
                    error = {"kind": "system", "code": "no-answer", "message": "nothing listens there"}
                    services.deliveries.fail(delivery.id, "finisher", error)


@dataclass(frozen=True)
class Target:
    """A running service. values: of parameters of paths, by dictionary: what there is to ask for."""

    url: str
    values: Values


@contextmanager
def service() -> Iterator[Target]:
    """A running service that holds a few of everything."""
    with tempfile.TemporaryDirectory() as folder:
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
        app = create_app(settings, SilentBroker(), sweep=False)
        finisher = Finisher(app)
        with served(app) as url:
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
