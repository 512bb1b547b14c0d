"""Ties a process to its parent: it is killed when the parent is gone, however that came about.

As a script (``tether.py <parent pid> <command> ...``) it does so and becomes the command.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Linux sends SIGKILL when the thread that started this process ends; elsewhere nothing happens.

    parent: process that started this one; where it is gone already, this one ends at once.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


if __name__ == "__main__":
    die_with_parent(int(sys.argv[1]))
    os.execvp(sys.argv[2], sys.argv[2:])
