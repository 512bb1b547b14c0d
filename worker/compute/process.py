"""A compute process seen from its worker slot: start, send a case, read messages, kill."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import time
from typing import Any

from simcore.children import command
from tomosim_contract.names import COMPUTE_CRASHED, failure
from worker.compute import memory
from worker.compute.last_words import LastWords
from worker.serve import processes
from worker.settings import Settings

Json = dict[str, Any]

EXIT_SECONDS = 5.0
"""A process that has closed its messages should end within this time."""


class ComputeDiedError(Exception):
    """The process ended before it had told the outcome.

    error: says how it ended. may_be_chance: it was killed or crashed, and perhaps will not the next time.
    """

    def __init__(self, error: Json, *, may_be_chance: bool) -> None:
        self.error = error
        self.may_be_chance = may_be_chance
        super().__init__(error["message"])


class ComputeProcess:
    """A running ``python -m worker.compute``. Made in a thread that lives as long as the worker."""

    def __init__(self, settings: Settings) -> None:
        threads = str(settings.threads)
        env = processes.environment(
            settings,
            NUMBA_NUM_THREADS=threads,
            OMP_NUM_THREADS=threads,
            OPENBLAS_NUM_THREADS=threads,
            MKL_NUM_THREADS=threads,
        )
        reader, writer = os.pipe()
        try:
            self._process = subprocess.Popen(
                command("worker.compute", str(writer), str(os.getpid())),
                env=env,
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=[writer],
                start_new_session=True,
            )
        finally:
            os.close(writer)
        assert self._process.stderr is not None
        self._last_words = LastWords(self._process.stderr)
        self._memory_limit = settings.memory_limit
        self._kernel_kills = 0
        self._reader = reader
        self._buffer = b""
        self._closed = False
        self.ready = False

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return not self._closed and self._process.poll() is None

    def run(self, specification: Json, log_fields: Json) -> None:
        """Hands over a case; for a process that is ready. log_fields: stand in the lines it logs.

        raises: ComputeDiedError
        """
        assert self._process.stdin is not None
        self._last_words.forget()
        self._kernel_kills = memory.kernel_kills()
        try:
            self._process.stdin.write(json.dumps({"specification": specification, "log": log_fields}).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise self._died() from None

    def receive(self, timeout_seconds: float) -> Json | None:
        """The next message, or None where none came in time.

        raises: ComputeDiedError
        """
        deadline = time.monotonic() + timeout_seconds
        while b"\n" not in self._buffer:
            left = max(0.0, deadline - time.monotonic())
            if not select.select([self._reader], [], [], left)[0]:
                return None
            chunk = os.read(self._reader, 1 << 20)
            if not chunk:
                raise self._died()
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\n")
        message: Json = json.loads(line)
        self.ready = self.ready or message["type"] == "ready"
        return message

    def kill(self) -> None:
        """Ends it and all it started, at once."""
        processes.kill_group(self._process)
        if not self._closed:
            self._closed = True
            os.close(self._reader)
            assert self._process.stdin is not None
            with contextlib.suppress(OSError):
                self._process.stdin.close()
            self._last_words.read()

    def _died(self) -> ComputeDiedError:
        try:
            code = self._process.wait(EXIT_SECONDS)
        except subprocess.TimeoutExpired:
            code = 0
        killed = memory.kernel_kills() > self._kernel_kills
        error = memory.explain(code, self._last_words.read(), self._memory_limit, killed)
        return ComputeDiedError(error or crash_error(code), may_be_chance=error is None and code < 0)


def crash_error(code: int) -> Json:
    """The error of a case whose process ended with this exit code (negative: by that signal)."""
    if code == -signal.SIGKILL:
        what = "was killed (SIGKILL); the system does so where the machine has no memory left"
        advice = "take larger voxels or fewer views, run fewer cases at a time, or retry"
    elif code < 0:
        what = f"crashed with {signal.Signals(-code).name}"
        advice = "see the worker's log; retry, and report it with the specification where it happens again"
    else:
        what = f"ended with exit code {code}"
        advice = "see the worker's log"
    return failure(COMPUTE_CRASHED, f"the compute process {what}: {advice}")
