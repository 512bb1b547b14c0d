"""``python -m worker``: a worker with the settings of the environment."""

import sys

from simcore import missing
from simcore.core.errors import SimulationError

try:
    from worker.compute.app import main

    sys.exit(main())
except SimulationError as error:
    sys.exit(f"tomosim worker: {error}")
except ImportError as error:
    if (reason := missing.explain(error)) is None:
        raise
    sys.exit(f"tomosim worker: {reason}")
