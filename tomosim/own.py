"""Our packages where a user has modules of the same names: a folder ``api``, a file ``worker.py``."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("simcore", "tomosim_contract", "worker", "api")


def leave_out_current_folder() -> None:
    """For ``python -m tomosim``: Python puts the current folder first on the path, and whatever modules lie there."""
    if sys.path[:1] == [os.getcwd()] and Path.cwd().resolve() != ROOT:
        del sys.path[0]


def take_own() -> None:
    """For the command, which is a process of its own: our packages from where this one lies, whatever the path says."""
    for package in PACKAGES:
        folder = ROOT / package
        loaded = sys.modules.get(package)
        if loaded is not None and Path(loaded.__file__ or "").parent == folder:
            continue
        spec = importlib.util.spec_from_file_location(package, folder / "__init__.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[package] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[package])


def refuse_foreign() -> None:
    """For programs that import ``tomosim``. raises: ImportError where Python takes another ``simcore`` for ours"""
    for package in ("simcore", "tomosim_contract"):
        loaded = sys.modules.get(package)
        spec = importlib.util.find_spec(package) if loaded is None else loaded.__spec__
        origin = None if spec is None else spec.origin
        if origin is not None and Path(origin).resolve().parent != ROOT / package:
            raise ImportError(
                f"Python takes {origin} for the package '{package}' of tomosim: rename it, or take its folder off "
                "Python's path",
                name=package,
                path=origin,
            )
