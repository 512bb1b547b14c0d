"""Deliveries: what goes to a destination, and how far each instance has come. The repository.

A delivery is a row on lease like a simulation (``records.leases``). Its instances are written down when it is asked
for; each is marked as stored in the transaction that follows the peer's answer, so whoever goes on later sends only
what is missing. At a time one delivery runs to a destination: its limits hold whatever the number of workers.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, ClassVar

import sqlalchemy as sa

from tomosim_contract.names import ACTIVE_STATES, EVENT_PROGRESS, EVENT_STATE, STATES, InstanceState, Queue, State
from worker.records.database import columns_of, reading, rows_of
from worker.records.delivery_tables import (
    Delivery,
    Instance,
    Item,
    Outcome,
    Request,
    deliveries,
    delivery_events,
    instances,
    items_of,
)
from worker.records.destinations import find, lock
from worker.records.leases import Leases
from worker.records.rows import QUEUED, Json, NotFoundError, StateError

MAX_BACKOFF_SECONDS = 600.0

COMMITTED = "committed"
"""Code of an instance of which the peer has said that it keeps it."""


_INSTANCE_COLUMNS = columns_of(instances, Instance)


class Deliveries(Leases[Delivery]):
    """Repository of deliveries, their instances and events."""

    table = deliveries
    events = delivery_events
    row_type = Delivery
    what = "delivery"
    no_progress: ClassVar[Json] = {"message": ""}

    # What clients ask for

    def create(self, request: Request, identifier: str | None = None) -> Delivery:
        """A new queued delivery. identifier: a new one where not given.

        raises: NotFoundError where there is no such destination
        """
        with self.engine.begin() as connection:
            row = find(connection, request.destination)
            request = replace(request, destination=row.id)
            return self._insert(connection, request, row.definition.name, identifier or uuid.uuid4().hex)

    def _insert(self, connection: sa.Connection, request: Request, destination_name: str, identifier: str) -> Delivery:
        row = {
            "id": identifier,
            "state": "queued",
            "destination_id": request.destination,
            "destination_name": destination_name,
            "simulation_id": request.simulation_id,
            "study_id": request.study_id,
            "automatic": request.automatic,
            "created": self.clock(),
            "instances": len(request.items),
            "bytes": sum(item.size for item in request.items),
        }
        connection.execute(deliveries.insert().values(row))
        rows = [
            {
                "delivery_id": identifier,
                "number": number,
                "destination_id": request.destination,
                "state": "waiting",
                **{f.name: getattr(item, f.name) for f in fields(Item)},
            }
            for number, item in enumerate(request.items)
        ]
        if rows:
            connection.execute(instances.insert(), rows)
        self._record(connection, identifier, 1, EVENT_STATE, {"state": "queued"})
        return self._one(connection, identifier)

    def insert_automatic(self, connection: sa.Connection, simulation_id: str, order: Json, manifest: Json) -> None:
        """The delivery that was asked for with a simulation, in the transaction in which that succeeds."""
        items = items_of(simulation_id, manifest, order.get("files", ()))
        request = Request(order["destination"], items, simulation_id=simulation_id, automatic=True)
        # Where the destination was removed meanwhile, the delivery fails and says so.
        self._insert(connection, request, order["name"], uuid.uuid4().hex)

    def page(
        self,
        limit: int,
        before: tuple[float, str] | None = None,
        *,
        state: State | None = None,
        simulation_id: str | None = None,
        study_id: str | None = None,
        destination_id: str | None = None,
    ) -> list[Delivery]:
        """The newest first; ``before``: (created, id) of the last one already seen."""
        filters = {"state": state, "simulation_id": simulation_id, "study_id": study_id}
        filters["destination_id"] = destination_id
        return self._page(limit, before, *(deliveries.c[k] == v for k, v in filters.items() if v is not None))

    def instances(
        self, identifier: str, *, state: InstanceState | None = None, after: int = -1, limit: int | None = None
    ) -> list[Instance]:
        """The instances of a delivery with a larger number than ``after``, in order."""
        c = instances.c
        query = sa.select(*_INSTANCE_COLUMNS).where(c.delivery_id == identifier, c.number > after).order_by(c.number)
        if state is not None:
            query = query.where(c.state == state)
        with reading(self.engine) as connection:
            return rows_of(connection.execute(query.limit(limit)), Instance)

    def retry(self, identifier: str) -> Delivery:
        """Queues a failed or cancelled delivery again: what was not stored is sent.

        raises: NotFoundError, StateError
        """
        values = self._queued_again() | {"failures": 0, "not_before": None, "instances_failed": 0}
        anew: Json = {"state": "waiting", "attempts": 0, "status": None, "code": None, "message": "", "finished": None}
        c = instances.c
        with self.engine.begin() as connection:
            if not self._change(connection, identifier, ["failed", "cancelled"], values):
                raise StateError(self._one(connection, identifier).state)
            connection.execute(instances.update().where(c.delivery_id == identifier, c.state != "stored").values(anew))
            return self._one(connection, identifier)

    # What workers do

    def _may_claim(self, connection: sa.Connection, identifier: str) -> bool:
        try:
            row = self._one(connection, identifier)
        except NotFoundError:
            return False
        if row.not_before is not None and row.not_before > self.clock():
            return False
        lock(connection, row.destination_id)
        return not connection.scalar(sa.select(sa.exists(_active(row.destination_id))))

    def identify(self, identifier: str, number: int, sop_instance: str) -> None:
        """Writes down the UID that was read from a file."""
        c = instances.c
        with self.engine.begin() as connection:
            mine = (c.delivery_id == identifier, c.number == number)
            connection.execute(instances.update().where(*mine).values(sop_instance=sop_instance))

    def other_version(self, destination_id: str, sop_instance: str, sha256: str) -> bool:
        """Whether the destination has stored another file under this UID."""
        c = instances.c
        query = sa.select(c.number).where(
            c.sop_instance == sop_instance, c.destination_id == destination_id, c.state == "stored", c.sha256 != sha256
        )
        with reading(self.engine) as connection:
            return connection.execute(query.limit(1)).first() is not None

    def record(self, identifier: str, number: int, outcome: Outcome, max_attempts: int) -> InstanceState:
        """Writes down what a peer answered, whoever owns the delivery now: what is stored is stored.

        An instance that may be tried again has failed after ``max_attempts``. The state it is in now.
        """
        states: dict[str, InstanceState] = {"stored": "stored", "refused": "failed", "again": "waiting"}
        state = states[outcome.verdict]
        i, d = instances.c, deliveries.c
        mine = (i.delivery_id == identifier, i.number == number)
        with self.engine.begin() as connection:
            row = connection.execute(
                sa.select(i.state, i.attempts, i.size, i.name).where(*mine).with_for_update()
            ).one()
            if row.state != "waiting":
                return row.state  # type: ignore[no-any-return]
            if outcome.verdict == "again" and row.attempts + 1 >= max_attempts:
                state = "failed"
            values: Json = {
                "state": state,
                "attempts": i.attempts + 1,
                "status": outcome.status,
                "code": outcome.code,
                "message": outcome.message,
                "finished": None if state == "waiting" else self.clock(),
            }
            connection.execute(instances.update().where(*mine).values(values))
            counts: Json = {}
            if state == "stored":
                counts = {
                    "instances_stored": d.instances_stored + 1,
                    "bytes_stored": d.bytes_stored + row.size,
                    "failures": 0,
                }
            elif state == "failed":
                counts = {"instances_failed": d.instances_failed + 1}
            data = {"instance": number, "name": row.name, "instance_state": state, **_told(outcome)}
            message = f"{row.name}: {outcome.message or state}"
            self._change(connection, identifier, STATES, {"message": message, **counts}, kind=EVENT_PROGRESS, data=data)
        return state

    def uncommitted(self, identifier: str) -> list[Instance]:
        """Instances that are stored and of which the peer has not said yet that it keeps them, in order."""
        c = instances.c
        query = sa.select(*_INSTANCE_COLUMNS).where(
            c.delivery_id == identifier, c.state == "stored", c.code != COMMITTED
        )
        with reading(self.engine) as connection:
            return rows_of(connection.execute(query.order_by(c.number)), Instance)

    def commit(self, identifier: str, committed: Sequence[int], failed: Mapping[int, str]) -> None:
        """Writes down a report of storage commitment. committed, failed: numbers of instances; why they failed."""
        c, d = instances.c, deliveries.c
        with self.engine.begin() as connection:
            for number in committed:
                mine = (c.delivery_id == identifier, c.number == number, c.state == "stored")
                connection.execute(instances.update().where(*mine).values(code=COMMITTED))
            sizes = 0
            for number, reason in failed.items():
                mine = (c.delivery_id == identifier, c.number == number, c.state == "stored")
                values = {"state": "failed", "code": "not-committed", "message": f"the peer does not keep it: {reason}"}
                sizes += connection.scalar(instances.update().where(*mine).values(values).returning(c.size)) or 0
            counts = {
                "instances_stored": d.instances_stored - len(failed),
                "instances_failed": d.instances_failed + len(failed),
                "bytes_stored": d.bytes_stored - sizes,
                "message": f"{len(committed)} instances committed, {len(failed)} not",
            }
            data = {"committed": len(committed), "not_committed": len(failed)}
            self._change(connection, identifier, STATES, counts, kind=EVENT_PROGRESS, data=data)

    def progress(self, identifier: str, owner: str, message: str) -> bool:
        """Says what is going on and renews the lease; False where the delivery is not the owner's any more."""
        values = {"message": message, "lease_until": self.clock() + self.lease_seconds}
        mine = deliveries.c.owner == owner
        with self.engine.begin() as connection:
            return self._change(
                connection, identifier, ["running"], values, mine, kind=EVENT_PROGRESS, data={"message": message}
            )

    def succeed(self, identifier: str, owner: str) -> bool:
        """Ends a delivery of the owner: every instance is stored."""
        return self._finish(identifier, owner, self._final("succeeded", error=None, message=""))

    def postpone(self, identifier: str, owner: str, error: Json, max_attempts: int, backoff_seconds: float) -> bool:
        """Gives a delivery back that was not finished: tried again later, failed after ``max_attempts`` in vain."""
        failures = self.get(identifier).failures + 1
        if failures >= max_attempts:
            return self.fail(identifier, owner, error)
        wait = min(MAX_BACKOFF_SECONDS, backoff_seconds * 2 ** min(failures - 1, 30))
        values = {
            **QUEUED,
            "error": error,
            "failures": failures,
            "not_before": self.clock() + wait,
            "message": f"tried again in {wait:g} s: {error['message']}",
        }
        return self._finish(identifier, owner, values)

    # What the sweep does

    def unsent(self, limit: int = 100) -> list[Delivery]:
        """Queued deliveries without a message whose time has come and whose destination is free, oldest first."""
        c = deliveries.c
        due = sa.or_(c.not_before.is_(None), c.not_before <= self.clock())
        active = deliveries.alias()
        busy = sa.select(active.c.id).where(active.c.destination_id == c.destination_id)
        busy = busy.where(active.c.state.in_(ACTIVE_STATES))
        return self._queued(sa.and_(c.sent.is_(None), due, ~sa.exists(busy)), limit)

    def sent_to(self, queue: Queue, before: float) -> list[Delivery]:
        """Queued deliveries whose message was sent before that time, oldest first."""
        return self.sent_before(before)


def _active(destination_id: str) -> sa.Select[Any]:
    c = deliveries.c
    return sa.select(c.id).where(c.destination_id == destination_id, c.state.in_(ACTIVE_STATES))


def _told(outcome: Outcome) -> Json:
    data: Json = {"code": outcome.code}
    if outcome.message:
        data["message"] = outcome.message
    if outcome.status is not None:
        data["status"] = f"0x{outcome.status:04X}"
    return data
