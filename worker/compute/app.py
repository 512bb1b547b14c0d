"""The Celery worker: a thin supervisor. It never imports numba; each slot owns a compute process that does.

The pool is ``threads``: one thread a slot. The main thread stays free for signals, so that a worker that is asked to
stop gives its cases back at once instead of waiting for their end.
"""

from __future__ import annotations

import logging
import os
import socket
from functools import partial
from typing import Any

from celery import Celery, signals
from sqlalchemy.exc import SQLAlchemyError

from worker import logs
from worker.compute.supervisor import Slots
from worker.contract import TASK_SIMULATE
from worker.messages import create_celery, work
from worker.records import schema
from worker.records.database import connect
from worker.records.fleet import BEAT_SECONDS, Fleet
from worker.records.jobs import Jobs
from worker.settings import Settings
from worker.storage import open_store
from worker.upkeep.repeat import Repeated

log = logging.getLogger(__name__)


class Worker:
    """The Celery application with its task, its slots and its heartbeat."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.name = f"{socket.gethostname()}:{os.getpid()}"
        engine = connect(settings.resolved_database_url)
        schema.prepare(engine)
        self.fleet = Fleet(engine)
        self.slots = Slots(self.name, settings, Jobs(engine, settings.lease_seconds))
        self.celery = create_celery(settings)
        self.celery.task(self._simulate, name=TASK_SIMULATE)
        beat = partial(self.fleet.beat, self.name, settings.worker_slots)
        self._heart = Repeated("heartbeat", beat, BEAT_SECONDS, at_once=True)

    def run(self) -> int:
        """Works until SIGTERM or SIGINT; the exit code."""
        signals.worker_ready.connect(self._ready, weak=False)
        signals.worker_shutting_down.connect(self._shutting_down, weak=False)
        open_store(self.settings).sweep_temporary()
        try:
            return work(self.celery, "tomosim", self.settings.queue_names, self.settings.worker_slots, self.settings)
        finally:
            self.slots.stopping.set()
            self._heart.stop(0.0)
            self.slots.kill()
            try:
                self.fleet.gone(self.name)
            except SQLAlchemyError:
                log.exception("the end of this worker was not recorded")

    def _simulate(self, identifier: str) -> None:
        # An exception that leaves a task makes Celery send the message round the workers. The row is the truth: its
        # lease runs out and the sweep takes it back.
        try:
            self.slots.run(identifier)
        except Exception:
            log.exception("task failed", extra={"simulation": identifier})

    def _ready(self, **_: Any) -> None:
        self.slots.warm_up()
        self._heart.start()
        log.info("worker ready", extra={"worker": self.name, "slots": self.settings.worker_slots})

    def _shutting_down(self, **_: Any) -> None:
        self.slots.stopping.set()


def main() -> int:
    """``python -m worker``: a worker with the settings of the environment."""
    settings = Settings.load()
    logs.configure(settings.log_level)
    return Worker(settings).run()


def __getattr__(name: str) -> Celery:
    """``celery -A worker.compute.app ...``: the application is made when first asked for, not at import."""
    if name == "app":
        return create_celery(Settings.load())
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
