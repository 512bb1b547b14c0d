"""The compute process of a worker slot: ``python -m worker.compute <message descriptor> <parent pid>``.

Commands come in on standard input, messages go out on a descriptor of their own, both as lines of JSON; what
libraries print goes to standard error. It runs one case at a time and stays warm in between.

    in    {"specification": {...}, "log": {fields of its log lines}}
    out   {"type": "ready", "stages": [...]}
          {"type": "progress", "stage", "stages_done", "stages_total", "fraction", "message"}
          {"type": "succeeded", "manifest": {...}}
          {"type": "failed", "error": {"kind", "code", "message"}}
"""

from __future__ import annotations

import importlib
import json
import logging
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from typing import IO, Any

from simcore.core.errors import SimulationError
from simcore.spec import SimulationSpec
from simcore.store.store import Store
from tomosim_contract.names import internal_failure
from worker import logs
from worker.compute.memory import out_of_memory
from worker.serve.tether import die_with_parent
from worker.settings import Settings
from worker.storage import open_store

MIN_INTERVAL_SECONDS = 0.5
"""Progress within a stage is told no more often than this."""

OUT_OF_MEMORY_EXIT = 77
"""After a MemoryError the process ends: what is left of it may be in pieces."""

Json = dict[str, Any]

log = logging.getLogger("worker.compute")  # this module's own name is __main__


class Messages:
    """Lines of JSON to the supervisor."""

    def __init__(self, descriptor: int) -> None:
        os.set_inheritable(descriptor, False)  # children must not keep it open after this process has ended
        self._file = os.fdopen(descriptor, "wb", buffering=0)

    def send(self, kind: str, **content: Any) -> None:
        line = json.dumps({"type": kind, **content}, default=str).encode() + b"\n"
        view = memoryview(line)
        while view:
            view = view[self._file.write(view) :]


class Reporter:
    """Progress callback of the pipeline: counts stages and leaves out what comes too fast."""

    def __init__(self, messages: Messages, stages: list[str]) -> None:
        self._messages = messages
        self._stages = stages
        self._last: tuple[str, float] = ("", 0.0)
        self._began = 0.0
        self._logged = ""

    def __call__(self, stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
        if stage not in self._stages:
            self._stages = [*self._stages, stage]
        last_stage, last_time = self._last
        now = time.monotonic()
        if stage != last_stage:
            self._began = now
        if stage == last_stage and fraction < 1 and now - last_time < MIN_INTERVAL_SECONDS:
            return
        self._last = (stage, now)
        logs.add(stage=stage)
        done = fraction >= 1
        if done and stage != self._logged:
            self._logged = stage
            log.info("stage done", extra={"cached": cached, "seconds": round(now - self._began, 3)})
        self._messages.send(
            "progress",
            stage=stage,
            stages_done=self._stages.index(stage) + done,
            stages_total=len(self._stages),
            fraction=min(1.0, max(0.0, float(fraction))),
            message="from the store" if cached else message,
        )


def main() -> None:
    """Runs cases until standard input ends."""
    messages = Messages(int(sys.argv[1]))
    die_with_parent(int(sys.argv[2]))
    settings = Settings.load()
    commands = _take_standard_streams()
    logs.configure(settings.log_level)
    _limit_memory(settings.memory_limit)
    try:
        run, stages = _pipeline(settings.pipeline)
        store = open_store(settings)
    except Exception as error:  # said to the supervisor, which reports it as the failure of the next case
        log.exception("the pipeline or the store cannot be loaded")
        messages.send(
            "failed", error=error.to_dict() if isinstance(error, SimulationError) else internal_failure(error)
        )
        sys.exit(1)
    messages.send("ready", stages=stages)
    for line in commands:
        command = json.loads(line)
        with logs.context(**command["log"]):
            _run_case(run, store, command["specification"], messages, stages, settings)


def _run_case(
    run: Callable[..., Any],
    store: Store,
    specification: Json,
    messages: Messages,
    stages: list[str],
    settings: Settings,
) -> None:
    try:
        result = run(SimulationSpec.from_dict(specification), store, Reporter(messages, stages))
        messages.send("succeeded", manifest=result.manifest)
    except SimulationError as error:
        log.exception("case failed")
        messages.send("failed", error=error.to_dict())
    except MemoryError:
        log.exception("case failed")
        messages.send("failed", error=out_of_memory(settings.memory_limit))
        os._exit(OUT_OF_MEMORY_EXIT)
    except Exception as error:
        log.exception("case failed")
        messages.send("failed", error=internal_failure(error))


def _pipeline(name: str) -> tuple[Callable[..., Any], list[str]]:
    module_name, _, function = name.partition(":")
    module = importlib.import_module(module_name)
    return getattr(module, function), list(getattr(module, "STAGES", ()))


def _take_standard_streams() -> IO[bytes]:
    """Standard input for commands alone; what is printed goes to standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    commands = os.fdopen(os.dup(0), "rb")
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    return commands


def _limit_memory(limit: int) -> None:
    # RLIMIT_DATA counts private writable memory, which is what a case really uses. RLIMIT_AS would also count mapped
    # files (the store) and the address space that allocators and compilers only reserve.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


if __name__ == "__main__":
    main()
