"""The content-addressed store of stage results: what is kept, computed once, and removed; not where it lies.

key = sha256(canonical JSON of stage, stage version, parameters, digests of the inputs). A record is there only when
all its objects are, so a kill at any moment leaves the store as it was or one stage richer.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from simcore.store.backend import OBJECTS, RECORDS, Backend, Stored, object_name, record_name
from simcore.store.folder import Folder
from simcore.store.hashing import FileRef, Hashing, file_ref, sync_file
from simcore.store.records import Begun, Commits, Compute, StageRecord, completed, stage_key
from simcore.store.workspaces import MIN_FREE_BYTES, Workspaces

LARGE_BYTES = 64 << 20
"""Outputs from this size on take a disk so long that it pays to go on meanwhile."""


class Store:
    """A store with its workspaces in ``root``, a folder that is made where it is not there.

    backend: where objects, records and documents lie; ``root`` itself if nothing else is said. Safe for many threads
        and processes, of as many machines as the backend.
    raises: StoreError where the folder cannot be made
    """

    def __init__(
        self,
        root: Path | str,
        min_free_bytes: int = MIN_FREE_BYTES,
        backend: Callable[[Workspaces], Backend] = Folder,
    ) -> None:
        self.root = Path(root).absolute()
        self.workspaces = Workspaces(self.root, min_free_bytes)
        self.backend = backend(self.workspaces)

    def check(self) -> None:
        """raises: StoreError where nothing can be stored."""
        self.backend.check()

    # Objects

    def path(self, ref: FileRef) -> Path:
        """Where the content lies on this machine; fetched where it does not.

        raises: StoreError "object-missing", "object-corrupt", "store-unavailable", "storage-full"
        """
        return self.backend.path(ref)

    def has(self, ref: FileRef) -> bool:
        """Whether the content is there and whole in size."""
        return self.backend.has(ref)

    def stream(self, ref: FileRef, start: int = 0, length: int | None = None) -> Iterator[bytes]:
        """The content from byte ``start`` on, piece by piece."""
        return self.backend.stream(ref, start, ref.size - start if length is None else length)

    def add(self, path: Path, ref: FileRef | None = None) -> FileRef:
        """Moves a file of the same disk into the store. ref: of the file, where it is known already."""
        ref = ref or file_ref(path)
        self.backend.put(path, ref)
        return ref

    def materialise(self, ref: FileRef, target: Path) -> None:
        """Copies stored content to ``target`` (a copy: what a client does to it cannot harm the store)."""
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".partial")
        shutil.copyfile(self.path(ref), partial)
        partial.replace(target)

    # Stages

    def get(self, key: str) -> StageRecord | None:
        """The record of ``key``, or None where it was never made or one of its files is gone or cut short."""
        read = self.backend.read_record(key)
        if read is None or not self.backend.has(*read.record.outputs.values()):
            return None
        return read.record if self.backend.touch_record(read) else None  # else just removed

    def record(self, key: str) -> StageRecord | None:
        """As ``get``, without looking for the files, and without counting as use."""
        read = self.backend.read_record(key)
        return read.record if read else None

    def lock(self, key: str) -> AbstractContextManager[None]:
        """Only one process at a time is inside for a key."""
        return self.backend.lock(key)

    def commit(self, record: StageRecord, folder: Path) -> None:
        """Moves the outputs of a stage from ``folder`` into the store and then records the stage."""
        for name, ref in record.outputs.items():
            self.add(folder / name, ref)
        self.backend.write_record(record)

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
            begun = self.begin(stage_key(stage, version, parameters, inputs), stage, version, compute, at_once)
        return begun.record.result(), begun.cached

    def begin(self, key: str, stage: str, version: int, compute: Compute, later: Commits) -> Begun:
        """The stage of ``key``, computed where it is not there yet.

        later: takes the waiting for digests and for the disk off the caller where the outputs are large. Such a stage
        is surely in the store only when it is closed.
        """
        if record := self.get(key):
            return Begun.there(record)
        with contextlib.ExitStack() as resources:
            resources.enter_context(self.lock(key))
            if record := self.get(key):
                return Begun.there(record)
            folder = resources.enter_context(self.workspace())
            hashing = resources.enter_context(Hashing())
            report, seconds, peak = compute(folder, key, hashing)
            names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
            paths = {name: folder / name for name in names}

            def record_of_files() -> StageRecord:
                return StageRecord(stage, version, key, hashing.refs(paths), report, round(seconds, 4), peak)

            if sum(p.stat().st_size for p in paths.values()) < LARGE_BYTES:
                record = record_of_files()
                self.commit(record, folder)
                return Begun(completed(record), cached=False)
            hashed = later.hash(record_of_files)
            later.take(partial(self._sync_and_commit, list(paths.values()), hashed, folder), resources.pop_all())
            return Begun(hashed, cached=False)

    def _sync_and_commit(self, paths: list[Path], hashed: Future[StageRecord], folder: Path) -> None:
        """As ``commit``, for files that are still being hashed: meanwhile the disk takes them."""
        try:
            for path in paths:
                sync_file(path)
        finally:
            wait([hashed])  # who hashes needs the files, even where the disk does not take them
        self.commit(hashed.result(), folder)

    # Workspaces

    def workspace(self) -> AbstractContextManager[Path]:
        """A fresh folder on the disk of the store, removed at the end."""
        return self.workspaces.fresh()

    def require_space(self, needed: int) -> None:
        """raises: StoreError "storage-full" where ``needed`` bytes in workspaces would leave too little free."""
        self.workspaces.require_space(needed)

    def require_room(self, needed: int) -> None:
        """As ``require_space``, for results of ``needed`` bytes wherever the store keeps them."""
        self.backend.require_room(needed)

    def remove_workspaces(self, process: int) -> None:
        """Removes what a process of this machine left in workspaces and locks; for whoever has just killed it."""
        self.workspaces.remove(process)
        self.backend.release(process)

    def sweep_temporary(self, older_than_seconds: float = 24 * 3600) -> None:
        """Removes what killed runs have left unfinished, and locks that nobody has waited for since then."""
        self.backend.sweep(older_than_seconds)

    # Documents

    def write_document(self, folder: str, name: str, content: bytes) -> None:
        """Keeps a small document, replacing the one of this name."""
        self.backend.write(f"{folder}/{name}", content)

    def read_document(self, folder: str, name: str) -> bytes | None:
        """A document, or None where there is none of this name."""
        return self.backend.read(f"{folder}/{name}")

    def documents(self, folder: str) -> list[str]:
        """The names of all documents of a folder, sorted."""
        return sorted(stored.name.removeprefix(f"{folder}/") for stored in self.backend.list(f"{folder}/"))

    # What a collection of garbage works with

    def records(self) -> Iterator[Stored]:
        """Every stage record; name: its key."""
        return self._listed(RECORDS, ".json")

    def objects(self) -> Iterator[Stored]:
        """Every object; name: its digest."""
        return self._listed(OBJECTS, "")

    def remove_record(self, key: str, unused_since: float) -> bool:
        """Removes a record that was not used since then; whether it is gone."""
        return self.backend.remove(record_name(key), unused_since)

    def remove_object(self, sha256: str, unused_since: float) -> bool:
        """Removes an object that was not written since then; whether it is gone. For what no record names."""
        return self.backend.remove(object_name(sha256), unused_since)

    def _listed(self, prefix: str, suffix: str) -> Iterator[Stored]:
        for stored in self.backend.list(prefix):
            if stored.name.endswith(suffix):
                yield replace(stored, name=stored.name.rpartition("/")[2].removesuffix(suffix))
