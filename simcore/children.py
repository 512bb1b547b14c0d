"""Child processes that run modules of these packages, whatever lies in the current folder.

``python -m`` puts the current folder first on the path: a user's own ``worker.py`` there would be taken for ours. A
child is told to leave it out (-P), and where these packages lie: they need not be installed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def command(module: str, *arguments: str) -> list[str]:
    """The command that runs a module of these packages; wants ``environment``."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment(**more: str) -> dict[str, str]:
    """The environment of this process, with the folder of these packages first on Python's path."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return {**os.environ, **more, "PYTHONPATH": path}
