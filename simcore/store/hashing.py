"""Digests of files, and files that are hashed and go to the disk while others are written."""

from __future__ import annotations

import hashlib
import io
import os
import queue
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

PIECE_BYTES = 1 << 20
"""Content is streamed in pieces of this size."""


def file_digest(path: Path) -> str:
    """sha256 of a file, hexadecimal."""
    with open(path, "rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


@dataclass(frozen=True)
class FileRef:
    """A stored file: digest of its content and size in bytes."""

    sha256: str
    size: int


def file_ref(path: Path) -> FileRef:
    """Digest and size of a file."""
    return FileRef(file_digest(path), path.stat().st_size)


def sync_file(path: Path) -> None:
    with open(path, "rb") as f:
        os.fsync(f.fileno())


class _HashedFile(io.BufferedWriter):
    """A file that is hashed while it is written, as long as what is written to it cannot change any more (bytes, views
    of read-only arrays) and is written in order; else afterwards."""

    def __init__(self, path: Path, pool: ThreadPoolExecutor, closed: Callable[[], None]) -> None:
        super().__init__(io.FileIO(path, "wb"), PIECE_BYTES)
        self._path = path
        self._in_order = True
        self._closed = closed
        self._pieces: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.ref = pool.submit(self._hash)

    def _hash(self) -> FileRef:
        sha256, size = hashlib.sha256(), 0
        while (piece := self._pieces.get()) is not None:
            sha256.update(piece)
            size += memoryview(piece).nbytes
        return FileRef(sha256.hexdigest(), size) if self._in_order else file_ref(self._path)

    def write(self, content: Any) -> int:
        self._in_order &= memoryview(content).readonly
        if self._in_order:
            self._pieces.put(content)
        return super().write(content)

    def seek(self, *arguments: int) -> int:
        self._in_order = False
        return super().seek(*arguments)

    def close(self) -> None:
        if not self.closed:
            try:
                super().close()
                self._closed()
            finally:
                self._pieces.put(None)


class Hashing:
    """Digests of files, two at a time: hashing leaves the interpreter to others. Files that are ``open``-ed here are
    hashed while they are written, and go to the disk while others are."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(2, "hash")
        self._disk = ThreadPoolExecutor(1, "disk")
        self._refs: dict[Path, Future[FileRef]] = {}
        self._synced: list[Future[None]] = []

    def open(self, path: Path) -> BinaryIO:
        """For writing, once."""
        file = _HashedFile(path, self._pool, lambda: self._synced.append(self._disk.submit(sync_file, path)))
        self._refs[path] = file.ref
        return file

    def refs(self, paths: dict[str, Path]) -> dict[str, FileRef]:
        """Digest and size of every file, by name."""
        for path in sorted(paths.values(), key=lambda path: -path.stat().st_size):
            if path not in self._refs:
                self._refs[path] = self._pool.submit(file_ref, path)
        refs = {name: self._refs[path].result() for name, path in paths.items()}
        for synced in self._synced:
            synced.result()  # a disk tells of a failure only once
        return refs

    def __enter__(self) -> Hashing:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._disk.shutdown(cancel_futures=True)
