"""A store in S3-compatible object storage, for several machines; the same layout as in a folder.

A folder of this machine keeps what was read or written here lately. What comes from the bucket is compared with its
SHA-256 before it is used.

What a record names is in use as long as the record is. A record that is asked for is written again where it is old
(If-Match), so that a collection that is about to remove it (If-Match as well) and its user cannot both succeed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

from simcore.core.canonical import canonical
from simcore.core.errors import StoreError
from simcore.store import bucket_lock
from simcore.store.backend import ReadRecord, Stored, object_name, record_name
from simcore.store.bucket import PARTS_AT_A_TIME, Bucket, Location
from simcore.store.cache import Cache
from simcore.store.folder import Folder
from simcore.store.hashing import FileRef, file_digest
from simcore.store.records import StageRecord, parsed
from simcore.store.workspaces import Workspaces

TOUCH_SECONDS = 12 * 3600.0
CACHE_BYTES = 50_000_000_000


class BucketBackend:
    """The ``Backend`` at ``location``, with its cache and locks of this machine in the root of ``workspaces``.

    cache_bytes: of the cache, as ``Cache.size``.
    touch_seconds: a record older than this is written again when it is asked for; at most half of the grace period of
        whatever collects garbage.
    raises: StoreError where the bucket cannot be used.
    """

    def __init__(
        self,
        workspaces: Workspaces,
        location: Location,
        cache_bytes: int = CACHE_BYTES,
        touch_seconds: float = TOUCH_SECONDS,
    ) -> None:
        self.bucket = Bucket(location)
        self.folder = Folder(workspaces)
        self.cache = Cache(self.folder, cache_bytes)
        self.touch_seconds = touch_seconds
        self._identity = _identity(self.folder)

    def check(self) -> None:
        self.folder.check()
        self.bucket.check()

    def require_room(self, needed: int) -> None:
        self.folder.require_room(0)  # what the bucket holds is not known; the cache makes room for itself

    def sweep(self, older_than_seconds: float) -> None:
        self.folder.sweep(older_than_seconds)
        self.bucket.abort_uploads(time.time() - older_than_seconds)

    def path(self, ref: FileRef) -> Path:
        """raises: StoreError "object-missing", "object-corrupt", "store-unavailable", "storage-full" """

        def fetch(path: Path) -> None:
            if not self.bucket.download(object_name(ref.sha256), path):
                raise StoreError(
                    f"the object {ref.sha256} is not in {self.bucket.location.url} any more: run the case again",
                    code="object-missing",
                )
            if file_digest(path) != ref.sha256:
                raise self._corrupt(ref)

        return self.cache.path(ref, fetch)

    def has(self, *refs: FileRef) -> bool:
        with ThreadPoolExecutor(PARTS_AT_A_TIME) as pool:
            return all(pool.map(self._has, refs))

    def _has(self, ref: FileRef) -> bool:
        head = self.bucket.head(object_name(ref.sha256))
        return head is not None and head.size == ref.size

    def stream(self, ref: FileRef, start: int, length: int) -> Iterator[bytes]:
        """From the bucket. The last piece of a whole object comes only where its digest is right."""
        if self.folder.touch(ref):
            yield from self.folder.stream(ref, start, length)
            return
        pieces = self.bucket.stream(object_name(ref.sha256), start, length)
        yield from self._verified(ref, pieces) if (start, length) == (0, ref.size) else pieces

    def _verified(self, ref: FileRef, pieces: Iterator[bytes]) -> Iterator[bytes]:
        sha256 = hashlib.sha256()
        last = b""
        for piece in pieces:
            sha256.update(piece)
            if last:
                yield last
            last = piece
        if sha256.hexdigest() != ref.sha256:
            raise self._corrupt(ref)
        yield last

    def _corrupt(self, ref: FileRef) -> StoreError:
        return StoreError(
            f"the object {ref.sha256} in {self.bucket.location.url} has other content than its name says: remove it "
            "there and run the case again",
            code="object-corrupt",
        )

    def put(self, path: Path, ref: FileRef) -> None:
        self.folder.put(path, ref)
        self._upload(ref)

    def _upload(self, ref: FileRef) -> None:
        """An old object is written again, so that no collection removes it before its record is there."""
        head = self.bucket.head(object_name(ref.sha256))
        if head is None or head.size != ref.size or head.age > self.touch_seconds:
            self.bucket.upload(self.folder.path(ref), object_name(ref.sha256))

    def read_record(self, key: str) -> ReadRecord | None:
        content, head = self.bucket.get(record_name(key)) or (None, None)
        record = parsed(content, stamped=True)
        return ReadRecord(record, head.tag, head.age) if record and head else None

    def touch_record(self, read: ReadRecord) -> bool:
        young = read.age <= self.touch_seconds
        return young or self.bucket.put(record_name(read.record.key), _stamped(read.record), read.tag) is not None

    def write_record(self, record: StageRecord) -> None:
        # No record without its objects, and none beside a collection that was removing one of them.
        refs = record.outputs.values()
        for _ in range(2):
            self.bucket.put(record_name(record.key), _stamped(record))
            if self.has(*refs):
                break
            for ref in refs:
                self._upload(ref)
        self.cache.trim_now_and_then()

    def read(self, name: str) -> bytes | None:
        there = self.bucket.get(name)
        return there and there[0]

    def write(self, name: str, content: bytes) -> None:
        self.bucket.put(name, content)

    def list(self, prefix: str) -> Iterator[Stored]:
        return (Stored(head.name, head.size, head.modified) for head in self.bucket.list(prefix))

    def remove(self, name: str, unused_since: float) -> bool:
        head = self.bucket.head(name)
        if head is None:
            return True
        return head.modified < unused_since and self.bucket.delete(name, tag=head.tag)

    @contextlib.contextmanager
    def lock(self, key: str) -> Iterator[None]:
        with self.folder.lock(key), bucket_lock.BucketLock(self.bucket, key, self._identity):
            yield

    def release(self, process: int) -> None:
        bucket_lock.release(self.bucket, process)


def _identity(folder: Folder) -> str:
    """A name of this folder that no other one has."""
    path = folder.root / "identity"
    if not path.exists():
        candidate = folder.workspaces.folder / f"identity-{uuid.uuid4().hex}"
        candidate.write_text(uuid.uuid4().hex)
        with contextlib.suppress(FileExistsError):
            os.link(candidate, path)
        candidate.unlink()
    return path.read_text()


def _stamped(record: StageRecord) -> bytes:
    """Other bytes every time: a record that was written again has another tag."""
    return canonical({"record": asdict(record), "written": uuid.uuid4().hex})
