"""``python -m worker.delivery``: a worker that delivers, with the settings of the environment."""

import sys

from simcore import missing
from simcore.core.errors import SimulationError


def main() -> int:
    from worker import logs
    from worker.delivery.app import DeliveryWorker
    from worker.settings import Settings

    settings = Settings.load()
    logs.configure(settings.log_level)
    return DeliveryWorker(settings).run()


try:
    sys.exit(main())
except SimulationError as error:
    sys.exit(f"tomosim delivery worker: {error}")
except ImportError as error:
    if (reason := missing.explain(error)) is None:
        raise
    sys.exit(f"tomosim delivery worker: {reason}")
