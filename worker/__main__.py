"""``python -m worker``: a worker with the settings of the environment."""

import sys

from simcore.core.errors import SimulationError
from worker.compute.app import main

try:
    sys.exit(main())
except SimulationError as error:
    sys.exit(f"tomosim worker: {error}")
