"""Looking after a row on lease while its work is done: the clock, the state, the lease."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from tomosim_contract.names import State
from worker.records.database import Result, outlast
from worker.records.leases import Leases

log = logging.getLogger(__name__)

STATE_SECONDS = 0.3
"""How often the database is asked whether the work was cancelled."""

STOP_SECONDS = 5.0
"""How long a worker that stops waits for a database that does not answer."""


def write_end(finish: Callable[[], Result], stopping: threading.Event) -> Result | None:
    """Writes how work ended, which waits for the database. None: not written, the lease runs out."""
    began = time.monotonic()
    try:
        return outlast(finish, lambda: stopping.is_set() and time.monotonic() - began > STOP_SECONDS)
    except SQLAlchemyError:
        log.exception("the end was not recorded")
        return None


class Watch:
    """Says whether work goes on, is cancelled, is late or belongs to another; renews the lease.

    limit_seconds: after which it is late. outlasts: whether work goes on however long the database is away. That it
    may then be done twice must do no harm; otherwise it is lost with its lease.
    """

    def __init__(
        self, leases: Leases[Any], identifier: str, owner: str, limit_seconds: float, *, outlasts: bool = False
    ) -> None:
        self.leases = leases
        self.identifier = identifier
        self.owner = owner
        self.outlasts = outlasts
        now = time.monotonic()
        self.deadline = now + limit_seconds
        self.renewed = now
        self.asked = now

    def verdict(self) -> State | str:
        """running, cancelling, late, or lost."""
        now = time.monotonic()
        if now > self.deadline:
            return "late"
        if now - self.asked < STATE_SECONDS:
            return "running"
        self.asked = now
        lease_seconds = self.leases.lease_seconds
        try:
            if now - self.renewed > lease_seconds / 3:
                state = self.leases.renew(self.identifier, self.owner)
                self.renewed = now
            else:
                state = self.leases.state_of(self.identifier, self.owner)
        except SQLAlchemyError:
            log.exception("the database does not answer", extra={self.leases.what: self.identifier})
            return "running" if self.outlasts or now - self.renewed < lease_seconds else "lost"
        return state or "lost"
