"""Servers that tests of several folders start: PostgreSQL, redis-server, S3. All on loopback, all ended with the run.

Tests of the service run on SQLite, a folder and the embedded broker; with ``--production`` those that can tell the
difference run again on PostgreSQL, S3 and redis-server.
"""

import functools
import shutil
import tempfile
import time
import uuid
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from simcore.store.bucket import Location
from simcore.store.store import Store
from tests.support import object_storage
from tests.support.ports import free_port
from tests.support.postgres import Postgres, create_database
from tests.support.servers import program
from tests.support.services import Missing, need
from worker.records import schema
from worker.records.database import connect
from worker.records.migrations.tables import metadata


def pytest_addoption(parser: pytest.Parser) -> None:
    missing = "tests fail, and are not skipped, where a Debian package that they need is not installed"
    parser.addoption("--require-services", action="store_true", help=missing)
    parser.addoption("--production", action="store_true", help="on PostgreSQL, S3 and redis-server, what uses them")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With ``--require-services`` a test that is skipped for want of a service fails, with the reason."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and item.config.getoption("--require-services"):
        marked = any(mark.name.startswith("needs_") for mark in item.iter_markers())
        if marked or (call.excinfo is not None and call.excinfo.errisinstance(Missing)):
            reason = call.excinfo.value if call.excinfo is not None else "skipped"
            report.outcome = "failed"
            report.longrepr = f"{item.nodeid}: {reason} (--require-services)"
    return report


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--production"):
        return
    chosen = [i for i in items if _tells_services_apart(i)]
    config.hook.pytest_deselected(items=[i for i in items if i not in chosen])
    items[:] = chosen


def _tells_services_apart(item: pytest.Item) -> bool:
    if item.get_closest_marker("embedded"):
        return False
    if isinstance(item, pytest.Function) and hasattr(item, "callspec") and "engine" in item.callspec.params:
        return bool(item.callspec.params["engine"] == "postgresql")  # repositories choose their database themselves
    return not {"backend", "module_backend"}.isdisjoint(getattr(item, "fixturenames", ()))


@pytest.fixture(name="free_port")
def free_port_fixture() -> int:
    return free_port()


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    """Sets how many threads numba's kernels run on; at the end it is as it was. Skips where one is all there is."""
    import numba

    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one core: there are no two threads to compare one with")
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.fixture(scope="session")
def lose() -> Callable[[Store, str], None]:
    """Takes a file out of a store, with the copy that a machine has of what lies in a bucket."""

    def remove(store: Store, sha256: str) -> None:
        assert store.remove_object(sha256, unused_since=time.time() + 3600)
        (store.root / "objects" / sha256[:2] / sha256).unlink(missing_ok=True)

    return remove


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A database file with all tables: a copy of it spares a test the migrations."""
    path = tmp_path_factory.mktemp("template") / "tomosim.db"
    engine = connect(f"sqlite:///{path}")
    schema.upgrade(engine)
    engine.dispose()  # the last connection empties the write-ahead log into the file
    return path


@pytest.fixture(scope="session", autouse=True)
def one_boto3_session(request: pytest.FixtureRequest) -> Iterator[None]:
    """boto3 reads its descriptions of services once for a session, 0.3 s; every store opens one of its own."""
    if not request.config.getoption("--production"):
        yield
        return
    import boto3

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(boto3, "Session", functools.cache(boto3.Session))
        yield


@pytest.fixture
def backend(request: pytest.FixtureRequest) -> dict[str, object]:
    """Settings of database, store and broker for one test: none, or with ``--production`` fresh ones."""
    if not request.config.getoption("--production"):
        return {}
    database = request.getfixturevalue("empty_service_database")
    return _settings(database, request.getfixturevalue("redis_url"), request.getfixturevalue("make_location")())


@pytest.fixture(scope="module")
def module_backend(request: pytest.FixtureRequest) -> dict[str, object]:
    """The same for a service that all tests of a module share."""
    if not request.config.getoption("--production"):
        return {}
    url = request.getfixturevalue("make_database")()
    broker = f"redis+socket://{request.getfixturevalue('redis_server')}?virtual_host={MODULE_REDIS}"
    _empty_redis(broker)
    return _settings(url, broker, request.getfixturevalue("make_location")())


def _settings(database_url: str, broker_url: str, location: Location) -> dict[str, object]:
    return {
        "database_url": database_url,
        "broker_url": broker_url,
        "store_url": location.url,
        "store_endpoint": location.endpoint,
        "store_access_key": location.access_key,
        "store_secret_key": location.secret_key,
    }


@pytest.fixture(scope="session")
def make_database(postgres_url: str) -> Callable[[], str]:
    """Makes a PostgreSQL database with all tables: its URL."""

    return lambda: create_database(postgres_url)


@pytest.fixture(scope="session")
def service_database(make_database: Callable[[], str]) -> str:
    """The database of the tests that share nothing else."""
    return make_database()


@pytest.fixture
def empty_service_database(service_database: str) -> str:
    """The same without a row, and without a connection that a test before has left."""
    others = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database()"
    engine = connect(service_database)
    with engine.begin() as connection:
        connection.execute(sa.text(f"{others} AND pid != pg_backend_pid()"))
        connection.execute(sa.text(f"TRUNCATE {', '.join(metadata.tables)} RESTART IDENTITY CASCADE"))
    engine.dispose()
    return service_database


@pytest.fixture(scope="session")
def redis_server() -> Iterator[str]:
    """Socket of a redis-server of our own; skipped where the program is not installed."""
    redis = need("redis-server", "redis-server")
    folder = Path(tempfile.mkdtemp(prefix="redis"))
    socket = folder / "socket"
    command = [redis, "--port", "0", "--unixsocket", str(socket), "--dir", str(folder), "--save", ""]
    try:
        with program(command, socket.exists, folder / "log"):
            yield str(socket)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def redis_url(redis_server: str) -> str:
    """An empty broker."""
    url = f"redis+socket://{redis_server}?virtual_host=0"
    _empty_redis(url)
    return url


MODULE_REDIS = 1
"""Number of the redis database of services that a module shares."""


def _empty_redis(url: str) -> None:
    import redis

    socket, _, number = url.removeprefix("redis+socket://").partition("?virtual_host=")
    with redis.Redis(unix_socket_path=socket, db=int(number)) as client:
        client.flushdb()


S3_KEYS = {"access_key": "test-key", "secret_key": "test-secret"}


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    """URL of the PostgreSQL server that all tests share."""
    server = Postgres()
    try:
        server.start()
        yield server.url
    finally:
        server.remove()


@pytest.fixture
def own_postgres() -> Iterator[tuple[Postgres, str]]:
    """A PostgreSQL server for one test, which may stop it, and the URL of a database there with all tables."""
    server = Postgres()
    try:
        server.start()
        yield server, create_database(server.url)
    finally:
        server.remove()


@pytest.fixture
def empty_postgres(postgres_url: str) -> Callable[[], None]:
    """Removes every table of the PostgreSQL database."""

    def empty() -> None:
        engine = connect(postgres_url)
        with engine.begin() as connection:
            connection.execute(sa.text("DROP SCHEMA public CASCADE"))
            connection.execute(sa.text("CREATE SCHEMA public"))
        engine.dispose()

    return empty


@pytest.fixture(scope="session")
def s3_endpoint() -> Iterator[str]:
    """URL of an S3 service that keeps everything in memory."""
    with object_storage.served() as url:
        yield url


@pytest.fixture(scope="session")
def s3_bucket(s3_endpoint: str) -> str:
    """Name of a bucket there."""
    import boto3

    keys = {"aws_access_key_id": S3_KEYS["access_key"], "aws_secret_access_key": S3_KEYS["secret_key"]}
    boto3.client("s3", endpoint_url=s3_endpoint, region_name="us-east-1", **keys).create_bucket(Bucket="stages")
    return "stages"


@pytest.fixture(scope="session")
def make_location(s3_endpoint: str, s3_bucket: str) -> Callable[[], Location]:
    """Where a store lies that is empty."""

    def make() -> Location:
        return Location(f"s3://{s3_bucket}/some/{uuid.uuid4().hex[:12]}", s3_endpoint, **S3_KEYS)

    return make
