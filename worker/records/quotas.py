"""How many cases an API key may have. Asked inside the transaction that makes them: two requests at once cannot both
take the last place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from tomosim_contract.names import FINAL_STATES
from worker.records.database import simulations
from worker.records.keys import table as keys

DAY_SECONDS = 86400.0

ACTIVE_RETRY_SECONDS = 30
"""When to ask again where cases have to end first: nobody knows how long they take."""


@dataclass(frozen=True)
class Submitter:
    """Who posts cases, with which request, and how many it may have; 0: any number.

    id: of the API key. active_cases: queued or running at a time. cases_per_day: posted within 24 hours.
    """

    id: str
    request_id: str | None = None
    active_cases: int = 0
    cases_per_day: int = 0

    def columns(self) -> dict[str, Any]:
        """The columns of a simulation that say so."""
        return {"submitted_by": self.id, "request_id": self.request_id}


class QuotaError(Exception):
    """The key may not have so many cases. retry_after: seconds until it may; None: never so many at once."""

    def __init__(self, message: str, retry_after: int | None) -> None:
        super().__init__(message)
        self.retry_after = retry_after


def require(connection: sa.Connection, submitter: Submitter, cases: int, now: float) -> None:
    """Whether the submitter may have so many more cases, from within the transaction that makes them.

    raises: QuotaError
    """
    if not submitter.active_cases and not submitter.cases_per_day:
        return
    # Whoever posts with the same key at the same time waits here.
    connection.execute(keys.update().where(keys.c.id == submitter.id).values(name=keys.c.name))
    mine = simulations.c.submitted_by == submitter.id
    if limit := submitter.active_cases:
        active = sa.and_(mine, simulations.c.state.not_in(FINAL_STATES))
        _check(_count(connection, active), cases, limit, "queued or running at a time", ACTIVE_RETRY_SECONDS)
    if limit := submitter.cases_per_day:
        today = sa.and_(mine, simulations.c.created > now - DAY_SECONDS)
        count = _count(connection, today)
        wait = 0
        if limit >= cases > limit - count:
            oldest = sa.select(simulations.c.created).where(today).order_by(simulations.c.created)
            in_the_way = connection.scalar(oldest.offset(count + cases - limit - 1).limit(1)) or now
            wait = max(1, math.ceil(in_the_way + DAY_SECONDS - now))
        _check(count, cases, limit, "within 24 hours", wait)


def _count(connection: sa.Connection, condition: sa.ColumnElement[bool]) -> int:
    return connection.scalar(sa.select(sa.func.count()).select_from(simulations).where(condition)) or 0


def _check(count: int, cases: int, limit: int, when: str, retry_after: int) -> None:
    if count + cases <= limit:
        return
    never = cases > limit
    raise QuotaError(
        f"this API key may have {limit} cases {when} and has {count}; {cases} more were asked for",
        None if never else retry_after,
    )
