"""PostgreSQL by pg8000, with the errors of a server that goes away said as errors of the database.

pg8000 lets errors of the socket out as they are where it reads the first bytes of an answer, and calls it a mere
DatabaseError that the server ends a session or takes none yet. SQLAlchemy takes neither for a lost connection.
"""

from __future__ import annotations

import contextlib
import functools
import struct
from collections.abc import Callable
from typing import Any

from sqlalchemy.dialects import registry
from sqlalchemy.dialects.postgresql.pg8000 import PGDialect_pg8000

DRIVER = "postgresql+pg8000"
"""Driver of a URL that names none; the extra ``postgres`` installs it."""

AWAY_STATES = ("57P01", "57P02", "57P03", "08000", "08001", "08003", "08004", "08006")
"""SQLSTATE of a server that shuts down, has crashed, does not take connections yet, or has lost one."""


def _translated(name: str) -> Callable[..., Any]:
    """A method of SQLAlchemy's dialect, with the errors of a server that is away as ``OperationalError``."""
    method = getattr(PGDialect_pg8000, name)

    @functools.wraps(method)
    def call(self: Dialect, *args: Any, **options: Any) -> Any:
        dbapi: Any = self.loaded_dbapi
        try:
            return method(self, *args, **options)
        except (OSError, EOFError, struct.error) as error:
            raise dbapi.OperationalError(f"network error: {type(error).__name__}: {error}") from error
        except dbapi.DatabaseError as error:
            fields = error.args[0] if error.args else None
            if isinstance(fields, dict) and fields.get("C") in AWAY_STATES:
                raise dbapi.OperationalError(fields) from error
            raise

    return call


class Dialect(PGDialect_pg8000):
    """SQLAlchemy's dialect. Everything in it that talks to the server is here."""

    supports_statement_cache = True

    connect = _translated("connect")
    do_ping = _translated("do_ping")
    do_execute = _translated("do_execute")
    do_executemany = _translated("do_executemany")
    do_execute_no_params = _translated("do_execute_no_params")
    do_commit = _translated("do_commit")
    do_rollback = _translated("do_rollback")

    def is_disconnect(self, e: Any, connection: Any, cursor: Any) -> bool:
        lost: bool = super().is_disconnect(e, connection, cursor)  # type: ignore[no-untyped-call]
        return lost or isinstance(e, self.loaded_dbapi.OperationalError)

    def do_terminate(self, dbapi_connection: Any) -> None:
        with contextlib.suppress(OSError, self.loaded_dbapi.Error):  # the other end is gone: nothing is left to close
            dbapi_connection.close()


def install() -> None:
    """Makes this the dialect of URLs that begin with ``postgresql+pg8000``."""
    registry.register("postgresql.pg8000", __name__, "Dialect")
