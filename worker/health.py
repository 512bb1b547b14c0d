"""``python -m worker.health [delivery]``: whether a worker of this machine (that simulates, or delivers) was heard of
lately; a container's health check."""

from __future__ import annotations

import socket
import sys

from worker.records.database import connect
from worker.records.fleet import Fleet
from worker.settings import Settings


def main() -> int:
    """0 where one was, else 1."""
    settings = Settings.load()
    engine = connect(settings.resolved_database_url)
    try:
        alive = Fleet(engine).alive(host=socket.gethostname(), delivery=sys.argv[1:] == ["delivery"])
    finally:
        engine.dispose()
    if not alive:
        print("no worker of this machine was heard of lately", file=sys.stderr)
    return 0 if alive else 1


if __name__ == "__main__":
    sys.exit(main())
