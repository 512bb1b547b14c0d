"""Content-addressed store of stage results on disk.

    objects/ab/<sha256>      immutable files, named by the digest of their content
    stages/ab/<key>.json     what a stage made: {output name: digest, size}, report, seconds, peak memory
    locks/<key>              one computation per key, however many processes ask
    in-use                   lock between using and removing
    tmp/                     where results are written before they are whole
    <folder>/<name>          documents of others, such as the notes of uploaded phantoms

A record counts as used when it was made or last asked for, an object when it was last written: what was used lately
is never removed, and ``_in_use`` keeps using and removing apart.

key = sha256(canonical JSON of stage, stage version, parameters, digests of the inputs). A file becomes visible by
rename after it is whole and on disk, so a kill at any moment leaves the store as it was or one stage richer.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future, wait
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from simcore.core.canonical import canonical as canonical
from simcore.core.canonical import digest as digest
from simcore.core.errors import StoreError
from simcore.core.hashing import PIECE_BYTES as PIECE_BYTES
from simcore.core.hashing import FileRef as FileRef
from simcore.core.hashing import Hashing as Hashing
from simcore.core.hashing import file_digest as file_digest
from simcore.core.hashing import file_ref, sync_file
from simcore.core.records import Begun as Begun
from simcore.core.records import Commits as Commits
from simcore.core.records import Compute as Compute
from simcore.core.records import StageRecord as StageRecord
from simcore.core.records import completed
from simcore.core.records import stage_key as stage_key

MIN_FREE_BYTES = 1 << 30
"""A stage is not started where the disk has less free space than this."""


LARGE_BYTES = 64 << 20
"""Outputs from this size on take a disk so long that it pays to go on meanwhile."""


@dataclass(frozen=True)
class Stored:
    """A record (name: its key) or an object (name: its digest) of the store. used: when last, seconds since 1970."""

    name: str
    size: int
    used: float


def _sync_folder(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _stored(folder: Path, suffix: str) -> Iterator[Stored]:
    for path in folder.glob(f"??/*{suffix}"):
        with contextlib.suppress(FileNotFoundError):
            found = path.stat()
            yield Stored(path.name.removesuffix(suffix), found.st_size, found.st_mtime)


def workspace_prefix(process: int) -> str:
    """What the names of all that a process of this machine has for a while begin with."""
    return f"{socket.gethostname()}-{process}-"


class Store:
    """The store below ``root``; made where it is not there. Safe for many threads and processes of one machine."""

    def __init__(self, root: Path | str, min_free_bytes: int = MIN_FREE_BYTES) -> None:
        self.root = Path(root).absolute()
        self.min_free_bytes = min_free_bytes
        try:
            for name in ("objects", "stages", "locks", "tmp"):
                (self.root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"the store folder {self.root} cannot be made: {error.strerror}") from error

    def path(self, ref: FileRef) -> Path:
        """Where the content lies on this machine."""
        return self._local(ref)

    def has(self, ref: FileRef) -> bool:
        """Whether the content is there and whole in size."""
        return self._is_local(ref)

    def stream(self, ref: FileRef, start: int = 0, length: int | None = None) -> Iterator[bytes]:
        """The content from byte ``start`` on, piece by piece."""
        left = ref.size - start if length is None else length
        with open(self.path(ref), "rb") as f:
            f.seek(start)
            while left > 0 and (piece := f.read(min(PIECE_BYTES, left))):
                left -= len(piece)
                yield piece

    def check(self) -> None:
        """raises: StoreError where nothing can be stored."""
        if not os.access(self.root / "tmp", os.W_OK):
            raise StoreError(f"{self.root} cannot be written")

    def get(self, key: str) -> StageRecord | None:
        """The record of ``key``, or None where it was never made or one of its files is gone or cut short."""
        with self._in_use():
            record = self.record(key)
            if record is None or not all(map(self.has, record.outputs.values())):
                return None
            os.utime(self._record_path(key))
        return record

    def record(self, key: str) -> StageRecord | None:
        """As ``get``, without looking for the files, and without counting as use."""
        try:
            return StageRecord.from_json(self._record_path(key).read_bytes())
        except FileNotFoundError:
            return None
        except (ValueError, TypeError, KeyError):
            return None  # an unreadable record is recomputed, not trusted

    @contextlib.contextmanager
    def lock(self, key: str) -> Iterator[None]:
        """Only one process at a time is inside for a key. Freed by the system where the holder dies."""
        with open(self.root / "locks" / key, "w") as f:
            fcntl.flock(f, fcntl.LOCK_EX)
            yield

    @contextlib.contextmanager
    def workspace(self) -> Iterator[Path]:
        """A fresh folder on the disk of the store, removed at the end."""
        self.require_space(0)
        folder = Path(tempfile.mkdtemp(prefix=workspace_prefix(os.getpid()), dir=self.root / "tmp"))
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

    def require_room(self, needed: int) -> None:
        """As ``require_space``, for results of ``needed`` bytes wherever the store keeps them."""
        self.require_space(needed)

    def add(self, path: Path, ref: FileRef | None = None) -> FileRef:
        """Moves a file of the same disk into the store. ref: of the file, where it is known already."""
        ref = ref or file_ref(path)
        target = self._local(ref)
        target.parent.mkdir(exist_ok=True)
        with self._in_use():
            if self._is_local(ref):
                path.unlink()
                os.utime(target)
                return ref
        sync_file(path)
        path.chmod(0o444)
        path.replace(target)
        _sync_folder(target.parent)
        return ref

    def commit(self, record: StageRecord, folder: Path) -> None:
        """Moves the outputs of a stage from ``folder`` into the store and then records the stage."""
        for name, ref in record.outputs.items():
            self.add(folder / name, ref)
        self._write_record(record)

    def materialise(self, ref: FileRef, target: Path) -> None:
        """Copies stored content to ``target`` (a copy: what a client does to it cannot harm the store)."""
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".partial")
        shutil.copyfile(self.path(ref), partial)
        partial.replace(target)

    def run(
        self,
        stage: str,
        version: int,
        parameters: Any,
        inputs: dict[str, str],
        compute: Compute,
    ) -> tuple[StageRecord, bool]:
        """The record of a stage, computed where it is not there yet, and in the store: (record, whether it was
        cached)."""
        with Commits() as at_once:
            found = self.begin(stage_key(stage, version, parameters, inputs), stage, version, compute, at_once)
        return found.record.result(), found.cached

    def begin(self, key: str, stage: str, version: int, compute: Compute, later: Commits) -> Begun:
        """The stage of ``key``, computed where it is not there yet.

        later: takes the waiting for digests and for the disk off the caller where the outputs are large. Such a stage
        is surely in the store only when it is closed.
        """
        if record := self.get(key):
            return Begun.there(record)
        with contextlib.ExitStack() as held:
            held.enter_context(self.lock(key))
            if record := self.get(key):
                return Begun.there(record)
            folder = held.enter_context(self.workspace())
            hashing = held.enter_context(Hashing())
            report, seconds, peak = compute(folder, key, hashing)
            names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
            paths = {name: folder / name for name in names}

            def made() -> StageRecord:
                return StageRecord(stage, version, key, hashing.refs(paths), report, round(seconds, 4), peak)

            if sum(p.stat().st_size for p in paths.values()) < LARGE_BYTES:
                record = made()
                self.commit(record, folder)
                return Begun(completed(record), cached=False)
            hashed = later.hash(made)
            later.take(partial(self._sync_and_commit, list(paths.values()), hashed, folder), held.pop_all())
            return Begun(hashed, cached=False)

    def _sync_and_commit(self, paths: list[Path], hashed: Future[StageRecord], folder: Path) -> None:
        """As ``commit``, for files that are still being hashed: meanwhile the disk takes them."""
        try:
            for path in paths:
                sync_file(path)
        finally:
            wait([hashed])  # who hashes needs the files, even where the disk does not take them
        self.commit(hashed.result(), folder)

    def remove_workspaces(self, process: int) -> None:
        """Removes what a process of this machine left in tmp/; for whoever has just killed it."""
        for p in (self.root / "tmp").glob(workspace_prefix(process) + "*"):
            shutil.rmtree(p, ignore_errors=True)

    def sweep_temporary(self, older_than_seconds: float = 24 * 3600) -> None:
        """Removes what killed runs left in tmp/, and locks that nobody has waited for since then."""
        import time

        for p in (*(self.root / "tmp").iterdir(), *(self.root / "locks").iterdir()):
            with contextlib.suppress(OSError):
                if time.time() - p.stat().st_mtime > older_than_seconds:
                    shutil.rmtree(p, ignore_errors=True) if p.is_dir() else p.unlink()

    def write_document(self, folder: str, name: str, content: bytes) -> None:
        """Keeps a small document, replacing the one of this name."""
        self._write(self.root / folder / name, content)

    def read_document(self, folder: str, name: str) -> bytes | None:
        """A document, or None where there is none of this name."""
        try:
            return (self.root / folder / name).read_bytes()
        except FileNotFoundError:
            return None

    def documents(self, folder: str) -> list[str]:
        """The names of all documents of a folder, sorted."""
        return sorted(p.name for p in (self.root / folder).glob("*"))

    # What a collection of garbage works with

    def records(self) -> Iterator[Stored]:
        """Every stage record."""
        return _stored(self.root / "stages", ".json")

    def objects(self) -> Iterator[Stored]:
        """Every object."""
        return _stored(self.root / "objects", "")

    def remove_record(self, key: str, unused_since: float) -> bool:
        """Removes a record that was not used since then; whether it is gone."""
        return self._remove(self._record_path(key), unused_since)

    def remove_object(self, sha256: str, unused_since: float) -> bool:
        """Removes an object that was not written since then; whether it is gone. For what no record names."""
        return self._remove(self._local(FileRef(sha256, 0)), unused_since)

    def _remove(self, path: Path, unused_since: float) -> bool:
        with self._in_use(fcntl.LOCK_EX):
            try:
                if path.stat().st_mtime >= unused_since:
                    return False
                path.unlink()
            except FileNotFoundError:
                pass
        return True

    @contextlib.contextmanager
    def _in_use(self, how: int = fcntl.LOCK_SH) -> Iterator[None]:
        """What is found inside is not removed before it is marked as used."""
        with open(self.root / "in-use", "w") as f:
            fcntl.flock(f, how)
            yield

    def _local(self, ref: FileRef) -> Path:
        return self.root / "objects" / ref.sha256[:2] / ref.sha256

    def _is_local(self, ref: FileRef) -> bool:
        try:
            return self._local(ref).stat().st_size == ref.size
        except FileNotFoundError:
            return False

    def _record_path(self, key: str) -> Path:
        return self.root / "stages" / key[:2] / f"{key}.json"

    def _write_record(self, record: StageRecord) -> None:
        self._write(self._record_path(record.key), canonical(asdict(record)))

    def _write(self, target: Path, content: bytes) -> None:
        target.parent.mkdir(exist_ok=True)
        fd, name = tempfile.mkstemp(dir=self.root / "tmp")
        with os.fdopen(fd, "wb") as f:
            f.write(content)
            f.flush()
            os.fsync(f.fileno())
        Path(name).replace(target)
        _sync_folder(target.parent)
