"""A process that works for queues of the broker: one Celery task, a heartbeat, an ordered end.

The pool is ``threads``: one thread a slot. The main thread stays free for signals, so that a worker that is asked to
stop gives its rows back at once instead of waiting for their end.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

from celery import signals
from sqlalchemy.exc import SQLAlchemyError

from worker.messages import create_celery
from worker.records import schema
from worker.records.database import connect
from worker.records.fleet import BEAT_SECONDS, Fleet
from worker.settings import Settings
from worker.upkeep.repeat import Repeated

log = logging.getLogger(__name__)


class QueueWorker:
    """The base of every kind of worker. stopping: set as soon as it is asked to stop."""

    kind: ClassVar[str]
    what: ClassVar[str]
    """What a row is called in log lines."""

    task: ClassVar[str]
    """Name of the Celery task; its argument is the identifier of a row."""

    prefix: ClassVar[str] = ""
    """How the names of such workers begin (``records.fleet``)."""

    def __init__(self, settings: Settings, queues: Sequence[str], slots: int) -> None:
        self.settings = settings
        self.queues = queues
        self.slots_count = slots
        self.stopping = threading.Event()
        self.name = f"{self.prefix}{socket.gethostname()}:{os.getpid()}"
        self.engine = connect(settings.resolved_database_url)
        schema.prepare(self.engine)
        self.fleet = Fleet(self.engine)
        self.celery = create_celery(settings)
        self.celery.task(self._take, name=self.task)
        self._heart = Repeated("heartbeat", partial(self.fleet.beat, self.name, slots), BEAT_SECONDS, at_once=True)

    def carry_out(self, identifier: str) -> None:
        """Does what a message asks for."""
        raise NotImplementedError

    def warm_up(self) -> None:
        """Called before the first message is taken."""

    def end(self) -> None:
        """Called when no message is taken any more."""

    def run(self) -> int:
        """Works until SIGTERM or SIGINT; the exit code."""
        signals.worker_ready.connect(self._ready, weak=False)
        signals.worker_shutting_down.connect(self._shutting_down, weak=False)
        options = [
            "--quiet",
            "worker",
            "--pool=threads",
            f"--concurrency={self.slots_count}",
            f"--queues={','.join(self.queues)}",
            f"--hostname={self.kind}-{os.getpid()}@%h",
            f"--loglevel={self.settings.log_level}",
            "--without-gossip",
            "--without-mingle",
            "--without-heartbeat",
        ]
        try:
            self.celery.worker_main(options)
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            self.stopping.set()
            self._heart.stop(1.0)
            self.end()
            try:
                self.fleet.gone(self.name)
            except SQLAlchemyError:
                log.exception("the end of this worker was not recorded")
        return 0

    def _take(self, identifier: str) -> None:
        # An exception that leaves a task makes Celery send the message round the workers. The row is the truth: its
        # lease runs out and the sweep takes it back.
        try:
            self.carry_out(identifier)
        except Exception:
            log.exception("task failed", extra={self.what: identifier})

    def _ready(self, **_: Any) -> None:
        self.warm_up()
        self._heart.start()
        log.info("worker ready", extra={"worker": self.name, "slots": self.slots_count})

    def _shutting_down(self, **_: Any) -> None:
        self.stopping.set()
