"""The science of tomosim: phantom, mesh, compression, warp, projection, reconstruction, DICOM.

Nothing here knows of the service (``api``, ``worker``). The way of the data is told in docs/stages.md,
axes, frames, units and symbols in docs/conventions.md.
"""

import os

# One threading layer for every platform: workqueue needs no OpenMP or TBB library, survives being started
# in a spawned child, and divides work statically. Set before numba is first imported.
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")

__version__ = "0.1.0"
