"""``tomosim serve``: broker, worker and API as one process tree on one data folder.

The tree stands and falls together: children are killed with their parent (serve.tether); a child that ends by
itself is started again, and where that happens too often everything stops with a message that names its log.
Ctrl-C or SIGTERM stops in order: the API, the worker (its running cases go back to the queue; stages that finished
are kept), the broker. A second signal ends everything at once.
"""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO

from sqlalchemy.exc import SQLAlchemyError

from simcore.children import command
from simcore.core.errors import SimulationError
from worker.records import schema
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.records.jobs import Jobs
from worker.records.keys import Keys, check_address
from worker.serve import broker, processes
from worker.settings import Settings

START_SECONDS = 60.0
STOP_SECONDS = 20.0
POLL_SECONDS = 0.1

# A child may end this often within this time before everything stops.
MAX_RESTARTS = 3
RESTART_WINDOW_SECONDS = 60.0

MAX_LOG_BYTES = 10_000_000


class ServeError(SimulationError):
    """The service cannot start or go on; the message says why."""

    kind = "system"
    code = "service-failed"


@dataclass
class Child:
    """A child process that is started again when it ends."""

    name: str
    command: Callable[[], list[str]]
    env: dict[str, str]
    log: Path
    # Called when it has ended by itself, before it is started again.
    ended: Callable[[], None] | None = None
    process: subprocess.Popen[bytes] | None = None
    ends: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_RESTARTS + 1))

    def start(self) -> None:
        with open(self.log, "ab") as output:
            self.process = processes.start(self.command(), self.env, output)

    def revive(self) -> None:
        """Starts it again where it has ended. raises: ServeError where that happens too often"""
        if self.process is None or self.process.poll() is None:
            return
        code = self.process.returncode
        self.ends.append(time.monotonic())
        if len(self.ends) > MAX_RESTARTS and self.ends[-1] - self.ends[0] < RESTART_WINDOW_SECONDS:
            raise ServeError(f"the {self.name} ended {len(self.ends)} times {self.explanation(code)}")
        _say(f"the {self.name} ended (exit code {code}) and is started again; see {self.log}")
        if self.ended is not None:
            self.ended()
        self.start()

    def explanation(self, code: int | None) -> str:
        return f"(exit code {code}); the end of {self.log}:\n{_tail(self.log)}"

    def stop(self) -> None:
        if self.process is not None:
            processes.stop(self.process, STOP_SECONDS)
            self.process = None

    def kill(self) -> None:
        if self.process is not None:
            processes.kill_group(self.process)


class _Stopped(Exception):
    """A signal asked to stop."""


def serve(settings: Settings) -> int:
    """Runs the service until Ctrl-C or SIGTERM. Called in the main thread.

    returns: 0 after an ordered stop, 1 where it could not start or go on (said on standard error).
    """
    try:
        lock = _lock_folder(settings.data_folder)
    except SimulationError as error:
        _say(str(error))
        return 1
    with lock:
        children: list[Child] = []
        signals = _Signals()
        try:
            _start_all(settings, children, signals)
            print(f"tomosim is ready: {_address(settings)}", flush=True)
            while True:
                signals.sleep(POLL_SECONDS)
                for child in children:
                    child.revive()
        except _Stopped:
            _say("stopping")
            return 0
        except SimulationError as error:
            _say(str(error))
            return 1
        finally:
            signals.on_second(lambda: _kill_all(children))
            for child in reversed(children):
                child.stop()
            signals.restore()


def _kill_all(children: list[Child]) -> None:
    for child in children:
        child.kill()


class _Signals:
    """SIGINT and SIGTERM as an exception at a place of our choice; a second one does what ``on_second`` was given."""

    def __init__(self) -> None:
        self.count = 0
        self._second: Callable[[], object] | None = None
        self._before = {s: signal.signal(s, self._receive) for s in (signal.SIGINT, signal.SIGTERM)}

    def _receive(self, number: int, frame: object) -> None:
        self.count += 1
        if self.count > 1 and self._second is not None:
            self._second()

    def on_second(self, action: Callable[[], object]) -> None:
        self._second = action

    def sleep(self, seconds: float) -> None:
        """raises: _Stopped where a signal came."""
        if self.count:
            raise _Stopped
        time.sleep(seconds)
        if self.count:
            raise _Stopped

    def restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def _start_all(settings: Settings, children: list[Child], signals: _Signals) -> None:
    """Starts broker, worker and API, in this order, and waits until the API says that all is well."""
    _check_port(settings)
    logs = settings.data_folder / "logs"
    logs.mkdir(exist_ok=True)
    _prepare_database(settings)
    expire = partial(_expire_leases, settings, Jobs)
    expire_deliveries = partial(_expire_leases, settings, Deliveries)
    expire()
    expire_deliveries()
    env = processes.environment(settings, TOMOSIM_BROKER_URL=settings.resolved_broker_url)
    # Who may ask is the business of the API alone.
    keyless = {**env, "TOMOSIM_ADMIN_KEY": "", "TOMOSIM_ADMIN_KEY_FILE": ""}

    def child(name: str, command: Callable[[], list[str]], env: dict[str, str] = keyless) -> Child:
        log = logs / f"{name}.log"
        if log.exists() and log.stat().st_size > MAX_LOG_BYTES:
            log.replace(log.with_suffix(".log.1"))
        started = Child(name, command, env, log)
        started.start()
        children.append(started)
        return started

    if not settings.broker_url:
        server = child("broker", lambda: broker.command(settings))
        _wait(lambda: broker.answers(settings), server, signals)
    child("worker", lambda: command("worker")).ended = expire
    child("delivery", lambda: command("worker.delivery")).ended = expire_deliveries
    api = child("api", lambda: command("api"), env)
    _wait(lambda: _is_ready(settings), api, signals, children)


def _prepare_database(settings: Settings) -> None:
    engine = connect(settings.resolved_database_url)
    try:
        schema.prepare(engine)
        check_address(settings, Keys(engine))
    except SQLAlchemyError as error:
        raise ServeError(f"the database cannot be used: {error}") from error
    finally:
        engine.dispose()


def _expire_leases(settings: Settings, repository: type[Jobs] | type[Deliveries]) -> None:
    """The cases (or deliveries) of a worker that is gone are taken up at once, not when their leases run out."""
    if settings.database_url:
        return  # other machines may work for this database; ours alone is the one in our folder
    engine = connect(settings.resolved_database_url)
    try:
        repository(engine).expire_leases()
    except SQLAlchemyError as error:
        _say(f"the database does not answer: {error}")
    finally:
        engine.dispose()


def _wait(condition: Callable[[], bool], child: Child, signals: _Signals, others: list[Child] | None = None) -> None:
    """Waits for a condition. raises: ServeError where a child ends meanwhile or it takes too long"""
    deadline = time.monotonic() + START_SECONDS
    while not condition():
        for one in [child, *(others or [])]:
            if one.process is not None and one.process.poll() is not None:
                raise ServeError(f"the {one.name} did not start {one.explanation(one.process.returncode)}")
        if time.monotonic() > deadline:
            raise ServeError(f"not ready after {START_SECONDS:g} s; see the logs in {child.log.parent}")
        signals.sleep(POLL_SECONDS)


def _lock_folder(folder: Path) -> IO[str]:
    """The lock of a data folder, held until it is closed or this process ends.

    raises: ServeError where another instance has it
    """
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = open(folder / "lock", "a+")  # noqa: SIM115 - stays open
    except OSError as error:
        raise ServeError(f"the data folder {folder} cannot be used: {error.strerror}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        pid = lock.read().strip() or "unknown"
        lock.close()
        raise ServeError(
            f"the data folder {folder} is in use by another tomosim (process {pid}): stop that one, or choose "
            "another folder with TOMOSIM_DATA_FOLDER"
        ) from None
    lock.truncate(0)
    lock.write(f"{os.getpid()}\n")
    lock.flush()
    return lock


def _check_port(settings: Settings) -> None:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.host.strip("[]"), settings.port))
        except OSError as error:
            raise ServeError(
                f"port {settings.port} of {settings.host} cannot be used ({error.strerror}): choose another one with "
                "TOMOSIM_PORT"
            ) from None


def _address(settings: Settings) -> str:
    host = settings.host.strip("[]")
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://{f'[{host}]' if ':' in host else host}:{settings.port}"


def _is_ready(settings: Settings) -> bool:
    try:
        # No proxy of the environment: the address is our own.
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(f"{_address(settings)}/readyz", timeout=5) as response:
            return bool(response.status == 200)
    except (urllib.error.URLError, OSError):
        return False


def _tail(log: Path, lines: int = 15) -> str:
    try:
        return "\n".join(log.read_text(errors="replace").splitlines()[-lines:])
    except OSError:
        return ""


def _say(message: str) -> None:
    print(f"tomosim: {message}", file=sys.stderr, flush=True)


def main() -> int:
    """``python -m worker.serve.embedded``: the whole service with the settings of the environment."""
    try:
        settings = Settings.load()
    except SimulationError as error:
        _say(str(error))
        return 1
    return serve(settings)


if __name__ == "__main__":
    sys.exit(main())
