"""Copies on this machine of objects that lie in a bucket. Objects never change, so a copy is never stale."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from simcore.store.backend import OBJECTS
from simcore.store.folder import Folder
from simcore.store.hashing import FileRef

KEEP_SECONDS = 3600.0
"""What was used within this time stays in the cache whatever its size."""

TRIM_SECONDS = 60.0


class Cache:
    """The objects in ``folder``. size: beyond so many bytes, what was used least lately is removed."""

    def __init__(self, folder: Folder, size: int) -> None:
        self.folder = folder
        self.size = size
        self._trimmed = time.monotonic()

    def path(self, ref: FileRef, fetch: Callable[[Path], None]) -> Path:
        """Where the copy lies. fetch: writes a verified copy to a path, where there is none yet.

        raises: StoreError "storage-full", and what ``fetch`` raises
        """
        path = self.folder.path(ref)
        if not self.folder.touch(ref):
            with self.folder.lock(f"fetch-{ref.sha256}"):
                if not self.folder.touch(ref):
                    self._fetch(ref, path, fetch)
        return path

    def _fetch(self, ref: FileRef, path: Path, fetch: Callable[[Path], None]) -> None:
        self.trim_now_and_then()
        workspaces = self.folder.workspaces
        workspaces.require_space(ref.size)
        path.parent.mkdir(exist_ok=True)
        with workspaces.fresh() as workspace:
            partial = workspace / ref.sha256
            fetch(partial)
            partial.chmod(0o444)
            partial.replace(path)

    def trim(self) -> None:
        """Removes what was used least lately, until the cache is as small as it may be."""
        copies = sorted(self.folder.list(OBJECTS), key=lambda copy: copy.used)
        size = sum(copy.size for copy in copies)
        unused_since = time.time() - KEEP_SECONDS
        for copy in copies:
            if size <= self.size or copy.used >= unused_since:
                return
            if self.folder.remove(copy.name, unused_since):
                size -= copy.size

    def trim_now_and_then(self) -> None:
        if time.monotonic() - self._trimmed > TRIM_SECONDS:
            self._trimmed = time.monotonic()
            self.trim()
