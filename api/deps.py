"""What the endpoints work with, and how a posted specification is read."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request

from api.errors import ApiError
from api.rates import Rates
from simcore.core.store import Store
from simcore.spec import SimulationSpec
from worker.messages import CeleryMessenger, Messenger
from worker.records import schema
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.records.destinations import Destinations
from worker.records.fleet import Fleet
from worker.records.idempotency import Idempotency
from worker.records.jobs import Jobs
from worker.records.keys import Keys, check_address
from worker.records.retention import Retention
from worker.records.rows import NotFoundError
from worker.records.studies import Studies
from worker.records.webhooks import Webhooks
from worker.settings import Settings
from worker.storage import open_store


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

    def close(self) -> None:
        self.jobs.engine.dispose()
        self.rates.close()


def services(request: Request) -> Services:
    """The services of the running application."""
    found: Services = request.app.state.services
    return found


Served = Annotated[Services, Depends(services)]


def identifier_of(what: str) -> Callable[[str], str]:
    """A check that a path parameter has the form of an identifier; anything else is not found."""

    def check(identifier: str) -> str:
        if not re.fullmatch("[0-9a-f]{32}", identifier):
            raise NotFoundError(identifier, what)  # not even asked for: databases differ in which characters they take
        return identifier

    return check


Identifier = Annotated[str, Depends(identifier_of("simulation"))]
StudyIdentifier = Annotated[str, Depends(identifier_of("study"))]


@dataclass(frozen=True)
class PostedCase:
    """A posted document: the specification, and what else it asks for. deliver: as JSON has it; None: not given."""

    specification: bytes
    deliver: Any


async def _posted_case(request: Request) -> PostedCase:
    """The body, taken apart: ``deliver`` is no part of what a case is. raises: ApiError 413, 415"""
    body = await read_json(request)
    if b'"deliver"' in body:
        try:
            found = json.loads(body)
        except ValueError:
            return PostedCase(body, None)  # reading the specification says what is wrong
        if isinstance(found, dict) and "deliver" in found:
            deliver = found.pop("deliver")
            return PostedCase(json.dumps(found).encode(), deliver)
    return PostedCase(body, None)


PostedCaseBody = Annotated[PostedCase, Depends(_posted_case)]


def _posted_specification(case: PostedCaseBody) -> SimulationSpec:
    """The specification in the body. raises: SpecError naming every wrong field"""
    return SimulationSpec.parse(case.specification)


async def read_json(request: Request) -> bytes:
    """The body of a request that must be JSON, not parsed. raises: ApiError 413, 415"""
    limit = services(request).settings.body_limit_bytes
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json" and not kind.endswith("+json"):
        # Also keeps out pages of other sites: a browser sends them JSON only after asking us.
        raise ApiError(415, "unsupported-media-type", f"Content-Type = {kind!r}: the body must be application/json")
    return await read_body(request, limit)


async def read_body(request: Request, limit: int) -> bytes:
    """The body of a request. raises: ApiError 413 as soon as it is longer than ``limit`` bytes"""
    too_large = ApiError(413, "too-large", f"the body is longer than the {limit} bytes that are allowed")
    announced = request.headers.get("content-length", "0")
    if announced.isdigit() and int(announced) > limit:
        raise too_large
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit:
            raise too_large
    return bytes(body)


PostedSpecification = Annotated[SimulationSpec, Depends(_posted_specification)]
