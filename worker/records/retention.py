"""How long the files of a simulation are kept: until ``expires_at``, or as long as it is pinned.

The row stays for ever; its files are given out until then, and collected as garbage some time later. The cases of a
study are kept until the whole study has ended and their time has passed since.
"""

from __future__ import annotations

from typing import Protocol

import sqlalchemy as sa

from tomosim_contract.names import EVENT_PROGRESS, FINAL_STATES
from worker.records.database import Repository, events, simulations
from worker.records.rows import NotFoundError


class ExpiredError(Exception):
    """What was asked for was kept until a time that has passed; the message names it."""


class Kept(Protocol):
    """What of a simulation is needed here."""

    @property
    def id(self) -> str: ...
    @property
    def study_id(self) -> str | None: ...


def unexpired(now: float) -> sa.ColumnElement[bool]:
    """Those whose files are given out, as a condition of a query."""
    c = simulations.c
    return sa.or_(c.pinned, c.expires_at.is_(None), c.expires_at > now)


def set_expiry(connection: sa.Connection, row: Kept, now: float) -> None:
    """Called where a simulation has ended: from now on it is known how long its files are kept."""
    c = simulations.c
    _set_expiry(connection, c.id == row.id if row.study_id is None else c.study_id == row.study_id, now)


def set_study_expiry(connection: sa.Connection, study_id: str, now: float) -> None:
    """Called where a study is seen to have ended: two last cases at the same moment do not see one another."""
    _set_expiry(connection, simulations.c.study_id == study_id, now)


def _set_expiry(connection: sa.Connection, mine: sa.ColumnElement[bool], now: float) -> None:
    c = simulations.c
    unfinished = sa.exists().where(mine, c.state.not_in(FINAL_STATES))
    if not connection.scalar(sa.select(unfinished)):
        # Retried cases of a study do not bring back what has expired meanwhile.
        succeeded = (mine, c.state == "succeeded", c.retention.is_not(None), unexpired(now))
        connection.execute(simulations.update().where(*succeeded).values(expires_at=now + c.retention))


class Retention(Repository):
    """Pins, and what is forgotten in time."""

    def pin(self, identifier: str) -> None:
        """Keeps the files of a simulation. raises: NotFoundError, ExpiredError"""
        self._set(simulations.c.id == identifier, "simulation", identifier, pinned=True)

    def unpin(self, identifier: str) -> None:
        """From now on its files are kept as long as if it had just ended. raises: NotFoundError, ExpiredError"""
        self._set(simulations.c.id == identifier, "simulation", identifier, pinned=False)

    def pin_study(self, identifier: str) -> None:
        """Keeps the files of all its cases, as far as they are there. raises: NotFoundError, ExpiredError"""
        self._set(simulations.c.study_id == identifier, "study", identifier, pinned=True)

    def unpin_study(self, identifier: str) -> None:
        """As ``unpin``, for all its cases. raises: NotFoundError, ExpiredError"""
        self._set(simulations.c.study_id == identifier, "study", identifier, pinned=False)

    def prune_events(self, older_than_seconds: float) -> int:
        """Forgets the progress of simulations that ended longer ago; how many events."""
        c = simulations.c
        ended = sa.select(c.id).where(c.state.in_(FINAL_STATES), c.finished < self.clock() - older_than_seconds)
        old = (events.c.kind == EVENT_PROGRESS, events.c.simulation_id.in_(ended))
        with self.engine.begin() as connection:
            return connection.execute(events.delete().where(*old)).rowcount

    def complete_expiry(self) -> None:
        """Sets ``expires_at`` where two cases of a study ended at once and neither saw the other."""
        c = simulations.c
        other = simulations.alias()
        running = sa.exists().where(other.c.study_id == c.study_id, other.c.state.not_in(FINAL_STATES))
        missing = (c.state == "succeeded", c.retention.is_not(None), c.expires_at.is_(None), ~c.pinned, ~running)
        with self.engine.begin() as connection:
            connection.execute(simulations.update().where(*missing).values(expires_at=self.clock() + c.retention))

    def _set(self, which: sa.ColumnElement[bool], what: str, identifier: str, *, pinned: bool) -> None:
        now = self.clock()
        c = simulations.c
        again = sa.case((sa.and_(c.pinned, c.expires_at.is_not(None)), now + c.retention), else_=c.expires_at)
        change = simulations.update().where(which, unexpired(now))
        with self.engine.begin() as connection:
            if connection.execute(change.values(pinned=pinned, expires_at=again)).rowcount:
                return
            if not connection.scalar(sa.select(sa.exists().where(which))):
                raise NotFoundError(identifier, what)
        raise ExpiredError(f"the files of {what} {identifier}")
