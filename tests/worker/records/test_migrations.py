"""Migrations: they make what the code describes, go there and back, and refuse what they do not know."""

import multiprocessing
import subprocess
import sys
import time

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext

from simcore.core.errors import StoreError
from worker.records import schema
from worker.records.database import connect, simulations
from worker.records.migrations.tables import metadata
from worker.serve.processes import environment

SIMULATION = {"id": "1" * 32, "state": "queued", "specification": {}, "estimate": {}, "queue": "batch", "created": 1.0}


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.needs_postgresql)])
def engine(request, tmp_path):
    """A database that was migrated from nothing; tests change its tables."""
    if request.param == "sqlite":
        database = connect(f"sqlite:///{tmp_path / 'tomosim.db'}")
    else:
        database = connect(request.getfixturevalue("postgres_url"))
        request.getfixturevalue("empty_postgres")()
    schema.upgrade(database)
    yield database
    database.dispose()


def differences(engine):
    with engine.connect() as connection:
        return compare_metadata(MigrationContext.configure(connection, opts={"compare_type": True}), metadata)


def tables(engine):
    return set(sa.inspect(engine).get_table_names())


def test_migrated_tables_are_those_of_the_code(engine):
    assert differences(engine) == []
    with engine.begin() as connection:
        connection.execute(sa.text("DROP INDEX simulations_by_state"))
    assert differences(engine) != []


def test_down_to_nothing_and_up_again(engine):
    schema.downgrade(engine, "base")
    assert tables(engine) == {"alembic_version"}
    assert schema.current(engine) is None
    schema.upgrade(engine)
    assert differences(engine) == []
    assert schema.current(engine) == schema.newest()


def test_every_migration_goes_back_and_keeps_the_simulations(engine):
    with engine.begin() as connection:
        connection.execute(simulations.insert().values(SIMULATION))
    schema.downgrade(engine, schema.BASELINE)
    schema.upgrade(engine)
    assert differences(engine) == []
    with engine.connect() as connection:
        assert connection.scalars(sa.select(simulations.c.id)).all() == [SIMULATION["id"]]
        if engine.dialect.name == "sqlite":
            assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1


def test_a_database_of_a_newer_program_is_refused(engine):
    with engine.begin() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '9999_future'"))
    for action in (schema.prepare, schema.upgrade, lambda e: schema.downgrade(e, "base")):
        with pytest.raises(StoreError, match=r"9999_future.*newer tomosim"):
            action(engine)


def test_a_database_that_is_behind(engine):
    """SQLite is upgraded by whoever opens it; any other database by the operator alone."""
    schema.downgrade(engine, "base")
    if engine.dialect.name == "sqlite":
        schema.prepare(engine)
        assert schema.current(engine) == schema.newest()
    else:
        with pytest.raises(StoreError, match=r"no tables.*tomosim db upgrade"):
            schema.prepare(engine)
        assert schema.current(engine) is None


def test_a_database_from_before_the_first_migration(engine):
    schema.downgrade(engine, schema.BASELINE)
    with engine.begin() as connection:
        connection.execute(sa.text("DROP TABLE alembic_version"))
        connection.execute(sa.text("CREATE TABLE schema_version (version INTEGER PRIMARY KEY)"))
        connection.execute(sa.text("INSERT INTO schema_version VALUES (1)"))
    schema.upgrade(engine)
    assert schema.current(engine) == schema.newest()
    assert "schema_version" not in tables(engine)
    assert differences(engine) == []


def test_an_unknown_revision_names_those_there_are(engine):
    with pytest.raises(StoreError, match=rf"'0000_no'.*{schema.BASELINE}, base"):
        schema.downgrade(engine, "0000_no")
    assert schema.current(engine) == schema.newest()


def _open(url, at):
    while time.time() < at:
        pass
    schema.upgrade(connect(url))


def test_several_processes_start_at_once(engine):
    schema.downgrade(engine, "base")
    url = engine.url.render_as_string(hide_password=False)
    engine.dispose()
    spawn = multiprocessing.get_context("spawn")
    at = time.time() + 2
    processes = [spawn.Process(target=_open, args=(url, at)) for _ in range(4)]
    for p in processes:
        p.start()
    for p in processes:
        p.join()
    assert [p.exitcode for p in processes] == [0, 0, 0, 0]
    assert differences(engine) == []


def test_by_command(make_settings, backend, request):
    settings = make_settings()
    if backend:
        request.getfixturevalue("empty_postgres")()
        settings = make_settings(database_url=request.getfixturevalue("postgres_url"))

    def db(*words):
        command = [sys.executable, "-m", "tomosim", "db", *words]
        return subprocess.run(command, env=environment(settings), capture_output=True, text=True)

    assert f"no tables; this program needs: {schema.newest()}" in db("current").stdout
    assert f"upgraded from nothing to {schema.newest()}" in db("upgrade").stdout
    assert "already at" in db("upgrade").stdout
    assert "now at revision base" in db("downgrade", "base").stdout
    refused = db("downgrade", "nonsense")
    assert refused.returncode == 4
    assert "'nonsense'" in refused.stderr
    assert "Traceback" not in refused.stderr
