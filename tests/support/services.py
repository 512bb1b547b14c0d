"""Programs of Debian packages that some tests need.

Without them a test is skipped; with ``--require-services`` it fails (tests/conftest.py).
"""

import os
import shutil
from pathlib import Path

import pytest


class Missing(pytest.skip.Exception):
    """What a test needs is not installed."""


def need(name: str, package: str, path: str | None = None) -> str:
    """Path of a program.

    path: folders that are searched instead of those of PATH
    raises: Missing
    """
    program = shutil.which(name, path=path)
    if program is None:
        raise Missing(f"{name} is not installed: needs the Debian package {package}")
    return program


def need_file(file: Path, package: str) -> Path:
    """A file that a package installs. raises: Missing"""
    if not file.exists():
        raise Missing(f"{file} is not installed: needs the Debian package {package}")
    return file


def path_without(folder: Path) -> str:
    """PATH without one of its folders."""
    return os.pathsep.join(f for f in os.environ["PATH"].split(os.pathsep) if Path(f) != folder)
