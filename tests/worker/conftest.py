"""What tests of the service start with: settings on a fresh folder, a database, the fake pipeline."""

import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from worker.database import connect, create_tables
from worker.jobs import Jobs
from worker.settings import Settings

HERE = Path(__file__).parent


class Clock:
    """Seconds that pass only when told."""

    def __init__(self) -> None:
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


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


def empty(engine: sa.Engine) -> None:
    """Removes every table of a PostgreSQL database."""
    with engine.begin() as connection:
        connection.execute(sa.text("DROP SCHEMA public CASCADE"))
        connection.execute(sa.text("CREATE SCHEMA public"))


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.needs_postgresql)])
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[sa.Engine]:
    if request.param == "sqlite":
        made = connect(f"sqlite:///{tmp_path / 'tomosim.db'}")
    else:
        made = connect(request.getfixturevalue("postgres_url"))
        empty(made)
    create_tables(made)
    yield made
    made.dispose()


@pytest.fixture
def jobs(engine: sa.Engine, clock: Clock) -> Jobs:
    return Jobs(engine, lease_seconds=30, clock=clock)


@pytest.fixture
def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def make_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Settings]:
    """Settings on a fresh data folder, with the fake pipeline."""
    for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PYTHONPATH", str(HERE), prepend=os.pathsep)

    def make(**changes: object) -> Settings:
        given = {"data_folder": tmp_path / "data", "pipeline": "fake_pipeline:run", "memory_limit_bytes": 3_000_000_000}
        return Settings.load(**{**given, **changes})

    return make
