"""``python -m api``: the API with the settings of the environment."""

import sys

from simcore import missing
from simcore.core.errors import SimulationError

# Streams of events never end by themselves; a server that stops waits for nobody longer than this.
STOP_SECONDS = 2


def main() -> None:
    """Serves until SIGTERM or SIGINT."""
    import uvicorn

    from api.app import create_app
    from worker import logs
    from worker.settings import Settings

    settings = Settings.load()
    logs.configure(settings.log_level)
    uvicorn.run(
        create_app(settings),
        host=settings.host.strip("[]"),
        port=settings.port,
        log_config=None,
        access_log=settings.log_level == "DEBUG",
        timeout_graceful_shutdown=STOP_SECONDS,
        server_header=False,
    )


try:
    main()
except SimulationError as error:
    sys.exit(f"tomosim api: {error}")
except ImportError as error:
    if (reason := missing.explain(error)) is None:
        raise
    sys.exit(f"tomosim api: {reason}")
