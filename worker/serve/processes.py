"""Starting and ending child processes: each in a process group of its own, none outlives its parent."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from typing import IO

from simcore import children
from worker.serve import tether
from worker.settings import Settings


def environment(settings: Settings, **more: str) -> dict[str, str]:
    """Environment of a child: the settings, and where these packages lie (they need not be installed)."""
    return children.environment(**{**settings.environment(), **more})


def start(command: list[str], env: dict[str, str], output: IO[bytes] | int | None) -> subprocess.Popen[bytes]:
    """Starts a command that is killed when this process is gone; its output goes to ``output``.

    Called from a thread that lives as long as the process.
    """
    tethered = [sys.executable, "-I", "-S", tether.__file__, str(os.getpid()), *command]
    return subprocess.Popen(
        tethered,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT if output is not None else None,
        start_new_session=True,
    )


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kills the process and all it started, and waits for its end."""
    # As long as it was not waited for, its number belongs to nobody else.
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def stop(process: subprocess.Popen[bytes], patience_seconds: float) -> None:
    """Asks a process to end and kills it where it does not within ``patience_seconds``."""
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(patience_seconds)
    except subprocess.TimeoutExpired:
        kill_group(process)
