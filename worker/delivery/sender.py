"""Carrying out a delivery: claims the row, sends what is missing, writes down every answer, ends or postpones it."""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable

from sqlalchemy.exc import SQLAlchemyError

from simcore.store.store import Store
from tomosim_contract.names import failure, internal_failure
from worker.compute.watch import Watch, write_end
from worker.delivery.commitment import Reports
from worker.delivery.tour import Tools, Tour
from worker.records.database import AWAY, Result, outlast
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Delivery, Instance
from worker.records.destinations import Destinations
from worker.records.rows import Json, NotFoundError
from worker.settings import Settings

log = logging.getLogger(__name__)

POLL_SECONDS = 0.1
PROGRESS_SECONDS = 5.0


class Sender:
    """Carries out deliveries, any number at a time.

    stopping: set when the worker stops; deliveries go back to the queue.
    """

    def __init__(
        self, name: str, settings: Settings, deliveries: Deliveries, store: Store, stopping: threading.Event
    ) -> None:
        self.name = name
        self.settings = settings
        self.deliveries = deliveries
        self.destinations = Destinations(deliveries.engine, deliveries.clock)
        self.store = store
        self.stopping = stopping
        self.reports = Reports()
        self._tools = Tools(settings, deliveries, store, self.reports)

    def run(self, identifier: str) -> None:
        """Carries out a queued delivery. Does nothing where it is not due, or its destination is taken."""
        owner = f"{self.name}/{uuid.uuid4().hex[:16]}"  # never the same again, as in compute.supervisor
        row = None if self.stopping.is_set() else self._outlast(lambda: self.deliveries.claim(identifier, owner))
        if row is None:
            self.deliveries.mark_unsent(identifier)  # the sweep sends it when it is due
            return
        log.info("delivery started", extra={"delivery": identifier, "attempt": row.attempt})
        try:
            finish = self._carry_out(row, owner)
        except AWAY:
            raise  # not the delivery's doing: its lease runs out
        except Exception as error:
            log.exception("delivery failed", extra={"delivery": identifier})
            failure = internal_failure(error)
            finish = lambda: self.deliveries.fail(identifier, owner, failure)  # noqa: E731
        kept = bool(write_end(finish, self.stopping))
        log.info("delivery ended", extra={"delivery": identifier, "kept": kept})

    def _carry_out(self, row: Delivery, owner: str) -> Callable[[], object]:
        """Sends what is missing; returns what is to be written in the end."""
        identifier = row.id
        try:
            destination = self._outlast(lambda: self.destinations.get(row.destination_id)).definition
        except NotFoundError:
            gone = failure("destination-not-found", f"the destination {row.destination_name!r} was removed", "user")
            return lambda: self.deliveries.fail(identifier, owner, gone)
        with self.store.workspace() as folder:
            tour = Tour(self._tools, row, destination, folder)
            verdict = self._watch_over(tour, owner)
        if self.stopping.is_set():
            return lambda: self.deliveries.release(identifier, owner)
        if verdict == "cancelling":
            return lambda: self.deliveries.cancelled(identifier, owner)
        if verdict != "running":
            return lambda: None
        if tour.refusal is not None:
            refusal = tour.refusal
            return lambda: self.deliveries.fail(identifier, owner, refusal)
        waiting = self._outlast(lambda: self.deliveries.instances(identifier, state="waiting", limit=1))
        if tour.uncommitted or waiting:
            limits = destination.limits
            trouble = tour.trouble or failure("not-finished", "not every instance was sent")
            return lambda: self.deliveries.postpone(identifier, owner, trouble, limits.attempts, limits.backoff_seconds)
        failed = self._outlast(lambda: self.deliveries.instances(identifier, state="failed"))
        if failed:
            return lambda: self.deliveries.fail(identifier, owner, _some_failed(failed, row.instances))
        return lambda: self.deliveries.succeed(identifier, owner)

    def _watch_over(self, tour: Tour, owner: str) -> str:
        """Runs a tour on its own threads; how it stood when it ended."""
        watch = Watch(self.deliveries, tour.row.id, owner, float("inf"))
        tour.start()
        verdict, spoke = "running", time.monotonic()
        while tour.is_alive():
            tour.join(POLL_SECONDS)
            verdict = watch.verdict()
            if verdict != "running" or self.stopping.is_set():
                tour.stop()
                break
            if time.monotonic() - spoke > PROGRESS_SECONDS:
                spoke = time.monotonic()
                self._tell(tour, owner)
        tour.join(None)
        return verdict

    def _tell(self, tour: Tour, owner: str) -> None:
        try:
            self.deliveries.progress(tour.row.id, owner, f"{tour.bytes_sent / 1e6:.0f} MB sent")
        except SQLAlchemyError:
            log.exception("progress not recorded", extra={"delivery": tour.row.id})

    def _outlast(self, action: Callable[[], Result]) -> Result:
        return outlast(action, self.stopping.is_set)


def _some_failed(failed: list[Instance], count: int) -> Json:
    first = failed[0]
    text = f"{len(failed)} of {count} instances were not stored; {first.name}: {first.message}"
    return failure(first.code if len({i.code for i in failed}) == 1 and first.code else "instances-failed", text)
