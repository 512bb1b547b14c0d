"""The Celery worker of the queue ``delivery``: a process of its own, so that no archive can hold up a simulation."""

from __future__ import annotations

import logging
import os
import socket
import threading
from functools import partial
from typing import Any

from celery import signals
from sqlalchemy.exc import SQLAlchemyError

from worker.contract import TASK_DELIVER
from worker.delivery.commitment import Listener
from worker.delivery.sender import Sender
from worker.messages import create_celery, work
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.records.fleet import BEAT_SECONDS, DELIVERY_PREFIX, Fleet
from worker.records.schema import prepare
from worker.settings import Settings
from worker.storage import open_store
from worker.upkeep.repeat import Repeated

log = logging.getLogger(__name__)


class DeliveryWorker:
    """The Celery application with its one task."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.stopping = threading.Event()
        engine = connect(settings.resolved_database_url)
        prepare(engine)
        self.name = f"{DELIVERY_PREFIX}{socket.gethostname()}:{os.getpid()}"
        self.fleet = Fleet(engine)
        beat = partial(self.fleet.beat, self.name, settings.delivery_slots)
        self._heart = Repeated("heartbeat", beat, BEAT_SECONDS, at_once=True)
        deliveries = Deliveries(engine, settings.lease_seconds)
        self.sender = Sender(self.name, settings, deliveries, open_store(settings), self.stopping)
        self.celery = create_celery(settings)
        self.celery.task(self._deliver, name=TASK_DELIVER)

        address = settings.commitment_address
        self.listener = Listener(address, self.sender.reports) if address else None

    def run(self) -> int:
        """Works until SIGTERM or SIGINT; the exit code."""
        signals.worker_ready.connect(self._ready, weak=False)
        signals.worker_shutting_down.connect(self._shutting_down, weak=False)
        try:
            return work(self.celery, "tomosim-delivery", ["delivery"], self.settings.delivery_slots, self.settings)
        finally:
            self.stopping.set()
            self._heart.stop(0.0)
            if self.listener is not None:
                self.listener.close()
            try:
                self.fleet.gone(self.name)
            except SQLAlchemyError:
                log.exception("the end of this worker was not recorded")

    def _deliver(self, identifier: str) -> None:
        # As in worker.compute.app: an exception would send the message round the workers; the row is the truth.
        try:
            self.sender.run(identifier)
        except Exception:
            log.exception("task failed", extra={"delivery": identifier})

    def _ready(self, **_: Any) -> None:
        self._heart.start()
        log.info("delivery worker ready", extra={"slots": self.settings.delivery_slots})

    def _shutting_down(self, **_: Any) -> None:
        self.stopping.set()
