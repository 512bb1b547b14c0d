"""``python -m worker.delivery``: a worker that delivers, with the settings of the environment."""

import sys

from simcore.core.errors import SimulationError
from worker import logs
from worker.settings import Settings


def main() -> int:
    from worker.delivery.app import DeliveryWorker

    settings = Settings.load()
    logs.configure(settings.log_level)
    return DeliveryWorker(settings).run()


try:
    sys.exit(main())
except SimulationError as error:
    sys.exit(f"tomosim delivery worker: {error}")
