"""What a store asks of the place where its objects, records and documents lie, and the names they have there.

    objects/ab/<sha256>      immutable files, named by the digest of their content
    stages/ab/<key>.json     what a stage made: {output name: digest, size}, report, seconds, peak memory
    <folder>/<name>          documents of others, such as the notes of uploaded phantoms
    locks/<key>              one computation per key, however many processes ask

A record counts as used when it was made or last asked for, an object when it was last written: what was used lately
is never removed, and using and removing are kept apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from simcore.store.hashing import FileRef
from simcore.store.records import StageRecord

OBJECTS = "objects/"
RECORDS = "stages/"


def object_name(sha256: str) -> str:
    return f"{OBJECTS}{sha256[:2]}/{sha256}"


def record_name(key: str) -> str:
    return f"{RECORDS}{key[:2]}/{key}.json"


@dataclass(frozen=True)
class Stored:
    """Something in the store. size: bytes. used: when last, seconds since 1970."""

    name: str
    size: int
    used: float


@dataclass(frozen=True)
class ReadRecord:
    """A record, and what is known of the writing that was read, where a place has that.

    tag: other with every writing. age: seconds since it was written, by the clock of the place.
    """

    record: StageRecord
    tag: str = ""
    age: float = 0.0


class Backend(Protocol):
    """A place for a store. Safe for many threads and processes.

    raises: StoreError where the place cannot be used
    """

    def check(self) -> None:
        """raises: StoreError where nothing can be stored."""

    def require_room(self, needed: int) -> None:
        """raises: StoreError "storage-full" where there is no room for results of ``needed`` bytes"""

    def sweep(self, older_than_seconds: float) -> None:
        """Removes what killed processes have left unfinished, where it is older."""

    # Objects

    def path(self, ref: FileRef) -> Path:
        """Where the content lies on this machine; brought there where it does not."""

    def has(self, *refs: FileRef) -> bool:
        """Whether all of them are there and whole in size."""

    def stream(self, ref: FileRef, start: int, length: int) -> Iterator[bytes]:
        """Some bytes of an object, piece by piece."""

    def put(self, path: Path, ref: FileRef) -> None:
        """Moves a file from a workspace into the store; it counts as written now even where it is there already."""

    # Records

    def read_record(self, key: str) -> ReadRecord | None:
        """None where it was never made or cannot be read: then it is computed again."""

    def touch_record(self, read: ReadRecord) -> bool:
        """Counts a record as used now; False where it was removed since it was read."""

    def write_record(self, record: StageRecord) -> None:
        """Writes a record, when its objects are there."""

    # Documents, and whatever has a name

    def read(self, name: str) -> bytes | None:
        """A document; None where there is none."""

    def write(self, name: str, content: bytes) -> None:
        """Writes a document, replacing the one of this name."""

    def list(self, prefix: str) -> Iterator[Stored]:
        """All whose name begins so; prefix: ends with a slash."""

    def remove(self, name: str, unused_since: float) -> bool:
        """Removes what was not used since then; whether it is gone."""

    # Locks

    def lock(self, key: str) -> AbstractContextManager[None]:
        """Only one process at a time is inside for a key."""

    def release(self, process: int) -> None:
        """Frees the locks of a process of this machine that was killed."""
