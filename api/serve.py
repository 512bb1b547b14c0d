"""``tomosim serve``: the whole service in one process tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from worker.serve import embedded
from worker.settings import Settings


def serve(host: str | None = None, port: int | None = None, data: Path | None = None) -> int:
    """Runs broker, worker and API until Ctrl-C or SIGTERM; what is not given comes from the environment.

    returns: 0 after an ordered stop, 1 where it could not start or go on.
    raises: SettingsError
    """
    options: dict[str, Any] = {"host": host, "port": port, "data_folder": data}
    return embedded.serve(Settings.load(**{name: value for name, value in options.items() if value is not None}))
