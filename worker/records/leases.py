"""Rows that workers take on lease: simulations and deliveries. The one place that says who may change what.

The database is the truth about a job. A broker message carries only an identifier and may be lost, doubled or late:
whoever holds it must ``claim`` the row, and only the owner of the lease can end it. Every change is one
compare-and-set with its event.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, TypeVar

import sqlalchemy as sa

from tomosim_contract.names import ACTIVE_STATES, EVENT_STATE, FINAL_STATES, WORKER_LOST, State, failure
from worker.records.database import Repository, columns_of, newest, reading, rows_of
from worker.records.rows import NO_OWNER, QUEUED, Event, Json, Leased, NotFoundError, StateError

Row = TypeVar("Row", bound=Leased)


class Leases(Repository, Generic[Row]):
    """Repository of one table of leased rows and of their events.

    clock: seconds since 1970. Machines that share a database need clocks that agree well within a lease.
    """

    table: ClassVar[sa.Table]
    events: ClassVar[sa.Table]
    """Its first column names the row, the second is ``sequence``."""

    row_type: type[Row]
    what: ClassVar[str]
    """What a row is called in messages."""

    no_progress: ClassVar[Json]
    """Values of a row whose work begins anew."""

    on_end: ClassVar[tuple[Callable[[Any, sa.Connection, list[Any]], None], ...]] = ()
    """Called with this repository and rows that have reached a final state, the same for all, in the transaction in
    which they do (``records.ends``)."""

    on_retry: ClassVar[tuple[Callable[[Any, sa.Connection, Any], None], ...]] = ()
    """Called with a row that is queued again, in that transaction."""

    def __init__(self, engine: sa.Engine, lease_seconds: float = 30.0, clock: Callable[[], float] = time.time) -> None:
        super().__init__(engine, clock)
        self.lease_seconds = lease_seconds

    # What clients ask for

    def get(self, identifier: str) -> Row:
        """raises: NotFoundError"""
        with reading(self.engine) as connection:
            return self._one(connection, identifier)

    def events_after(self, identifier: str, sequence: int) -> list[Event]:
        """The events with a larger sequence number, in order."""
        e = self.events.c
        query = (
            sa.select(e.sequence, e.at, e.kind, e.data)
            .where(self._event_key == identifier, e.sequence > sequence)
            .order_by(e.sequence)
        )
        with reading(self.engine) as connection:
            return [Event(*row) for row in connection.execute(query)]

    def counts(self) -> dict[str, int]:
        """Number of rows by state."""
        query = sa.select(self.table.c.state, sa.func.count()).group_by(self.table.c.state)
        with reading(self.engine) as connection:
            return {str(state): int(number) for state, number in connection.execute(query)}

    def cancel(self, identifier: str) -> Row:
        """A queued row is cancelled at once, a running one when its worker has seen it.

        raises: NotFoundError, StateError where it has finished.
        """
        with self.engine.begin() as connection:
            if not self._change(connection, identifier, ["queued"], self._final("cancelled")):
                self._change(connection, identifier, ["running"], {"state": "cancelling"})
            row = self._one(connection, identifier)
        if row.state not in ("cancelling", "cancelled"):
            raise StateError(row.state)
        return row

    def retry(self, identifier: str) -> Row:
        """Queues a failed or cancelled row again. raises: NotFoundError, StateError"""
        with self.engine.begin() as connection:
            changed = self._change(connection, identifier, ["failed", "cancelled"], self._queued_again())
            row = self._one(connection, identifier)
            if not changed:
                raise StateError(row.state)
            for call in self.on_retry:
                call(self, connection, row)
        return row

    def cancel_all(self, connection: sa.Connection, condition: sa.ColumnElement[bool]) -> int:
        """Cancels every row that meets the condition and has not finished; how many."""
        queued = self._change_all(connection, condition, ["queued"], self._final("cancelled"))
        return queued + self._change_all(connection, condition, ["running"], {"state": "cancelling"})

    def retry_all(self, connection: sa.Connection, condition: sa.ColumnElement[bool], states: Sequence[State]) -> int:
        """Queues every row again that meets the condition and has ended in one of ``states``; how many."""
        return self._change_all(connection, condition, states, self._queued_again())

    def delete(self, identifier: str) -> None:
        """Forgets a finished row. raises: NotFoundError, StateError"""
        final = self.table.c.state.in_(FINAL_STATES)
        with self.engine.begin() as connection:
            done = connection.execute(self.table.delete().where(self.table.c.id == identifier, final)).rowcount
            if not done:
                raise StateError(self._one(connection, identifier).state)

    # What workers do

    def claim(self, identifier: str, owner: str) -> Row | None:
        """Makes ``owner`` the one worker of a queued row; None where it is not queued (any more).

        owner: a name that nobody uses for another claim, so that one whose answer was lost can be made again.
        """
        now = self.clock()
        values = {
            **self.no_progress,
            "state": "running",
            "owner": owner,
            "lease_until": now + self.lease_seconds,
            "attempt": self.table.c.attempt + 1,
            "started": now,
        }
        with self.engine.begin() as connection:
            if self._may_claim(connection, identifier):
                self._change(connection, identifier, ["queued"], values)
            # The owner's also where a first try was written and its answer lost with the connection.
            mine = sa.select(*self._columns).where(*self._mine(identifier, owner))
            return next(iter(self._rows(connection.execute(mine))), None)

    def _may_claim(self, connection: sa.Connection, identifier: str) -> bool:
        """Whether something besides its state keeps a row from being claimed."""
        return True

    def renew(self, identifier: str, owner: str) -> State | None:
        """Renews the lease; the state (running or cancelling), or None where the row is not the owner's any more."""
        mine = self._mine(identifier, owner)
        lease = self.table.update().where(*mine).values(lease_until=self.clock() + self.lease_seconds)
        with self.engine.begin() as connection:
            state: State | None = connection.scalar(lease.returning(self.table.c.state))
        return state

    def state_of(self, identifier: str, owner: str) -> State | None:
        """As ``renew``, without writing."""
        with reading(self.engine) as connection:
            return connection.scalar(sa.select(self.table.c.state).where(*self._mine(identifier, owner)))

    def fail(self, identifier: str, owner: str, error: Json) -> bool:
        """Ends a row of the owner with an error {kind, code, message}, or as cancelled."""
        return self._finish(identifier, owner, self._final("failed", error=error))

    def cancelled(self, identifier: str, owner: str) -> bool:
        """Ends a row of the owner whose cancellation was asked for."""
        mine = self.table.c.owner == owner
        with self.engine.begin() as connection:
            return self._change(connection, identifier, ["cancelling"], self._final("cancelled"), mine)

    def try_again(self, identifier: str, owner: str, reason: Json) -> bool:
        """Queues a row of the owner again after a failure that may be chance; the attempt counts.

        reason: the error {kind, code, message}; it stands in the event.
        """
        return self._finish(identifier, owner, QUEUED, reason)

    def release(self, identifier: str, owner: str) -> bool:
        """Gives a row back because its worker stops: queued again, and the attempt does not count."""
        return self._finish(identifier, owner, {**QUEUED, "attempt": self.table.c.attempt - 1})

    # What the sweep does

    def mark_unsent(self, identifier: str) -> None:
        """The message of this row was used up without a claim."""
        with self.engine.begin() as connection:
            mine = self.table.c.id == identifier
            connection.execute(self.table.update().where(mine).values(sent=None))

    def mark_sent(self, identifier: str) -> None:
        """A message for this queued row has been given to the broker."""
        queued = (self.table.c.id == identifier, self.table.c.state == "queued")
        with self.engine.begin() as connection:
            connection.execute(self.table.update().where(*queued).values(sent=self.clock()))

    def unsent(self, limit: int = 100) -> list[Row]:
        """Queued rows without a message, oldest first."""
        return self._queued(self.table.c.sent.is_(None), limit)

    def sent_before(self, time: float, limit: int = 100) -> list[Row]:
        """Queued rows whose message was sent before ``time``, oldest first."""
        return self._queued(self.table.c.sent < time, limit)

    def take_back(self, max_attempts: int) -> list[str]:
        """Ends the ownership of workers that let their lease expire: queued again, failed after ``max_attempts``,
        cancelled where that was asked. The identifiers concerned."""
        table = self.table
        late = table.c.lease_until < self.clock()
        query = sa.select(table.c.id, table.c.attempt).where(table.c.state.in_(ACTIVE_STATES), late)
        with reading(self.engine) as connection:
            lost = connection.execute(query).all()
        taken = []
        for identifier, attempt in lost:
            if attempt < max_attempts:
                values = QUEUED
            else:
                values = self._final("failed", error=self._worker_lost(attempt))
            with self.engine.begin() as connection:
                unchanged = (late, table.c.attempt == attempt)
                if self._change(
                    connection, identifier, ["cancelling"], self._final("cancelled"), *unchanged
                ) or self._change(connection, identifier, ["running"], values, *unchanged):
                    taken.append(identifier)
        return taken

    def expire_leases(self) -> None:
        """Ends all leases at once: for whoever knows that no worker of this database is alive."""
        with self.engine.begin() as connection:
            active = self.table.c.state.in_(ACTIVE_STATES)
            connection.execute(self.table.update().where(active).values(lease_until=0.0))

    # How it is done

    @property
    def _event_key(self) -> sa.Column[Any]:
        return next(iter(self.events.c))

    @property
    def _columns(self) -> list[sa.Column[Any]]:
        return columns_of(self.table, self.row_type)

    def _one(self, connection: sa.Connection, identifier: str) -> Row:
        rows = self._rows(connection.execute(sa.select(*self._columns).where(self.table.c.id == identifier)))
        if not rows:
            raise NotFoundError(identifier, self.what)
        return rows[0]

    def _rows(self, result: sa.Result[Any]) -> list[Row]:
        return rows_of(result, self.row_type)

    def _queued(self, condition: sa.ColumnElement[bool], limit: int) -> list[Row]:
        query = sa.select(*self._columns).where(self.table.c.state == "queued", condition)
        with reading(self.engine) as connection:
            return self._rows(connection.execute(query.order_by(self.table.c.created).limit(limit)))

    def _page(self, limit: int, before: tuple[float, str] | None, *conditions: sa.ColumnElement[bool]) -> list[Row]:
        """The newest rows first; ``before``: (created, id) of the last one already seen."""
        query = newest(sa.select(*self._columns).where(*conditions), self.table, limit, before)
        with reading(self.engine) as connection:
            return self._rows(connection.execute(query))

    def _mine(self, identifier: str, owner: str) -> tuple[sa.ColumnElement[bool], ...]:
        return (
            self.table.c.id == identifier,
            self.table.c.owner == owner,
            self.table.c.state.in_(ACTIVE_STATES),
        )

    def _queued_again(self) -> Json:
        values = {**self.no_progress, **QUEUED, "attempt": 0, "error": None, "started": None, "finished": None}
        return values

    def _final(self, state: State, **values: Any) -> Json:
        return {**NO_OWNER, "state": state, "finished": self.clock(), **values}

    def _finish(self, identifier: str, owner: str, values: Json, reason: Json | None = None) -> bool:
        mine = self.table.c.owner == owner
        with self.engine.begin() as connection:
            return self._change(connection, identifier, ["running"], values, mine, reason=reason) or self._change(
                connection, identifier, ["cancelling"], self._final("cancelled"), mine
            )

    def _change(
        self,
        connection: sa.Connection,
        identifier: str,
        states: Sequence[State],
        values: Json,
        *conditions: sa.ColumnElement[bool],
        kind: str = EVENT_STATE,
        data: Json | None = None,
        reason: Json | None = None,
    ) -> bool:
        """The one way to change a row: compare the state, set the values, raise the revision, record the event."""
        table = self.table
        changed = connection.execute(
            table.update()
            .where(table.c.id == identifier, table.c.state.in_(states), *conditions)
            .values(revision=table.c.revision + 1, **values)
            .returning(table.c.revision, table.c.attempt)
        ).one_or_none()
        if changed is None:
            return False
        if data is None:
            data = {"state": values["state"], "attempt": changed.attempt}
            if values.get("error"):
                data["error"] = values["error"]
            if reason is not None:
                data["reason"] = reason
        self._record(connection, identifier, changed.revision, kind, data)
        if values.get("state") in FINAL_STATES:
            self._ended(connection, [identifier])
        return True

    def _ended(self, connection: sa.Connection, identifiers: Sequence[str]) -> None:
        rows = self._rows(connection.execute(sa.select(*self._columns).where(self.table.c.id.in_(identifiers))))
        for call in self.on_end if rows else ():
            call(self, connection, rows)

    def _change_all(
        self, connection: sa.Connection, condition: sa.ColumnElement[bool], states: Sequence[State], values: Json
    ) -> int:
        """``_change`` of many rows in two statements; how many."""
        table = self.table
        changed = connection.execute(
            table.update()
            .where(condition, table.c.state.in_(states))
            .values(revision=table.c.revision + 1, **values)
            .returning(table.c.id, table.c.revision, table.c.attempt)
        ).all()
        now = self.clock()
        rows = [
            {
                self._event_key.name: identifier,
                "sequence": revision,
                "at": now,
                "kind": EVENT_STATE,
                "data": {"state": values["state"], "attempt": attempt},
            }
            for identifier, revision, attempt in changed
        ]
        if rows:
            # With RETURNING many rows go into one statement on every database.
            connection.execute(self.events.insert().returning(self._event_key), rows)
        if values["state"] in FINAL_STATES:
            self._ended(connection, [row.id for row in changed])
        return len(rows)

    def _record(self, connection: sa.Connection, identifier: str, sequence: int, kind: str, data: Json) -> None:
        event = {self._event_key.name: identifier, "sequence": sequence, "at": self.clock(), "kind": kind, "data": data}
        connection.execute(self.events.insert().values(event))

    def _worker_lost(self, attempts: int) -> Json:
        text = (
            f"the worker was lost {attempts} times while it worked on this {self.what} (stopped machine, no memory "
            "left, broken connection to the database): see the worker's log, then retry"
        )
        return failure(WORKER_LOST, text)
