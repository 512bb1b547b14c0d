"""A store on disk, for the processes of one machine.

A file becomes visible by rename after it is whole and on disk, so a kill at any moment leaves the store as it was or
one stage richer. The time of a file says when it was used; the lock ``in-use`` keeps marking and removing apart.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from simcore.core.canonical import canonical
from simcore.core.errors import StoreError
from simcore.store.backend import ReadRecord, Stored, object_name, record_name
from simcore.store.hashing import PIECE_BYTES, FileRef, sync_file
from simcore.store.records import StageRecord, parsed
from simcore.store.workspaces import Workspaces


def _sync_folder(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


class Folder:
    """The ``Backend`` below the root of ``workspaces``."""

    def __init__(self, workspaces: Workspaces) -> None:
        self.workspaces = workspaces
        self.root = workspaces.root
        for name in ("objects", "stages", "locks"):
            workspaces.make_folder(name)

    def check(self) -> None:
        if not os.access(self.workspaces.folder, os.W_OK):
            raise StoreError(f"{self.root} cannot be written")

    def require_room(self, needed: int) -> None:
        self.workspaces.require_space(needed)

    def sweep(self, older_than_seconds: float) -> None:
        """Removes workspaces, and locks that nobody has waited for since then."""
        for path in (*self.workspaces.folder.iterdir(), *(self.root / "locks").iterdir()):
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > older_than_seconds:
                    shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()

    def path(self, ref: FileRef) -> Path:
        return self.root / object_name(ref.sha256)

    def has(self, *refs: FileRef) -> bool:
        try:
            return all(self.path(ref).stat().st_size == ref.size for ref in refs)
        except FileNotFoundError:
            return False

    def stream(self, ref: FileRef, start: int, length: int) -> Iterator[bytes]:
        with open(self.path(ref), "rb") as file:
            file.seek(start)
            while length > 0 and (piece := file.read(min(PIECE_BYTES, length))):
                length -= len(piece)
                yield piece

    def put(self, path: Path, ref: FileRef) -> None:
        if self.touch(ref):
            path.unlink()
            return
        sync_file(path)
        path.chmod(0o444)
        self._place(path, self.path(ref))

    def touch(self, ref: FileRef) -> bool:
        """Counts an object as used now; False where it is not there."""
        with self._in_use():
            if not self.has(ref):
                return False
            os.utime(self.path(ref))
        return True

    def read_record(self, key: str) -> ReadRecord | None:
        record = parsed(self.read(record_name(key)))
        return ReadRecord(record) if record else None

    def touch_record(self, read: ReadRecord) -> bool:
        with self._in_use():
            try:
                os.utime(self.root / record_name(read.record.key))
            except FileNotFoundError:
                return False
        return True

    def write_record(self, record: StageRecord) -> None:
        self.write(record_name(record.key), canonical(asdict(record)))

    def read(self, name: str) -> bytes | None:
        try:
            return (self.root / name).read_bytes()
        except FileNotFoundError:
            return None

    def write(self, name: str, content: bytes) -> None:
        fd, path = tempfile.mkstemp(dir=self.workspaces.folder)
        with os.fdopen(fd, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        self._place(Path(path), self.root / name)

    def list(self, prefix: str) -> Iterator[Stored]:
        for folder, _, names in os.walk(self.root / prefix):
            for path in (Path(folder, name) for name in names):
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    yield Stored(path.relative_to(self.root).as_posix(), status.st_size, status.st_mtime)

    def remove(self, name: str, unused_since: float) -> bool:
        path = self.root / name
        with self._in_use(fcntl.LOCK_EX):
            try:
                if path.stat().st_mtime >= unused_since:
                    return False
                path.unlink()
            except FileNotFoundError:
                pass
        return True

    @contextlib.contextmanager
    def lock(self, key: str) -> Iterator[None]:
        """Freed by the system where the holder dies."""
        with open(self.root / "locks" / key, "w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def release(self, process: int) -> None:
        """The system has done it."""

    @contextlib.contextmanager
    def _in_use(self, how: int = fcntl.LOCK_SH) -> Iterator[None]:
        """What is seen inside is not removed before it is marked as used."""
        with open(self.root / "in-use", "w") as file:
            fcntl.flock(file, how)
            yield

    def _place(self, path: Path, target: Path) -> None:
        target.parent.mkdir(exist_ok=True)
        path.replace(target)
        _sync_folder(target.parent)
