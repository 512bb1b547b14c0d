"""The only place with queries: every change of a simulation is one compare-and-set with its event.

The database is the truth about a job. A broker message carries only an identifier and may be lost, doubled or late:
whoever holds it must ``claim`` the row, and only the owner of the lease can ``finish`` it.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa

from worker.contract import (
    ACTIVE_STATES,
    DEFAULT_QUEUE,
    EVENT_PROGRESS,
    EVENT_STATE,
    FINAL_STATES,
    WORKER_LOST,
    Queue,
    State,
)
from worker.database import events, reading, simulations

Json = dict[str, Any]


class NotFoundError(LookupError):
    """There is no such simulation."""


class StateError(Exception):
    """The simulation is in a state that does not allow what was asked; ``state`` is the one it is in."""

    def __init__(self, state: State) -> None:
        super().__init__(state)
        self.state = state


@dataclass(frozen=True)
class Simulation:
    """A row without its large parts (``Jobs.specification``, ``Jobs.manifest``). Times: seconds since 1970."""

    id: str
    name: str
    state: State
    estimate: Json
    queue: Queue
    revision: int
    created: float
    started: float | None
    finished: float | None
    attempt: int
    sent: float | None
    owner: str | None
    lease_until: float | None
    stage: str | None
    stages_done: int
    stages_total: int
    fraction: float
    message: str
    error: Json | None
    results: Json | None

    @property
    def is_final(self) -> bool:
        return self.state in FINAL_STATES


@dataclass(frozen=True)
class Event:
    """Something that happened to a simulation; ``sequence`` grows with time and may have gaps."""

    sequence: int
    at: float
    kind: str
    data: Json


@dataclass(frozen=True)
class StageProgress:
    """Where a case stands: ``stages_done`` whole stages and ``fraction`` of the current one."""

    stage: str
    stages_done: int
    stages_total: int
    fraction: float
    message: str

    def values(self) -> Json:
        return {f.name: getattr(self, f.name) for f in fields(self)}


_NO_PROGRESS: Json = {"stage": None, "stages_done": 0, "fraction": 0.0, "message": ""}
_NO_OWNER: Json = {"owner": None, "lease_until": None}
_COLUMNS = [simulations.c[f.name] for f in fields(Simulation)]


class Jobs:
    """Repository of simulations and their events.

    clock: seconds since 1970. Machines that share a database need clocks that agree well within a lease.
    """

    def __init__(self, engine: sa.Engine, lease_seconds: float = 30.0, clock: Callable[[], float] = time.time) -> None:
        self.engine = engine
        self.lease_seconds = lease_seconds
        self.clock = clock

    # What clients ask for

    def create(self, specification: Json, estimate: Json, name: str = "", queue: Queue = DEFAULT_QUEUE) -> Simulation:
        """A new queued simulation; its message is sent after this has returned."""
        identifier = uuid.uuid4().hex
        row = {
            "id": identifier,
            "name": name,
            "state": "queued",
            "specification": specification,
            "estimate": estimate,
            "queue": queue,
            "created": self.clock(),
        }
        with self.engine.begin() as connection:
            connection.execute(simulations.insert().values(row))
            self._record(connection, identifier, 1, EVENT_STATE, {"state": "queued"})
            return _one(connection, identifier)

    def get(self, identifier: str) -> Simulation:
        """raises: NotFoundError"""
        with reading(self.engine) as connection:
            return _one(connection, identifier)

    def specification(self, identifier: str) -> Json:
        """The specification as it was posted, with its defaults. raises: NotFoundError"""
        return self._column(identifier, "specification")  # type: ignore[no-any-return]

    def manifest(self, identifier: str) -> Json | None:
        """The manifest of a simulation that succeeded, else None. raises: NotFoundError"""
        return self._column(identifier, "manifest")  # type: ignore[no-any-return]

    def page(self, limit: int, state: State | None = None, before: tuple[float, str] | None = None) -> list[Simulation]:
        """The newest simulations first; ``before``: (created, id) of the last one already seen."""
        query = sa.select(*_COLUMNS).order_by(simulations.c.created.desc(), simulations.c.id.desc())
        if state is not None:
            query = query.where(simulations.c.state == state)
        if before is not None:
            created, identifier = before
            older = simulations.c.created < created
            same = sa.and_(simulations.c.created == created, simulations.c.id < identifier)
            query = query.where(sa.or_(older, same))
        with reading(self.engine) as connection:
            return _many(connection.execute(query.limit(limit)))

    def events_after(self, identifier: str, sequence: int) -> list[Event]:
        """The events with a larger sequence number, in order."""
        query = (
            sa.select(events.c.sequence, events.c.at, events.c.kind, events.c.data)
            .where(events.c.simulation_id == identifier, events.c.sequence > sequence)
            .order_by(events.c.sequence)
        )
        with reading(self.engine) as connection:
            return [Event(*row) for row in connection.execute(query)]

    def cancel(self, identifier: str) -> Simulation:
        """A queued simulation is cancelled at once, a running one when its worker has seen it.

        raises: NotFoundError, StateError where it has finished.
        """
        with self.engine.begin() as connection:
            if not self._change(connection, identifier, ["queued"], self._final("cancelled")):
                self._change(connection, identifier, ["running"], {"state": "cancelling"})
            row = _one(connection, identifier)
        if row.state not in ("cancelling", "cancelled"):
            raise StateError(row.state)
        return row

    def retry(self, identifier: str) -> Simulation:
        """Queues a failed or cancelled simulation again. raises: NotFoundError, StateError"""
        values = {**_NO_PROGRESS, **_NO_OWNER, "state": "queued", "attempt": 0, "sent": None, "error": None}
        values |= {"started": None, "finished": None}
        with self.engine.begin() as connection:
            changed = self._change(connection, identifier, ["failed", "cancelled"], values)
            row = _one(connection, identifier)
        if not changed:
            raise StateError(row.state)
        return row

    def delete(self, identifier: str) -> None:
        """Forgets a finished simulation. raises: NotFoundError, StateError"""
        final = simulations.c.state.in_(FINAL_STATES)
        with self.engine.begin() as connection:
            done = connection.execute(simulations.delete().where(simulations.c.id == identifier, final)).rowcount
            if not done:
                raise StateError(_one(connection, identifier).state)

    # What workers do

    def claim(self, identifier: str, owner: str) -> Simulation | None:
        """Makes ``owner`` the one worker of a queued simulation; None where it is not queued (any more)."""
        now = self.clock()
        values = {
            **_NO_PROGRESS,
            "state": "running",
            "owner": owner,
            "lease_until": now + self.lease_seconds,
            "attempt": simulations.c.attempt + 1,
            "started": now,
        }
        with self.engine.begin() as connection:
            if not self._change(connection, identifier, ["queued"], values):
                return None
            return _one(connection, identifier)

    def renew(self, identifier: str, owner: str) -> State | None:
        """Renews the lease; the state (running or cancelling), or None where the job is not the owner's any more."""
        mine = self._mine(identifier, owner)
        lease = simulations.update().where(*mine).values(lease_until=self.clock() + self.lease_seconds)
        with self.engine.begin() as connection:
            state: State | None = connection.scalar(lease.returning(simulations.c.state))
        return state

    def state_of(self, identifier: str, owner: str) -> State | None:
        """As ``renew``, without writing."""
        with reading(self.engine) as connection:
            return connection.scalar(sa.select(simulations.c.state).where(*self._mine(identifier, owner)))

    def progress(self, identifier: str, owner: str, progress: StageProgress) -> bool:
        """Records progress and renews the lease; False where the job is not the owner's any more."""
        values = {**progress.values(), "lease_until": self.clock() + self.lease_seconds}
        with self.engine.begin() as connection:
            return self._change(
                connection,
                identifier,
                ["running"],
                values,
                simulations.c.owner == owner,
                kind=EVENT_PROGRESS,
                data=progress.values(),
            )

    def succeed(self, identifier: str, owner: str, manifest: Json) -> bool:
        """Ends a job of the owner with its result, or as cancelled where that was asked meanwhile."""
        total = simulations.c.stages_total
        values = {"manifest": manifest, "results": manifest.get("results", {}), "stages_done": total}
        return self._finish(identifier, owner, self._final("succeeded", fraction=1.0, error=None, **values))

    def fail(self, identifier: str, owner: str, error: Json) -> bool:
        """Ends a job of the owner with an error {kind, code, message}, or as cancelled."""
        return self._finish(identifier, owner, self._final("failed", error=error))

    def cancelled(self, identifier: str, owner: str) -> bool:
        """Ends a job of the owner whose cancellation was asked for."""
        mine = simulations.c.owner == owner
        with self.engine.begin() as connection:
            return self._change(connection, identifier, ["cancelling"], self._final("cancelled"), mine)

    def release(self, identifier: str, owner: str) -> bool:
        """Gives a job back because its worker stops: queued again, and the attempt does not count."""
        values = {
            **_NO_OWNER,
            "state": "queued",
            "sent": None,
            "attempt": simulations.c.attempt - 1,
        }
        return self._finish(identifier, owner, values)

    # What the sweep does

    def mark_unsent(self, identifier: str) -> None:
        """The message of this simulation was used up without a claim."""
        with self.engine.begin() as connection:
            mine = simulations.c.id == identifier
            connection.execute(simulations.update().where(mine).values(sent=None))

    def mark_sent(self, identifier: str) -> None:
        """A message for this queued simulation has been given to the broker."""
        queued = (simulations.c.id == identifier, simulations.c.state == "queued")
        with self.engine.begin() as connection:
            connection.execute(simulations.update().where(*queued).values(sent=self.clock()))

    def unsent(self, limit: int = 100) -> list[Simulation]:
        """Queued simulations without a message, oldest first."""
        return self._queued(simulations.c.sent.is_(None), limit)

    def sent_before(self, time: float, limit: int = 100) -> list[Simulation]:
        """Queued simulations whose message was sent before ``time``, oldest first."""
        return self._queued(simulations.c.sent < time, limit)

    def take_back(self, max_attempts: int) -> list[str]:
        """Ends the ownership of workers that let their lease expire: queued again, failed after ``max_attempts``,
        cancelled where that was asked. The identifiers concerned."""
        late = simulations.c.lease_until < self.clock()
        query = sa.select(simulations.c.id, simulations.c.attempt).where(simulations.c.state.in_(ACTIVE_STATES), late)
        with reading(self.engine) as connection:
            lost = connection.execute(query).all()
        taken = []
        for identifier, attempt in lost:
            if attempt < max_attempts:
                values = {**_NO_OWNER, "state": "queued", "sent": None}
            else:
                values = self._final("failed", error=_worker_lost(attempt))
            with self.engine.begin() as connection:
                unchanged = (late, simulations.c.attempt == attempt)
                if self._change(
                    connection, identifier, ["cancelling"], self._final("cancelled"), *unchanged
                ) or self._change(connection, identifier, ["running"], values, *unchanged):
                    taken.append(identifier)
        return taken

    def expire_leases(self) -> None:
        """Ends all leases at once: for whoever knows that no worker of this database is alive."""
        with self.engine.begin() as connection:
            active = simulations.c.state.in_(ACTIVE_STATES)
            connection.execute(simulations.update().where(active).values(lease_until=0.0))

    # How it is done

    def _column(self, identifier: str, name: str) -> Any:
        with reading(self.engine) as connection:
            row = connection.execute(sa.select(simulations.c[name]).where(simulations.c.id == identifier)).one_or_none()
        if row is None:
            raise NotFoundError(identifier)
        return row[0]

    def _queued(self, condition: sa.ColumnElement[bool], limit: int) -> list[Simulation]:
        query = sa.select(*_COLUMNS).where(simulations.c.state == "queued", condition)
        with reading(self.engine) as connection:
            return _many(connection.execute(query.order_by(simulations.c.created).limit(limit)))

    def _mine(self, identifier: str, owner: str) -> tuple[sa.ColumnElement[bool], ...]:
        return (
            simulations.c.id == identifier,
            simulations.c.owner == owner,
            simulations.c.state.in_(ACTIVE_STATES),
        )

    def _final(self, state: State, **values: Any) -> Json:
        return {**_NO_OWNER, "state": state, "finished": self.clock(), **values}

    def _finish(self, identifier: str, owner: str, values: Json) -> bool:
        mine = simulations.c.owner == owner
        with self.engine.begin() as connection:
            return self._change(connection, identifier, ["running"], values, mine) or self._change(
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
    ) -> bool:
        """The one way to change a row: compare the state, set the values, raise the revision, record the event."""
        table = simulations
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
        self._record(connection, identifier, changed.revision, kind, data)
        return True

    def _record(self, connection: sa.Connection, identifier: str, sequence: int, kind: str, data: Json) -> None:
        connection.execute(
            events.insert().values(simulation_id=identifier, sequence=sequence, at=self.clock(), kind=kind, data=data)
        )


def _worker_lost(attempts: int) -> Json:
    return {
        "kind": "system",
        "code": WORKER_LOST,
        "message": f"the worker was lost {attempts} times while it computed this case (stopped machine, no memory "
        "left, broken connection to the database): see the worker's log, then retry",
    }


def _one(connection: sa.Connection, identifier: str) -> Simulation:
    found = _many(connection.execute(sa.select(*_COLUMNS).where(simulations.c.id == identifier)))
    if not found:
        raise NotFoundError(identifier)
    return found[0]


def _many(rows: sa.Result[Any]) -> list[Simulation]:
    return [Simulation(**row) for row in rows.mappings()]
