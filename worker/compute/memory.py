"""How a compute process that ran out of memory is told from one that crashed: both end by a signal.

A case that needs more than it may have would end so again; a crash may be chance. Python and numpy raise MemoryError,
which worker.compute tells itself. What C++ and Rust cannot allocate ends in abort() after a line on standard error, and
a machine or container without memory sends SIGKILL, which only the kernel's count tells from any other.
"""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import Any

from tomosim_contract.names import OUT_OF_MEMORY, failure

_LAST_WORDS = re.compile(
    rb"std::bad_alloc|std::bad_array_new_length"  # the C++ runtime, of an exception that nobody caught
    rb"|memory allocation of \d+ bytes failed"  # Rust
    rb"|LLVM ERROR: out of memory"
)

_PROC = Path("/proc/self/cgroup")
_ROOT = Path("/sys/fs/cgroup")


def out_of_memory(limit: int) -> dict[str, Any]:
    """The error of a case that asked for more memory than it may use [byte]."""
    text = (
        f"the case needed more than the {limit / 1e9:.1f} GB of memory it may use: take larger voxels, fewer views or "
        "thicker slices, or raise TOMOSIM_MEMORY_LIMIT_BYTES"
    )
    return failure(OUT_OF_MEMORY, text)


def machine_out_of_memory(limit: int) -> dict[str, Any]:
    """The error of a case whose process the kernel killed before it had used what it may [byte]."""
    text = (
        "the machine or container had no memory left and the kernel killed the compute process, which may use "
        f"{limit / 1e9:.1f} GB: lower TOMOSIM_MEMORY_LIMIT_BYTES or TOMOSIM_WORKER_SLOTS to what there is, give it "
        "more memory, or take larger voxels or fewer views"
    )
    return failure(OUT_OF_MEMORY, text)


def explain(code: int, last_words: bytes, limit: int, kernel_killed: bool) -> dict[str, Any] | None:
    """The error of a process that ended with this exit code where that was for want of memory, else None.

    code: negative: by that signal. last_words: the end of its standard error. kernel_killed: whether the kernel has
    killed a process for want of memory while the case ran.
    """
    if code == -signal.SIGABRT and _LAST_WORDS.search(last_words):
        return out_of_memory(limit)
    if code == -signal.SIGKILL and kernel_killed:
        return machine_out_of_memory(limit)
    return None


def kernel_kills() -> int:
    """How many processes of our control group the kernel has killed so far for want of memory; 0: it does not say."""
    for path in _counters():
        try:
            lines = path.read_text().splitlines()
        except OSError:
            continue
        for line in lines:
            name, _, number = line.partition(" ")
            if name == "oom_kill":
                return int(number)
    return 0


def _counters() -> list[Path]:
    """Files that may hold the count: of cgroup v2 and v1, and as they look from inside of a container."""
    try:
        lines = _PROC.read_text().splitlines()
    except OSError:
        return []
    files = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        inside = path.lstrip("/")
        if controllers == "":
            files += [_ROOT / inside / "memory.events", _ROOT / "memory.events"]
        elif "memory" in controllers.split(","):
            files += [_ROOT / "memory" / inside / "memory.oom_control", _ROOT / "memory" / "memory.oom_control"]
    return files
