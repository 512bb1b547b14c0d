"""A worker slot: claims a case, has its compute process run it, and writes down how it ended.

Light: imports neither numba nor a stage. The compute process is killed when the case is cancelled, takes too long,
was lost to another worker or when the worker stops, and started again where it has ended.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from tomosim_contract.names import OUT_OF_MEMORY, TIMEOUT, failure, internal_failure
from worker import logs
from worker.compute.process import ComputeDiedError, ComputeProcess
from worker.compute.watch import Watch, write_end
from worker.records.database import AWAY, outlast
from worker.records.jobs import Jobs, Simulation, StageProgress
from worker.settings import Settings
from worker.storage import open_store

log = logging.getLogger(__name__)

POLL_SECONDS = 0.1
"""How long a slot waits for a message before it looks at the clock and whether the worker stops."""

Json = dict[str, Any]


class Slot:
    """One case at a time, on one warm compute process.

    stopping: set when the worker stops; the case goes back to the queue.
    """

    def __init__(self, name: str, settings: Settings, jobs: Jobs, stopping: threading.Event) -> None:
        self.name = name
        self.settings = settings
        self.jobs = jobs
        self.stopping = stopping
        self._store = open_store(settings)
        self._process: ComputeProcess | None = None

    def warm_up(self) -> ComputeProcess:
        """The compute process, started where there is none."""
        if self._process is None or not self._process.alive:
            self.kill()
            self._process = ComputeProcess(self.settings)
            log.info("compute process started", extra={"slot": self.name, "pid": self._process.pid})
        return self._process

    def kill(self) -> None:
        """Ends the compute process and all it started."""
        if self._process is not None:
            self._process.kill()
            self._store.remove_workspaces(self._process.pid)
            self._process = None

    def run(self, identifier: str) -> None:
        """Runs a queued simulation to its end. Does nothing where it is not queued: the message was late."""
        if self.stopping.is_set():
            self.jobs.mark_unsent(identifier)
            return
        # Never the same again: in a container a worker that starts anew has the name of the one before.
        owner = f"{self.name}/{uuid.uuid4().hex[:16]}"
        job = outlast(lambda: self.jobs.claim(identifier, owner), self.stopping.is_set)
        if job is None:
            log.info("not queued: message ignored", extra={"simulation": identifier})
            return
        with logs.context(**_log_fields(job)):
            self._run(job, owner)

    def _run(self, job: Simulation, owner: str) -> None:
        log.info("started")
        try:
            specification = outlast(lambda: self.jobs.specification(job.id), self.stopping.is_set)
            finish = self._supervise(job, owner, specification)
        except AWAY:
            raise  # not the case's doing: its lease runs out
        except Exception as error:
            log.exception("supervision failed")
            self.kill()
            finish = self._failure(job, owner, internal_failure(error))
        kept = bool(write_end(finish, self.stopping))
        log.info("ended", extra={"kept": kept})
        if not self.stopping.is_set():
            self.warm_up()

    def _supervise(self, job: Simulation, owner: str, specification: Json) -> Callable[[], bool]:
        """Watches over one case; returns what is to be written in the end."""
        watch = _Watch(self.jobs, job.id, owner, self.settings)
        try:
            process = self.warm_up()
            if process.ready:
                process.run(specification, _log_fields(job))
            while True:
                message = process.receive(POLL_SECONDS)
                if self.stopping.is_set():
                    self.kill()
                    return lambda: self.jobs.release(job.id, owner)
                match watch.verdict():
                    case "running":
                        pass
                    case "cancelling":
                        self.kill()
                        return lambda: self.jobs.cancelled(job.id, owner)
                    case "late":
                        self.kill()
                        return self._failure(job, owner, _timeout(self.settings.job_timeout_seconds))
                    case _:
                        self.kill()
                        return _nothing_to_write
                match message and message["type"]:
                    case "ready":
                        process.run(specification, _log_fields(job))
                    case "progress":
                        watch.progress(_stage_progress(message or {}))
                    case "succeeded":
                        manifest = (message or {})["manifest"]
                        return lambda: self.jobs.succeed(job.id, owner, manifest)
                    case "failed":
                        error = (message or {})["error"]
                        if error["code"] == OUT_OF_MEMORY:
                            self.kill()
                        return self._failure(job, owner, error)
        except ComputeDiedError as died:
            error = died.error
            log.warning("compute process ended", extra={"error": error})
            self.kill()
            if not died.may_be_chance:
                return self._failure(job, owner, error)
            if job.attempt < self.settings.max_attempts:
                return lambda: self.jobs.try_again(job.id, owner, error)
            return self._failure(job, owner, _crashed_every_time(error, job.attempt))

    def _failure(self, job: Simulation, owner: str, error: Json) -> Callable[[], bool]:
        return lambda: self.jobs.fail(job.id, owner, error)


class _Watch(Watch):
    """A watch that records progress as well."""

    def __init__(self, jobs: Jobs, identifier: str, owner: str, settings: Settings) -> None:
        super().__init__(jobs, identifier, owner, settings.job_timeout_seconds, outlasts=True)
        self.jobs = jobs

    def progress(self, progress: StageProgress) -> None:
        """Records progress; the next ``verdict`` says where that was refused."""
        try:
            if self.jobs.progress(self.identifier, self.owner, progress):
                self.renewed = time.monotonic()
        except SQLAlchemyError:
            log.exception("progress not recorded")


class Slots:
    """The slots of one worker."""

    def __init__(self, worker: str, settings: Settings, jobs: Jobs, stopping: threading.Event) -> None:
        self._all = [Slot(f"{worker}/{number}", settings, jobs, stopping) for number in range(settings.worker_slots)]
        self._free: queue.SimpleQueue[Slot] = queue.SimpleQueue()
        for slot in self._all:
            self._free.put(slot)

    def warm_up(self) -> None:
        """Starts every compute process."""
        for slot in self._all:
            slot.warm_up()

    def run(self, identifier: str) -> None:
        """Runs a simulation on a free slot."""
        slot = self._free.get()
        try:
            slot.run(identifier)
        finally:
            self._free.put(slot)

    def kill(self) -> None:
        """Ends every compute process."""
        for slot in self._all:
            slot.kill()


def _log_fields(job: Simulation) -> Json:
    """What stands in every line about a case, here and in the compute process."""
    return {"simulation": job.id, "attempt": job.attempt, "request": job.request_id}


def _nothing_to_write() -> bool:
    return False


def _stage_progress(message: Json) -> StageProgress:
    return StageProgress(**{key: value for key, value in message.items() if key != "type"})


def _crashed_every_time(error: Json, attempts: int) -> Json:
    return {**error, "message": f"{error['message']} (attempt {attempts}, the last one)"}


def _timeout(seconds: float) -> Json:
    text = (
        f"the case ran longer than the {seconds:g} s it may take; stages that finished are kept: retry, ask for less, "
        "or raise TOMOSIM_JOB_TIMEOUT_SECONDS"
    )
    return failure(TIMEOUT, text)
