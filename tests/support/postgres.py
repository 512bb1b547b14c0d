"""PostgreSQL servers of the tests."""

import os
import shutil
import signal
import subprocess
import tempfile
import uuid
from pathlib import Path

import sqlalchemy as sa

from tests.support.services import need
from tests.support.waiting import wait_for
from worker.records import schema
from worker.records.database import connect


class Postgres:
    """A PostgreSQL server of our own on a Unix socket.

    raises: Missing where the programs are not installed
    """

    def __init__(self) -> None:
        # Debian keeps the server's programs off the PATH.
        folders = [os.environ["PATH"], *map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True))]
        programs = os.pathsep.join(folders)
        initdb, self._program = (need(name, "postgresql", programs) for name in ("initdb", "postgres"))
        self.folder = Path(tempfile.mkdtemp(prefix="pg"))
        # PostgreSQL refuses to run as root.
        self._user = "nobody" if os.getuid() == 0 else None
        if self._user:
            shutil.chown(self.folder, self._user)
        self._env = {"PATH": programs, "HOME": str(self.folder)}
        options = ["-U", "tomosim", "--auth=trust", "-N", "-E", "UTF8"]
        subprocess.run(
            [initdb, "-D", self.folder / "database", *options],
            user=self._user,
            cwd=self.folder,
            env=self._env,
            check=True,
            capture_output=True,
        )
        self.url = f"postgresql://tomosim@/postgres?unix_sock={self.folder}/.s.PGSQL.5432"
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Starts the server and waits until it answers."""
        self.process = subprocess.Popen(
            [self._program, "-D", self.folder / "database", "-k", self.folder, "-c", "listen_addresses=", "-F"],
            user=self._user,
            cwd=self.folder,
            env=self._env,
            stderr=subprocess.DEVNULL,
        )
        engine = connect(self.url)

        def answers() -> bool:
            try:
                engine.connect().close()
                return True
            except sa.exc.DBAPIError:
                assert self.process is not None
                assert self.process.poll() is None, "postgres has ended"
                return False

        wait_for(answers, "the start of PostgreSQL")
        engine.dispose()

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """Ends the server without waiting for clients. how: SIGINT (fast) or SIGQUIT (immediate, as after a crash)"""
        if self.process is not None:
            self.process.send_signal(how)
            self.process.wait(20)
            self.process = None

    def remove(self) -> None:
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)


def create_database(postgres_url: str) -> str:
    """URL of a new database of a server, with all tables."""
    name = f"service_{uuid.uuid4().hex[:12]}"
    engine = connect(postgres_url)
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name}"))
    engine.dispose()
    url = postgres_url.replace("/postgres?", f"/{name}?")
    engine = connect(url)
    schema.upgrade(engine)
    engine.dispose()
    return url
