"""The service of the soak: broker, two workers and API, each started again when it is gone."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen

import httpx
from sqlalchemy.exc import SQLAlchemyError

from tests.support.ports import free_port
from worker.records import schema
from worker.records.database import connect
from worker.records.fleet import Fleet
from worker.records.jobs import Jobs
from worker.serve import broker, processes
from worker.settings import Settings

START_SECONDS = 60.0
POLL_SECONDS = 0.05
MARKER = "SOAK_RUN"
"""Environment variable that every process of a run has, so that none is overlooked."""


@dataclass
class Part:
    """A process that is started again when it has ended."""

    kind: str
    command: Callable[[], list[str]]
    process: Popen[bytes] | None = None


class Service:
    """Four processes on one data folder. Used in one thread, which must outlive them."""

    def __init__(self, data: Path) -> None:
        self.marker = uuid.uuid4().hex
        self.settings = Settings.load(
            data_folder=data,
            port=free_port(),
            threads_per_slot=1,
            memory_limit_bytes=4_000_000_000,
            lease_seconds=5.0,
            sweep_seconds=0.5,
            resend_seconds=5.0,
            # A case meets more kills here in a minute than elsewhere in its life.
            max_attempts=50,
        )
        self.url = f"http://127.0.0.1:{self.settings.port}"
        python = [sys.executable, "-m"]
        self._parts = [
            Part("broker", lambda: broker.command(self.settings)),
            Part("worker", lambda: [*python, "worker"]),
            Part("worker", lambda: [*python, "worker"]),
            Part("api", lambda: [*python, "api"]),
        ]
        self._fleet: Fleet | None = None

    def start(self) -> None:
        """Starts everything and waits until it is ready."""
        self.settings.data_folder.mkdir(parents=True)
        engine = connect(self.settings.resolved_database_url)
        schema.prepare(engine)
        self._fleet = Fleet(engine)
        deadline = time.monotonic() + START_SECONDS
        while not self._is_ready() or self._fleet.alive() < 2:
            if time.monotonic() > deadline:
                raise RuntimeError(f"the service was not ready within {START_SECONDS:g} s")
            self.watch(0.1)

    def watch(self, seconds: float) -> None:
        """Starts again what has ended, for so long."""
        end = time.monotonic() + seconds
        while True:
            for part in self._parts:
                if part.process is None or part.process.poll() is not None:
                    self._start(part)
            if time.monotonic() >= end:
                return
            time.sleep(min(POLL_SECONDS, max(0.0, end - time.monotonic())))

    def kill_one(self, kind: str, chance: random.Random) -> bool:
        """Kills a process of a kind, if one is there."""
        if kind == "compute":
            pids = sorted(self._compute_processes())
        else:
            pids = [p.process.pid for p in self._parts if p.kind == kind and p.process and p.process.poll() is None]
        if not pids:
            return False
        try:
            os.kill(chance.choice(pids), signal.SIGKILL)
        except ProcessLookupError:
            return False
        return True

    def counts(self) -> dict[str, int]:
        """Cases by state."""
        assert self._fleet is not None
        try:
            return Jobs(self._fleet.engine).counts()
        except SQLAlchemyError as error:
            return {f"unknown: {error}": 1}

    def stop(self) -> None:
        """Asks everything to end, in order."""
        for part in reversed(self._parts):
            if part.process is not None:
                processes.stop(part.process, 30.0)

    def kill(self) -> None:
        """Ends everything at once."""
        for part in self._parts:
            if part.process is not None:
                processes.kill_group(part.process)
        if self._fleet is not None:
            self._fleet.engine.dispose()

    def _start(self, part: Part) -> None:
        env = processes.environment(self.settings, **{MARKER: self.marker})
        with open(self.settings.data_folder / f"{part.kind}.log", "ab") as log:
            part.process = processes.start(part.command(), env, log)

    def _is_ready(self) -> bool:
        try:
            return httpx.get(f"{self.url}/readyz", timeout=5, trust_env=False).is_success
        except httpx.HTTPError:
            return False

    def _compute_processes(self) -> Iterator[int]:
        for pid, command in marked(self.marker):
            if "worker.compute" in command:
                yield pid


def marked(marker: str) -> Iterator[tuple[int, str]]:
    """(number, command) of every process of a run."""
    entry = f"{MARKER}={marker}".encode()
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            if entry in (folder / "environ").read_bytes().split(b"\0"):
                yield int(folder.name), (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # it has ended, or belongs to somebody else
