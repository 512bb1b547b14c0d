"""Folders on the disk of a machine in which results are written before they are whole."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from simcore.core.errors import StoreError

MIN_FREE_BYTES = 1 << 30
"""A stage is not started where the disk has less free space than this."""


def workspace_prefix(process: int) -> str:
    """What the names of all that a process of this machine has for a while begin with."""
    return f"{socket.gethostname()}-{process}-"


class Workspaces:
    """The workspaces of a store, in ``root``/tmp. raises: StoreError where the folder cannot be made"""

    def __init__(self, root: Path, min_free_bytes: int) -> None:
        self.root = root
        self.folder = root / "tmp"
        self.min_free_bytes = min_free_bytes
        self.make_folder("tmp")

    def make_folder(self, name: str) -> None:
        """A folder of this name beside the workspaces. raises: StoreError"""
        try:
            (self.root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"the store folder {self.root} cannot be made: {error.strerror}") from error

    @contextlib.contextmanager
    def fresh(self) -> Iterator[Path]:
        """A fresh folder, removed at the end. raises: StoreError "storage-full" """
        self.require_space(0)
        folder = Path(tempfile.mkdtemp(prefix=workspace_prefix(os.getpid()), dir=self.folder))
        try:
            yield folder
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise StoreError(
                    f"the disk of {self.root} is full; free some space and run again: stages that finished are kept",
                    code="storage-full",
                ) from error
            raise
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def require_space(self, needed: int) -> None:
        """raises: StoreError "storage-full" where ``needed`` bytes would leave less than ``min_free_bytes``."""
        free = shutil.disk_usage(self.root).free
        if free - needed < self.min_free_bytes:
            raise StoreError(
                f"{self.root} has {free / 1e9:.1f} GB free; {(needed + self.min_free_bytes) / 1e9:.1f} GB are "
                "needed: free some space or choose another data folder",
                code="storage-full",
            )

    def remove(self, process: int) -> None:
        """Removes those of a process of this machine."""
        for path in self.folder.glob(workspace_prefix(process) + "*"):
            shutil.rmtree(path, ignore_errors=True)
