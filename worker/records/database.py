"""Tables of the service, and how to connect. SQLite (WAL) by default; PostgreSQL works as well."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.exc import InterfaceError, OperationalError, TimeoutError

from worker.records import postgres

AWAY = (OperationalError, InterfaceError, TimeoutError)
"""What SQLAlchemy raises where the database does not answer."""

RETRY_SECONDS = 0.5

Result = TypeVar("Result")
Row = TypeVar("Row")

log = logging.getLogger(__name__)

metadata = sa.MetaData()

# Times are seconds since 1970 (UTC) in double precision: the same on every database.
simulations = sa.Table(
    "simulations",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("name", sa.String(64), nullable=False, default=""),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("specification", sa.JSON, nullable=False),
    sa.Column("estimate", sa.JSON, nullable=False),
    sa.Column("queue", sa.String(16), nullable=False),
    # Deliveries that are made when it has succeeded: [{"destination", "name", "files"}].
    sa.Column("deliver", sa.JSON(none_as_null=True)),
    # Raised with every change; the number of the latest event.
    sa.Column("revision", sa.Integer, nullable=False, default=1),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("started", sa.Double),
    sa.Column("finished", sa.Double),
    sa.Column("attempt", sa.Integer, nullable=False, default=0),
    # When its message was last given to the broker; NULL: never, or not since it was last queued.
    sa.Column("sent", sa.Double),
    sa.Column("owner", sa.String(200)),
    sa.Column("lease_until", sa.Double),
    sa.Column("stage", sa.String(64)),
    sa.Column("stages_done", sa.Integer, nullable=False, default=0),
    sa.Column("stages_total", sa.Integer, nullable=False, default=0),
    sa.Column("fraction", sa.Double, nullable=False, default=0.0),
    sa.Column("message", sa.Text, nullable=False, default=""),
    sa.Column("error", sa.JSON(none_as_null=True)),
    sa.Column("results", sa.JSON(none_as_null=True)),
    sa.Column("manifest", sa.JSON(none_as_null=True)),
    # The API key that posted it ("local", "admin" where there was none), and the identifier of that request.
    sa.Column("submitted_by", sa.String(32)),
    sa.Column("request_id", sa.String(128)),
    # Of a case of a study: its place there, and its coordinates on the axes {column: value or label}.
    sa.Column("study_id", sa.String(32), sa.ForeignKey("studies.id", name="simulations_of_study", ondelete="CASCADE")),
    sa.Column("study_number", sa.Integer),
    sa.Column("coordinates", sa.JSON(none_as_null=True)),
    # Seconds for which its files are kept after it (or the study) has ended, NULL: for ever; until when that is; and
    # whether they are kept whatever that says.
    sa.Column("retention", sa.Double),
    sa.Column("expires_at", sa.Double),
    sa.Column("pinned", sa.Boolean, nullable=False, default=False),
    sa.Index("simulations_by_age", "created", "id"),
    sa.Index("simulations_by_state", "state", "created"),
    sa.Index("simulations_by_key", "submitted_by", "created"),
    sa.Index("simulations_by_study", "study_id", "study_number"),
)

events = sa.Table(
    "events",
    metadata,
    sa.Column("simulation_id", sa.String(32), sa.ForeignKey("simulations.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("sequence", sa.Integer, primary_key=True),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("data", sa.JSON, nullable=False),
)

workers = sa.Table(
    "workers",
    metadata,
    sa.Column("name", sa.String(200), primary_key=True),
    sa.Column("slots", sa.Integer, nullable=False),
    sa.Column("seen", sa.Double, nullable=False),
)


def connect(url: str) -> sa.Engine:
    """An engine for ``url``; opens nothing yet."""
    address = sa.make_url(url)
    if address.drivername == "postgresql":
        address = address.set(drivername=postgres.DRIVER)
    postgres.install()
    if address.get_backend_name() != "sqlite":
        return sa.create_engine(address, pool_pre_ping=True)
    if address.database:
        Path(address.database).parent.mkdir(parents=True, exist_ok=True)
    engine = sa.create_engine(address, connect_args={"timeout": 30})
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


class Repository:
    """Whatever reads and changes tables. clock: seconds since 1970."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time) -> None:
        self.engine = engine
        self.clock = clock


def columns_of(table: sa.Table, kind: type[Any]) -> list[sa.Column[Any]]:
    """The columns that the fields of a dataclass are named after."""
    return [table.c[f.name] for f in fields(kind)]


def rows_of(result: sa.Result[Any], kind: type[Row]) -> list[Row]:
    """Rows of these columns as instances of the dataclass."""
    return [kind(**row) for row in result.mappings()]


def newest(query: sa.Select[Any], table: sa.Table, limit: int, before: tuple[float, str] | None) -> sa.Select[Any]:
    """The newest rows first; before: (created, id) of the last one already seen."""
    c = table.c
    if before is not None:
        created, identifier = before
        query = query.where(sa.or_(c.created < created, sa.and_(c.created == created, c.id < identifier)))
    return query.order_by(c.created.desc(), c.id.desc()).limit(limit)


@contextmanager
def reading(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A connection that only reads: it waits for no writer."""
    with engine.connect().execution_options(tomosim_reading=True) as connection:
        yield connection


def outlast(action: Callable[[], Result], give_up: Callable[[], bool]) -> Result:
    """What ``action`` returns; tried again and again where the database does not answer.

    raises: the errors ``AWAY`` where it does not and ``give_up`` says so
    """
    while True:
        try:
            return action()
        except AWAY as error:
            if give_up():
                raise
            log.warning(
                "the database does not answer; tried again in %g s", RETRY_SECONDS, extra={"error": repr(error)}
            )
        time.sleep(RETRY_SECONDS)


def _prepare_sqlite(connection: Any, record: Any) -> None:
    connection.isolation_level = None  # transactions begin where _begin_sqlite says so
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "busy_timeout=30000", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: sa.Connection) -> None:
    # A transaction that reads first and writes later fails at once where another one wrote meanwhile, whatever the
    # busy timeout: writers take the lock at the beginning.
    reading = connection.get_execution_options().get("tomosim_reading", False)
    connection.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")
