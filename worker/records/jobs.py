"""Simulations: the only place with their queries. ``records.leases`` says how a row is claimed, renewed and ended."""

from __future__ import annotations

import uuid
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import sqlalchemy as sa

from tomosim_contract.names import DEFAULT_QUEUE, EVENT_PROGRESS, EVENT_STATE, Queue, State
from worker.records import quotas
from worker.records.database import events, reading, simulations
from worker.records.leases import Leases
from worker.records.quotas import Submitter
from worker.records.retention import ExpiredError
from worker.records.rows import Json, Leased, NotFoundError

UNKNOWN = Submitter("local")


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

    def is_expired(self, now: float) -> bool:
        """Whether its files are not given out any more (``retention.unexpired`` as a condition of a query)."""
        return not self.pinned and self.expires_at is not None and self.expires_at <= now


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
        if (row := self.get(identifier)).is_expired(self.clock()):
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
        filters = {simulations.c.state: state, simulations.c.study_id: study_id}
        return self._page(limit, before, *(column == value for column, value in filters.items() if value is not None))

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

    def _column(self, identifier: str, name: str) -> Any:
        with reading(self.engine) as connection:
            row = connection.execute(sa.select(simulations.c[name]).where(simulations.c.id == identifier)).one_or_none()
        if row is None:
            raise NotFoundError(identifier)
        return row[0]
