"""Simulations: the only place with their queries. ``records.leases`` says how a row is claimed, renewed and ended."""

from __future__ import annotations

import uuid
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, ClassVar, cast

import sqlalchemy as sa

from worker.contract import DEFAULT_QUEUE, EVENT_PROGRESS, EVENT_STATE, Queue, State, WebhookEvent
from worker.records import counters, quotas, webhooks
from worker.records import retention as keeping
from worker.records.database import events, reading, simulations
from worker.records.deliveries import Deliveries
from worker.records.leases import Event as Event
from worker.records.leases import Json, Leased, Leases
from worker.records.leases import NotFoundError as NotFoundError
from worker.records.leases import StateError as StateError
from worker.records.quotas import Submitter
from worker.records.retention import ExpiredError, is_expired

UNKNOWN = Submitter("local")


_studies = sa.table("studies", sa.column("id"), sa.column("announced"))


@dataclass(frozen=True)
class Simulation(Leased):
    """A row without its large parts (``Jobs.specification``, ``Jobs.manifest``)."""

    name: str
    estimate: Json
    queue: Queue
    stage: str | None
    stages_done: int
    stages_total: int
    fraction: float
    message: str
    results: Json | None
    study_id: str | None
    study_number: int | None
    coordinates: Json | None
    submitted_by: str | None
    request_id: str | None
    retention: float | None
    expires_at: float | None
    pinned: bool


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


class Jobs(Leases[Simulation]):
    """Repository of simulations and their events."""

    table = simulations
    events = events
    row_type = Simulation
    what = "simulation"
    no_progress: ClassVar[Json] = {"stage": None, "stages_done": 0, "fraction": 0.0, "message": ""}

    def create(
        self,
        specification: Json,
        estimate: Json,
        name: str = "",
        queue: Queue = DEFAULT_QUEUE,
        identifier: str | None = None,
        submitter: Submitter = UNKNOWN,
        deliver: list[Json] | None = None,
        retention: float | None = None,
    ) -> Simulation:
        """A new queued simulation; its message is sent after this has returned.

        identifier: a new one where not given. deliver: where its files go when it has succeeded:
        [{"destination": id, "name", "files": patterns}]. retention: seconds for which its files are kept;
        None: for ever.
        raises: QuotaError where the submitter may have no more.
        """
        identifier = identifier or uuid.uuid4().hex
        row = {
            "id": identifier,
            "name": name,
            "state": "queued",
            "specification": specification,
            "estimate": estimate,
            "queue": queue,
            "deliver": deliver or None,
            "created": self.clock(),
            **submitter.columns(),
            "retention": retention,
        }
        with self.engine.begin() as connection:
            quotas.require(connection, submitter, 1, row["created"])
            connection.execute(simulations.insert().values(row))
            self._record(connection, identifier, 1, EVENT_STATE, {"state": "queued"})
            return self._one(connection, identifier)

    def specification(self, identifier: str) -> Json:
        """The specification as it was posted, with its defaults. raises: NotFoundError"""
        return self._column(identifier, "specification")  # type: ignore[no-any-return]

    def manifest(self, identifier: str) -> Json | None:
        """The manifest of a simulation that succeeded, else None. raises: NotFoundError, ExpiredError"""
        if is_expired(row := self.get(identifier), self.clock()):
            raise ExpiredError(f"the files of simulation {row.id}")
        return self._column(identifier, "manifest")  # type: ignore[no-any-return]

    def page(
        self,
        limit: int,
        state: State | None = None,
        before: tuple[float, str] | None = None,
        study_id: str | None = None,
    ) -> list[Simulation]:
        """The newest simulations first; ``before``: (created, id) of the last one already seen."""
        asked = {simulations.c.state: state, simulations.c.study_id: study_id}
        return self._page(limit, before, *(column == value for column, value in asked.items() if value is not None))

    def sent_to(self, queue: Queue, before: float) -> list[Simulation]:
        """Queued simulations whose message was sent to this queue before that time, oldest first."""
        return self._queued(sa.and_(simulations.c.queue == queue, simulations.c.sent < before), limit=100)

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

    def retry(self, identifier: str) -> Simulation:
        """Queues a failed or cancelled simulation again; the end of its study is told once more.

        raises: NotFoundError, StateError
        """
        row = super().retry(identifier)
        if row.study_id is not None:
            with self.engine.begin() as connection:
                connection.execute(_studies.update().where(_studies.c.id == row.study_id).values(announced=None))
        return row

    def _ended(self, connection: sa.Connection, identifiers: Sequence[str]) -> None:
        rows = self._many(connection.execute(sa.select(*self._columns).where(simulations.c.id.in_(identifiers))))
        if not rows:
            return
        state = rows[0].state
        counts: defaultdict[tuple[str, str], float] = defaultdict(float, {(counters.ENDED, state): float(len(rows))})
        for row in {row.study_id or row.id: row for row in rows}.values():
            keeping.set_expiry(connection, row, self.clock())
        if state == "succeeded":
            for row in rows:
                self._deliver(connection, row.id)
                manifest = connection.scalar(sa.select(simulations.c.manifest).where(simulations.c.id == row.id))
                for name, number in _stage_counts(manifest or {}).items():
                    counts[name] += number
        event = cast(WebhookEvent, f"simulation.{state}")
        webhooks.announce(connection, self.clock(), event, *(partial(_told, row) for row in rows))
        counters.add(connection, counts)

    def _deliver(self, connection: sa.Connection, identifier: str) -> None:
        """The deliveries that were asked for with the simulation begin with its success."""
        c = simulations.c
        found = connection.execute(sa.select(c.deliver, c.manifest).where(c.id == identifier)).one()
        for wanted in found.deliver or ():
            Deliveries(self.engine, self.lease_seconds, self.clock).insert_automatic(
                connection, identifier, wanted, found.manifest
            )

    def _column(self, identifier: str, name: str) -> Any:
        with reading(self.engine) as connection:
            row = connection.execute(sa.select(simulations.c[name]).where(simulations.c.id == identifier)).one_or_none()
        if row is None:
            raise NotFoundError(identifier)
        return row[0]


def _stage_counts(manifest: Json) -> dict[tuple[str, str], float]:
    """What the stages of a case that succeeded add to the counters."""
    counts: defaultdict[tuple[str, str], float] = defaultdict(float)
    for stage in manifest.get("stages", ()):
        name = str(stage.get("name"))[:64]
        if stage.get("cached"):
            counts[counters.STAGES_CACHED, name] += 1
        else:
            counts[counters.STAGES_COMPUTED, name] += 1
            counts[counters.STAGE_SECONDS, name] += stage.get("seconds", 0.0)
    return counts


def _told(row: Simulation) -> Json:
    """What a webhook is told of a simulation that ended."""
    return {
        "id": row.id,
        "name": row.name,
        "state": row.state,
        "attempt": row.attempt,
        "results": row.results,
        "error": row.error,
        "href": f"/v1/simulations/{row.id}",
    }
