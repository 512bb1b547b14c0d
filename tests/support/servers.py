"""Servers that a test starts: an application in a thread, a program as a process. All on loopback."""

import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import uvicorn

from tests.support.waiting import wait_for

STOP_SECONDS = 20.0


@contextmanager
def served(app: Any, lifespan: str = "auto") -> Iterator[str]:
    """Address of an ASGI application on a free port, in a thread of this process.

    lifespan: "off" where somebody else has started the application
    """
    config = uvicorn.Config(
        app, host="127.0.0.1", port=0, lifespan=lifespan, log_level="warning", timeout_graceful_shutdown=1
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, name="server", daemon=True)
    thread.start()

    def has_started() -> bool:
        assert thread.is_alive(), "the server ended while it started"
        return server.started

    try:
        wait_for(has_started, "the start of the server", pause_seconds=0.005)
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(STOP_SECONDS)


def answers(url: str) -> bool:
    """Whether a GET of it succeeds."""
    try:
        return httpx.get(url, timeout=5.0).is_success
    except httpx.HTTPError:
        return False


def end(process: subprocess.Popen[Any], seconds: float = STOP_SECONDS) -> None:
    """Ends a process, by force where it does not end itself."""
    if process.poll() is not None:
        return
    os.kill(process.pid, signal.SIGCONT)
    process.terminate()
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def program(
    command: list[str],
    ready: Callable[[], object],
    log: Path,
    env: dict[str, str] | None = None,
    seconds: float = 60.0,
    cwd: Path | None = None,
) -> Iterator[subprocess.Popen[bytes]]:
    """A program, from when ``ready`` is true; ended at the end.

    log: takes what it prints
    seconds: that it may take to start
    cwd: the folder it runs in
    """
    with open(log, "ab") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=env, cwd=cwd, start_new_session=True
        )

    def is_ready() -> object:
        assert process.poll() is None, f"{command[0]} has ended: {log.read_text(errors='replace')}"
        return ready()

    try:
        wait_for(is_ready, f"the start of {command[0]}", seconds)
        yield process
    finally:
        end(process)


@contextmanager
def processes() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Starts processes whose output is dropped; ended in turn, the last one first."""
    with ExitStack() as stack:

        def start(command: list[str], env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
            stack.callback(end, process)
            return process

        yield start
