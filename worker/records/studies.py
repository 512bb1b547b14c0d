"""Studies: their table, and what concerns all their cases at once. A case is a simulation like any other."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import sqlalchemy as sa

from tomosim_contract.names import EVENT_STATE, FINAL_STATES, Queue, State, StudyState
from worker.records import quotas
from worker.records.database import columns_of, events, metadata, newest, reading, rows_of, simulations
from worker.records.jobs import UNKNOWN, Jobs, Simulation
from worker.records.quotas import Submitter
from worker.records.retention import unexpired
from worker.records.rows import Json, NotFoundError

STUDY_QUEUE: Queue = "batch"

studies = sa.Table(
    "studies",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("name", sa.String(64), nullable=False, default=""),
    # As it was posted, with its defaults.
    sa.Column("document", sa.JSON, nullable=False),
    # Columns of the coordinates of its cases, in order.
    sa.Column("columns", sa.JSON, nullable=False),
    sa.Column("estimate", sa.JSON, nullable=False),
    sa.Column("cases", sa.Integer, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    # The API key that posted it ("local", "admin" where there was none).
    sa.Column("submitted_by", sa.String(32)),
    # When its end was told to webhooks; NULL while cases are unfinished, and again after a retry.
    sa.Column("announced", sa.Double),
    sa.Index("studies_by_age", "created", "id"),
)


@dataclass(frozen=True)
class NewCase:
    """A case to be made: validated, and estimated."""

    name: str
    coordinates: Json
    specification: Json
    estimate: Json


@dataclass(frozen=True)
class Study:
    """A study without its document. counts: cases by state; started, finished: of its first and its last case."""

    id: str
    name: str
    columns: list[str]
    estimate: Json
    cases: int
    created: float
    counts: dict[State, int] = field(default_factory=dict)
    started: float | None = None
    finished: float | None = None

    @property
    def is_final(self) -> bool:
        return not any(number for state, number in self.counts.items() if state not in FINAL_STATES)

    @property
    def finished_cases(self) -> int:
        return sum(number for state, number in self.counts.items() if state in FINAL_STATES)

    @property
    def state(self) -> StudyState:
        states = {state for state, number in self.counts.items() if number}
        unfinished = states.difference(FINAL_STATES)
        if unfinished:
            if unfinished == {"cancelling"}:
                return "cancelling"
            return "queued" if states == {"queued"} else "running"
        if states == {"succeeded"}:
            return "succeeded"
        if "succeeded" in states:
            return "partial"
        return "failed" if "failed" in states else "cancelled"


_COLUMNS = [studies.c[name] for name in ("id", "name", "columns", "estimate", "cases", "created")]


def _with_files(identifier: str, now: float) -> tuple[sa.ColumnElement[bool], ...]:
    c = simulations.c
    return c.study_id == identifier, c.state == "succeeded", unexpired(now)


class Studies:
    """Repository of studies."""

    on_end: ClassVar[tuple[Callable[[Any, sa.Connection, Study], None], ...]] = ()
    """Called once with a study all of whose cases have ended, in the transaction that marks it (``records.ends``)."""

    def __init__(self, jobs: Jobs) -> None:
        self.jobs = jobs
        self.engine = jobs.engine

    def create(
        self,
        name: str,
        document: Json,
        columns: Sequence[str],
        estimate: Json,
        cases: Sequence[NewCase],
        identifier: str | None = None,
        queue: Queue = STUDY_QUEUE,
        submitter: Submitter = UNKNOWN,
        retention: float | None = None,
        deliver: list[Json] | None = None,
    ) -> Study:
        """A new study and all its cases, queued, in one transaction. Their messages are sent after this has returned.

        identifier: a new one where not given. retention: seconds for which files are kept after the end; None: for
        ever. deliver: where the files of each case go when it has succeeded, as in ``Jobs.create``.
        raises: QuotaError where the submitter may not have so many more.
        """
        identifier = identifier or uuid.uuid4().hex
        now = self.jobs.clock()
        row = {
            "id": identifier,
            "name": name,
            "document": document,
            "columns": list(columns),
            "estimate": estimate,
            "cases": len(cases),
            "created": now,
            "submitted_by": submitter.id,
        }
        common = {"queue": queue, "retention": retention, "deliver": deliver or None, **submitter.columns()}
        rows = [_case_row(identifier, number, case, now) | common for number, case in enumerate(cases, start=1)]
        first_events = [
            {"simulation_id": r["id"], "sequence": 1, "at": now, "kind": EVENT_STATE, "data": {"state": "queued"}}
            for r in rows
        ]
        with self.engine.begin() as connection:
            quotas.require(connection, submitter, len(cases), now)
            connection.execute(studies.insert().values(row))
            # With RETURNING many rows go into one statement on every database.
            connection.execute(simulations.insert().returning(simulations.c.id), rows)
            connection.execute(events.insert().returning(events.c.sequence), first_events)
            return self._one(connection, identifier)

    def get(self, identifier: str) -> Study:
        """raises: NotFoundError"""
        with reading(self.engine) as connection:
            return self._one(connection, identifier)

    def document(self, identifier: str) -> Json:
        """The study as it was posted, with its defaults. raises: NotFoundError"""
        with reading(self.engine) as connection:
            query = sa.select(studies.c.document).where(studies.c.id == identifier)
            row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFoundError(identifier, "study")
        document: Json = row[0]
        return document

    def page(self, limit: int, before: tuple[float, str] | None = None) -> list[Study]:
        """The newest studies first; ``before``: (created, id) of the last one already seen."""
        with reading(self.engine) as connection:
            return _with_counts(connection, newest(sa.select(*_COLUMNS), studies, limit, before))

    def cases(
        self, identifier: str, limit: int | None = None, state: State | None = None, after: int = 0
    ) -> list[Simulation]:
        """Its cases in the order of their numbers, those beyond ``after``."""
        query = (
            sa.select(*columns_of(simulations, Simulation))
            .where(simulations.c.study_id == identifier, simulations.c.study_number > after)
            .order_by(simulations.c.study_number)
            .limit(limit)
        )
        if state is not None:
            query = query.where(simulations.c.state == state)
        with reading(self.engine) as connection:
            return rows_of(connection.execute(query), Simulation)

    def has_files(self, identifier: str, now: float) -> bool:
        """Whether there is a case that succeeded and whose files have not expired by then."""
        with reading(self.engine) as connection:
            return bool(connection.scalar(sa.select(sa.exists().where(*_with_files(identifier, now)))))

    def manifests(self, identifier: str, now: float) -> Iterator[tuple[int, Json]]:
        """(number, manifest) of every case that succeeded and whose files have not expired by then."""
        query = sa.select(simulations.c.study_number, simulations.c.manifest).where(*_with_files(identifier, now))
        after = 0
        while True:
            part = query.where(simulations.c.study_number > after).order_by(simulations.c.study_number).limit(50)
            with reading(self.engine) as connection:
                rows = connection.execute(part).all()
            if not rows:
                return
            yield from ((number, manifest) for number, manifest in rows)
            after = rows[-1].study_number

    def cancel(self, identifier: str) -> tuple[Study, int]:
        """Cancels all cases that have not finished: (study, how many). raises: NotFoundError"""
        with self.engine.begin() as connection:
            self._lock(connection, identifier)
            number = self.jobs.cancel_all(connection, simulations.c.study_id == identifier)
            return self._one(connection, identifier), number

    def retry(self, identifier: str, states: Sequence[State] = ("failed",)) -> tuple[Study, int]:
        """Queues the cases again that ended in one of ``states``: (study, how many). raises: NotFoundError"""
        with self.engine.begin() as connection:
            self._lock(connection, identifier)
            number = self.jobs.retry_all(connection, simulations.c.study_id == identifier, states)
            if number:
                connection.execute(studies.update().where(studies.c.id == identifier).values(announced=None))
            return self._one(connection, identifier), number

    def delete(self, identifier: str) -> bool:
        """Forgets a study and its cases; False, and nothing is done, where some have not finished.

        raises: NotFoundError
        """
        with self.engine.begin() as connection:
            self._lock(connection, identifier)
            if not self._one(connection, identifier).is_final:
                return False
            connection.execute(studies.delete().where(studies.c.id == identifier))
            return True

    def announce_finished(self) -> list[str]:
        """Tells webhooks of studies whose last case has ended; each study once, whoever else looks at the same time.

        Not done by the last case itself: two cases that end at the same moment do not see one another.
        """
        c = simulations.c
        unfinished = sa.exists().where(c.study_id == studies.c.id, c.state.not_in(FINAL_STATES))
        query = sa.select(studies.c.id).where(studies.c.announced.is_(None), ~unfinished)
        with reading(self.engine) as connection:
            identifiers = list(connection.scalars(query))
        return [identifier for identifier in identifiers if self._announce(identifier)]

    def _announce(self, identifier: str) -> bool:
        now = self.jobs.clock()
        untold = (studies.c.id == identifier, studies.c.announced.is_(None))
        with self.engine.begin() as connection:
            self._lock(connection, identifier)
            rows = _with_counts(connection, sa.select(*_COLUMNS).where(*untold))
            if not rows or not rows[0].is_final:
                return False
            connection.execute(studies.update().where(*untold).values(announced=now))
            for call in self.on_end:
                call(self, connection, rows[0])
        return True

    def unsent(self, identifier: str, limit: int) -> list[Simulation]:
        """The first queued cases without a message."""
        return [case for case in self.cases(identifier, limit, "queued") if case.sent is None]

    def _lock(self, connection: sa.Connection, identifier: str) -> None:
        """Two changes of all cases at once would wait for one another's rows for ever."""
        connection.execute(sa.select(studies.c.id).where(studies.c.id == identifier).with_for_update())

    def _one(self, connection: sa.Connection, identifier: str) -> Study:
        rows = _with_counts(connection, sa.select(*_COLUMNS).where(studies.c.id == identifier))
        if not rows:
            raise NotFoundError(identifier, "study")
        return rows[0]


def _case_row(study_id: str, number: int, case: NewCase, now: float) -> dict[str, Any]:
    return {
        "id": uuid.uuid4().hex,
        "name": case.name,
        "state": "queued",
        "specification": case.specification,
        "estimate": case.estimate,
        # Whatever goes by age takes the cases in their order.
        "created": now + 1e-6 * number,
        "study_id": study_id,
        "study_number": number,
        "coordinates": case.coordinates,
    }


def _with_counts(connection: sa.Connection, query: sa.Select[Any]) -> list[Study]:
    rows = connection.execute(query).mappings().all()
    c = simulations.c
    tally = (
        sa.select(c.study_id, c.state, sa.func.count(), sa.func.min(c.started), sa.func.max(c.finished))
        .where(c.study_id.in_([row["id"] for row in rows]))
        .group_by(c.study_id, c.state)
    )
    tallies: dict[str, dict[State, tuple[int, float | None, float | None]]] = {row["id"]: {} for row in rows}
    for study_id, state, number, started, finished in connection.execute(tally):
        tallies[study_id][state] = (number, started, finished)
    return [_study(dict(row), tallies[row["id"]]) for row in rows]


def _study(row: Json, tally: dict[State, tuple[int, float | None, float | None]]) -> Study:
    study = Study(**row, counts={state: number for state, (number, _, _) in tally.items()})
    started = min((first for _, first, _ in tally.values() if first is not None), default=None)
    finished = max((last for _, _, last in tally.values() if last is not None), default=None)
    return Study(**row, counts=study.counts, started=started, finished=finished if study.is_final else None)
