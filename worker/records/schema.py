"""The tables in a database against those this program needs: bring them up to date, or refuse.

Migrations lie in ``worker/records/migrations`` (see its README.md) and run in one transaction that several processes
may start at once: SQLite lets one writer in, PostgreSQL one holder of an advisory lock.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from simcore.core.errors import StoreError
from worker.records.database import reading

BASELINE = "0001_baseline"

_LOCK = 7_016_846_123
"""Number of the advisory lock; any number that other users of the database server do not take."""

_BEFORE_MIGRATIONS = sa.table("schema_version", sa.column("version"))
"""What marked a database before there were migrations."""


def prepare(engine: sa.Engine) -> None:
    """What every process does at start: SQLite is upgraded, any other database must have been (``require_current``).

    raises: StoreError "database-version"
    """
    if engine.dialect.name == "sqlite":
        upgrade(engine)
    else:
        require_current(engine)


def newest() -> str:
    """The revision this program needs."""
    head = ScriptDirectory.from_config(_config()).get_current_head()
    assert head is not None
    return head


def current(engine: sa.Engine) -> str | None:
    """The revision of a database; None where it has no tables, or those from before the first migration."""
    with reading(engine) as connection:
        return _revision(connection)


def require_current(engine: sa.Engine) -> None:
    """raises: StoreError "database-version" where the tables are not those this program needs."""
    revision = current(engine)
    if revision == newest():
        return
    _refuse_newer(revision)
    raise StoreError(
        f"the database has {f'revision {revision}' if revision else 'no tables'} and this program needs revision "
        f"{newest()}: run 'tomosim db upgrade' once (after a backup), then start again",
        code="database-version",
    )


def upgrade(engine: sa.Engine) -> None:
    """Brings the tables up to date; does nothing where they are.

    raises: StoreError "database-version" where the database was made by a newer program.
    """
    if current(engine) == newest():
        return
    with _alone(engine) as connection:
        _refuse_newer(_revision(connection))
        _adopt(connection)
        command.upgrade(_config(connection), "head")


def downgrade(engine: sa.Engine, revision: str) -> None:
    """Takes migrations back to ``revision`` ("base": no tables). What later ones added is lost.

    raises: StoreError "database-version" where there is no such revision, or none to go back to.
    """
    known = [script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()]
    with _alone(engine) as connection:
        present = _revision(connection)
        _refuse_newer(present)
        earlier = known[known.index(present) :] if present else []
        if revision not in (*earlier, "base"):
            raise StoreError(
                f"revision {revision!r}: the database can go back to {', '.join([*earlier, 'base'])}",
                code="database-version",
            )
        command.downgrade(_config(connection), revision)


def write_migration(engine: sa.Engine, revision: str, message: str) -> None:
    """Writes a migration from the newest one to the tables of the code. engine: an empty database to compare with."""
    with engine.begin() as connection:
        command.upgrade(_config(connection), "head")
        command.revision(_config(connection), message, autogenerate=True, rev_id=revision)


def _config(connection: sa.Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", "worker.records:migrations")
    config.set_main_option("file_template", "%%(rev)s")
    config.attributes["connection"] = connection
    return config


@contextmanager
def _alone(engine: sa.Engine) -> Iterator[sa.Connection]:
    """A transaction that only one process at a time is inside of."""
    with engine.connect() as connection:
        sqlite = connection.dialect.name == "sqlite"
        if sqlite:
            # Altering a table copies and drops it, which would delete the rows that refer to it. Outside of a
            # transaction, as SQLite wants it.
            _pragma(connection, "foreign_keys=OFF")
        try:
            with connection.begin():
                if connection.dialect.name == "postgresql":
                    connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK)))
                yield connection
                if sqlite and (broken := connection.exec_driver_sql("PRAGMA foreign_key_check").all()):
                    raise AssertionError(f"a migration left rows that refer to nothing: {broken[:3]}")
        finally:
            if sqlite:
                _pragma(connection, "foreign_keys=ON")


def _pragma(connection: sa.Connection, what: str) -> None:
    raw = connection.connection.dbapi_connection
    assert raw is not None
    cursor = raw.cursor()
    cursor.execute(f"PRAGMA {what}")
    cursor.close()


def _revision(connection: sa.Connection) -> str | None:
    return MigrationContext.configure(connection).get_current_revision()


def _refuse_newer(revision: str | None) -> None:
    known = {script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()}
    if revision is not None and revision not in known:
        raise StoreError(
            f"the database has revision {revision}, which this program does not know (it knows {newest()}): a newer "
            "tomosim made it; use that one, or restore the backup from before",
            code="database-version",
        )


def _adopt(connection: sa.Connection) -> None:
    """A database from before the first migration has the tables of the baseline already."""
    if sa.inspect(connection).has_table(_BEFORE_MIGRATIONS.name):
        command.stamp(_config(connection), BASELINE)
        connection.exec_driver_sql(f"DROP TABLE {_BEFORE_MIGRATIONS.name}")
