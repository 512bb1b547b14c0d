"""What a child writes to standard error goes on to our own; the end of it is remembered."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import IO

KEPT_BYTES = 4096

PATIENCE_SECONDS = 1.0
"""What was written before the end of a process is read within this time."""


class LastWords:
    """Passes on what comes from a pipe, in a thread of its own, until nobody can write to it any more."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe = pipe
        self._kept = b""
        self._thread = threading.Thread(target=self._pass_on, name="standard-error", daemon=True)
        self._thread.start()

    def forget(self) -> None:
        """What was written so far belongs to a case before."""
        self._kept = b""

    def read(self) -> bytes:
        """The end of what was written. For a process that has ended."""
        self._thread.join(PATIENCE_SECONDS)
        return self._kept

    def _pass_on(self) -> None:
        with self._pipe:
            while chunk := os.read(self._pipe.fileno(), 1 << 16):
                self._kept = (self._kept + chunk)[-KEPT_BYTES:]
                view = memoryview(chunk)
                # Where nobody reads ours any more, the child must not be held up by that.
                with contextlib.suppress(OSError):
                    while view:
                        view = view[os.write(2, view) :]
