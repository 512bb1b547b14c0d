"""What the endpoints work with, and how a posted specification is read."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request

from api.http.errors import ApiError
from api.http.rates import Rates
from simcore.store.store import Store
from worker.messages import CeleryMessenger, Messenger
from worker.records import schema
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Delivery
from worker.records.destinations import Destinations
from worker.records.fleet import Fleet
from worker.records.idempotency import Idempotency
from worker.records.jobs import Jobs, Simulation
from worker.records.keys import Keys, check_address
from worker.records.leases import Leases
from worker.records.retention import Retention
from worker.records.rows import NotFoundError, StateError
from worker.records.studies import Studies
from worker.records.webhooks import Webhooks
from worker.settings import Settings
from worker.storage import open_store

log = logging.getLogger(__name__)

Lease = TypeVar("Lease", Simulation, Delivery)


@dataclass(frozen=True)
class Services:
    """The truth (jobs, studies, fleet), the broker and the files."""

    settings: Settings
    jobs: Jobs
    studies: Studies
    idempotency: Idempotency
    fleet: Fleet
    keys: Keys
    rates: Rates
    messenger: Messenger
    store: Store

    @classmethod
    def open(cls, settings: Settings, messenger: Messenger | None = None) -> Services:
        """Connects to the database (a SQLite one is brought up to date) and opens the store.

        raises: SettingsError where the address needs API keys and there are none.
        """
        engine = connect(settings.resolved_database_url)
        schema.prepare(engine)
        keys = Keys(engine)
        check_address(settings, keys)
        jobs = Jobs(engine, settings.lease_seconds)
        return cls(
            settings,
            jobs,
            Studies(jobs),
            Idempotency(engine, settings.idempotency_seconds),
            Fleet(engine),
            keys,
            Rates(settings),
            messenger or CeleryMessenger(settings),
            open_store(settings),
        )

    @property
    def retention(self) -> Retention:
        """The repository of pins."""
        return Retention(self.jobs.engine, self.jobs.clock)

    @property
    def webhooks(self) -> Webhooks:
        """The repository of webhooks."""
        return Webhooks(self.jobs.engine, self.jobs.clock)

    @property
    def destinations(self) -> Destinations:
        """The repository of destinations."""
        return Destinations(self.jobs.engine, self.jobs.clock)

    @property
    def deliveries(self) -> Deliveries:
        """The repository of deliveries."""
        return Deliveries(self.jobs.engine, self.jobs.lease_seconds, self.jobs.clock)

    def cancel(self, leases: Leases[Lease], identifier: str) -> Lease:
        """Cancels a case or a delivery. raises: NotFoundError; ApiError 409 where it has ended"""
        try:
            return leases.cancel(identifier)
        except StateError as error:
            detail = f"the {leases.what} has {error.state}; there is nothing to cancel"
            raise ApiError(409, "already-finished", detail) from None

    def retry(self, leases: Leases[Lease], identifier: str) -> Lease:
        """Queues a case or a delivery again. raises: NotFoundError; ApiError 409 where it did not fail"""
        try:
            row = leases.retry(identifier)
        except StateError as error:
            code = "already-finished" if error.state == "succeeded" else "not-finished"
            detail = f"the {leases.what} is {error.state}; only a failed or cancelled one is retried"
            raise ApiError(409, code, detail) from None
        self.send(leases, row)
        return row

    def send(self, leases: Leases[Any], row: Simulation | Delivery) -> None:
        """Sends the message of a row that is committed. The sweep sends it later where that fails, or it is not due."""
        try:
            self.messenger.send(row.id, row.queue)
            leases.mark_sent(row.id)
        except Exception:
            log.exception("message not sent; the sweep will send it", extra={leases.what: row.id})

    def close(self) -> None:
        self.jobs.engine.dispose()
        self.rates.close()


def services(request: Request) -> Services:
    """The services of the running application."""
    running: Services = request.app.state.services
    return running


Served = Annotated[Services, Depends(services)]

RETRY_AFTER = {"Retry-After": "1"}
"""Seconds after which it is worth looking again."""


def location(request: Request, path: str) -> dict[str, str]:
    """The header that says where what was made is."""
    return {"Location": str(request.base_url).rstrip("/") + path}


def identifier_of(what: str) -> Callable[[str], str]:
    """A check that a path parameter has the form of an identifier; anything else is not found."""

    def check(identifier: str) -> str:
        if not re.fullmatch("[0-9a-f]{32}", identifier):
            raise NotFoundError(identifier, what)  # not even asked for: databases differ in which characters they take
        return identifier

    return check


Identifier = Annotated[str, Depends(identifier_of("simulation"))]
StudyIdentifier = Annotated[str, Depends(identifier_of("study"))]
