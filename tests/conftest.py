"""Servers that tests of several folders start: PostgreSQL, S3. All on loopback, all ended with the run."""

import os
import shutil
import subprocess
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from simcore.core.bucket import Location
from worker.database import connect

S3_KEYS = {"access_key": "test-key", "secret_key": "test-secret"}


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    """A PostgreSQL server of our own on a Unix socket; skipped where the programs are not installed."""
    # Debian keeps the server's programs off the PATH.
    folders = [os.environ["PATH"], *map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True))]
    programs = os.pathsep.join(folders)
    if not shutil.which("initdb", path=programs) or not shutil.which("postgres", path=programs):
        pytest.skip("needs PostgreSQL's initdb and postgres: the Debian package postgresql")
    pytest.importorskip("pg8000")
    folder = Path(tempfile.mkdtemp(prefix="pg"))
    # PostgreSQL refuses to run as root.
    user = "nobody" if os.getuid() == 0 else None
    if user:
        shutil.chown(folder, user)
    database = folder / "database"
    env = {"PATH": programs, "HOME": str(folder)}
    subprocess.run(
        [
            shutil.which("initdb", path=programs) or "initdb",
            "-D",
            database,
            "-U",
            "tomosim",
            "--auth=trust",
            "-N",
            "-E",
            "UTF8",
        ],
        user=user,
        cwd=folder,
        env=env,
        check=True,
        capture_output=True,
    )
    server = subprocess.Popen(
        [
            shutil.which("postgres", path=programs) or "postgres",
            "-D",
            database,
            "-k",
            folder,
            "-c",
            "listen_addresses=",
            "-F",
        ],
        user=user,
        cwd=folder,
        env=env,
        stderr=subprocess.DEVNULL,
    )
    url = f"postgresql://tomosim@/postgres?unix_sock={folder}/.s.PGSQL.5432"
    try:
        engine = connect(url)
        for _ in range(100):
            try:
                engine.connect().close()
                break
            except sa.exc.DBAPIError:
                assert server.poll() is None
                time.sleep(0.1)
        engine.dispose()
        yield url
    finally:
        server.terminate()
        server.wait(20)
        shutil.rmtree(folder, ignore_errors=True)


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
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    app = DomainDispatcherApplication(create_backend_app)
    one_at_a_time = threading.Lock()

    def serve(environ, start_response):
        # Conditional writes are atomic, which moto does not promise of requests that run side by side.
        with one_at_a_time:
            return list(app(environ, start_response))

    server = make_server("127.0.0.1", 0, serve, threaded=True)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()


@pytest.fixture
def make_location(s3_endpoint: str) -> Callable[[], Location]:
    """Makes a bucket of its own; where a store in it lies."""

    def make() -> Location:
        import boto3

        name = f"bucket-{uuid.uuid4().hex[:12]}"
        keys = {"aws_access_key_id": "test-key", "aws_secret_access_key": "test-secret"}
        boto3.client("s3", endpoint_url=s3_endpoint, region_name="us-east-1", **keys).create_bucket(Bucket=name)
        return Location(f"s3://{name}/some/prefix", s3_endpoint, **S3_KEYS)

    return make
