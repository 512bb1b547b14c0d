"""The stage store in S3-compatible object storage, for several machines; the same layout as in a folder.

A folder of this machine keeps what was read or written here lately. Objects and records never change, so a copy is
never stale; what comes from the bucket is compared with its SHA-256 before it is used.

One computation per key: ``locks/<key>`` is made by a conditional write (If-None-Match), renewed while the holder
lives, and taken over (If-Match) where it was not for ``LOCK_SECONDS``, by the clock of the service; at once where the
holder worked in our own folder, whose lock the system has freed: it is dead. It lies in the bucket, not in a database,
because a computation knows the store alone. Should two machines compute one key after all, both results are whole and
one of them stays.

What a record names is in use as long as the record is. A record that is asked for is written again where it is old
(If-Match), so that a collection that is about to remove it (If-Match as well) and its user cannot both succeed.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
import time
import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

from simcore.core.bucket import PARTS_AT_A_TIME, Bucket, Head, Location
from simcore.core.errors import StoreError
from simcore.core.store import (
    MIN_FREE_BYTES,
    FileRef,
    StageRecord,
    Store,
    Stored,
    canonical,
    file_digest,
    workspace_prefix,
)

LOCK_SECONDS = 120.0
"""A holder that was silent for longer has lost its lock; a stage may keep all threads of a process busy for long."""

POLL_SECONDS = 1.0
TOUCH_SECONDS = 12 * 3600.0
CACHE_BYTES = 50_000_000_000
KEEP_SECONDS = 3600.0
"""What was used within this time stays in the cache whatever its size."""

TRIM_SECONDS = 60.0


class ObjectStore(Store):
    """The store at ``location`` with its cache in ``root``.

    cache_bytes: beyond this, what was used least lately is removed from the cache.
    touch_seconds: a record older than this is written again when it is asked for; at most half of the grace period of
        whatever collects garbage.
    raises: StoreError where the bucket cannot be used.
    """

    def __init__(
        self,
        root: Path | str,
        location: Location,
        min_free_bytes: int = MIN_FREE_BYTES,
        cache_bytes: int = CACHE_BYTES,
        touch_seconds: float = TOUCH_SECONDS,
    ) -> None:
        super().__init__(root, min_free_bytes)
        self.cache_bytes = cache_bytes
        self.touch_seconds = touch_seconds
        self._bucket = Bucket(location)
        self._trimmed = time.monotonic()
        self._identity = _identity(self.root)

    # Objects

    def path(self, ref: FileRef) -> Path:
        """Where the content lies on this machine; fetched where it does not.

        raises: StoreError "object-missing", "object-corrupt", "store-unavailable", "storage-full"
        """
        path = self._local(ref)
        if not self._is_cached(ref):
            with super().lock(f"fetch-{ref.sha256}"):
                if not self._is_cached(ref):
                    self._fetch(ref, path)
        return path

    def has(self, ref: FileRef) -> bool:
        found = self._bucket.head(_object_name(ref.sha256))
        return found is not None and found.size == ref.size

    def stream(self, ref: FileRef, start: int = 0, length: int | None = None) -> Iterator[bytes]:
        """As in a folder, from the bucket. The last piece of a whole object comes only where its digest is right."""
        length = ref.size - start if length is None else length
        if self._is_cached(ref):
            yield from super().stream(ref, start, length)
            return
        pieces = self._bucket.stream(_object_name(ref.sha256), start, length)
        yield from _verified(ref, pieces) if (start, length) == (0, ref.size) else pieces

    def require_room(self, needed: int) -> None:
        self.require_space(0)  # what the bucket holds is not known; the cache makes room for itself

    def add(self, path: Path, ref: FileRef | None = None) -> FileRef:
        ref = super().add(path, ref)
        self._upload(ref)
        return ref

    def _is_cached(self, ref: FileRef) -> bool:
        with self._in_use():
            cached = self._is_local(ref)
            if cached:
                os.utime(self._local(ref))
        return cached

    def _fetch(self, ref: FileRef, path: Path) -> None:
        self._trim_now_and_then()
        self.require_space(ref.size)
        path.parent.mkdir(exist_ok=True)
        with self.workspace() as folder:
            partial = folder / ref.sha256
            if not self._bucket.download(_object_name(ref.sha256), partial):
                raise _missing(self._bucket, ref)
            if file_digest(partial) != ref.sha256:
                raise _corrupt(self._bucket, ref)
            partial.chmod(0o444)
            partial.replace(path)

    def _upload(self, ref: FileRef) -> None:
        """An old object is written again, so that no collection removes it before its record is there."""
        found = self._bucket.head(_object_name(ref.sha256))
        if found is None or found.size != ref.size or found.age > self.touch_seconds:
            self._bucket.upload(self._local(ref), _object_name(ref.sha256))

    # Records

    def get(self, key: str) -> StageRecord | None:
        found = self._bucket.get(_record_name(key))
        record = found and _parsed(found[0])
        if not found or not record:
            return None
        _, head = found
        if head.age > self.touch_seconds and self._bucket.put(_record_name(key), _content(record), head.tag) is None:
            return None  # just removed
        return record if self._all_there(record.outputs.values()) else None

    def record(self, key: str) -> StageRecord | None:
        found = self._bucket.get(_record_name(key))
        return found and _parsed(found[0])

    def _write_record(self, record: StageRecord) -> None:
        # No record without its objects, and none beside a collection that was removing one of them.
        for _ in range(2):
            self._bucket.put(_record_name(record.key), _content(record))
            if self._all_there(record.outputs.values()):
                break
            for ref in record.outputs.values():
                self._upload(ref)
        self._trim_now_and_then()

    def _all_there(self, refs: Iterable[FileRef]) -> bool:
        with ThreadPoolExecutor(PARTS_AT_A_TIME) as pool:
            return all(pool.map(self.has, refs))

    # Locks

    @contextlib.contextmanager
    def lock(self, key: str) -> Iterator[None]:
        with super().lock(key), _RemoteLock(self._bucket, key, self._identity):
            yield

    def remove_workspaces(self, process: int) -> None:
        super().remove_workspaces(process)
        with contextlib.suppress(StoreError):  # they end by themselves
            for held in self._bucket.list("locks/"):
                found = self._bucket.get(held.name)
                if found and found[0].startswith(workspace_prefix(process).encode()):
                    self._bucket.delete(held.name, tag=found[1].tag)

    # Documents

    def write_document(self, folder: str, name: str, content: bytes) -> None:
        self._bucket.put(f"{folder}/{name}", content)

    def read_document(self, folder: str, name: str) -> bytes | None:
        found = self._bucket.get(f"{folder}/{name}")
        return found and found[0]

    def documents(self, folder: str) -> list[str]:
        return sorted(head.name.removeprefix(f"{folder}/") for head in self._bucket.list(f"{folder}/"))

    def check(self) -> None:
        super().check()
        self._bucket.check()

    # What a collection of garbage works with

    def records(self) -> Iterator[Stored]:
        return map(_stored, self._bucket.list("stages/"))

    def objects(self) -> Iterator[Stored]:
        return map(_stored, self._bucket.list("objects/"))

    def remove_record(self, key: str, unused_since: float) -> bool:
        return self._remove_remote(_record_name(key), unused_since)

    def remove_object(self, sha256: str, unused_since: float) -> bool:
        return self._remove_remote(_object_name(sha256), unused_since)

    def _remove_remote(self, name: str, unused_since: float) -> bool:
        found = self._bucket.head(name)
        if found is None:
            return True
        return found.modified < unused_since and self._bucket.delete(name, tag=found.tag)

    def sweep_temporary(self, older_than_seconds: float = 24 * 3600) -> None:
        super().sweep_temporary(older_than_seconds)
        self._bucket.abort_uploads(time.time() - older_than_seconds)

    # The cache

    def trim(self) -> None:
        """Removes from the cache what was used least lately, until it is as small as it may be."""
        kept = sorted(super().objects(), key=lambda stored: stored.used)
        size = sum(stored.size for stored in kept)
        unused_since = time.time() - KEEP_SECONDS
        for stored in kept:
            if size <= self.cache_bytes or stored.used >= unused_since:
                return
            if super().remove_object(stored.name, unused_since):
                size -= stored.size

    def _trim_now_and_then(self) -> None:
        if time.monotonic() - self._trimmed > TRIM_SECONDS:
            self._trimmed = time.monotonic()
            self.trim()


class _RemoteLock:
    """``locks/<key>`` in the bucket, renewed by a thread while it is held.

    folder: identity of the folder in which the caller holds the lock of this key.
    """

    def __init__(self, bucket: Bucket, key: str, folder: str) -> None:
        self._bucket = bucket
        self._folder = folder
        self._name = f"locks/{key}"
        self._tag = ""
        self._released = threading.Event()
        self._thread = threading.Thread(target=self._renew, name="lock", daemon=True)

    def __enter__(self) -> None:
        while (tag := self._try()) is None:
            time.sleep(POLL_SECONDS)
        self._tag = tag
        self._thread.start()

    def __exit__(self, *error: object) -> None:
        self._released.set()
        self._thread.join()
        with contextlib.suppress(StoreError):  # it ends by itself
            self._bucket.delete(self._name, tag=self._tag)

    def _try(self) -> str | None:
        if tag := self._bucket.put(self._name, self._content(), fresh=True):
            return tag
        found = self._bucket.get(self._name)
        if found is None:
            return None
        holder, held = found
        if held.age > LOCK_SECONDS or holder.endswith(self._folder.encode()):
            return self._bucket.put(self._name, self._content(), tag=held.tag)
        return None

    def _renew(self) -> None:
        while not self._released.wait(LOCK_SECONDS / 4):
            with contextlib.suppress(StoreError):
                tag = self._bucket.put(self._name, self._content(), tag=self._tag)
                if tag is None:
                    return  # another machine has taken it over
                self._tag = tag

    def _content(self) -> bytes:
        return f"{workspace_prefix(os.getpid())}{uuid.uuid4().hex} {self._folder}".encode()


def _identity(root: Path) -> str:
    """A name of this folder that no other one has."""
    path = root / "identity"
    if not path.exists():
        made = root / "tmp" / f"identity-{uuid.uuid4().hex}"
        made.write_text(uuid.uuid4().hex)
        with contextlib.suppress(FileExistsError):
            os.link(made, path)
        made.unlink()
    return path.read_text()


def _object_name(sha256: str) -> str:
    return f"objects/{sha256[:2]}/{sha256}"


def _record_name(key: str) -> str:
    return f"stages/{key[:2]}/{key}.json"


def _stored(head: Head) -> Stored:
    return Stored(head.name.rpartition("/")[2].removesuffix(".json"), head.size, head.modified)


def _content(record: StageRecord) -> bytes:
    """Other bytes every time: a record that was written again has another tag."""
    return canonical({"record": asdict(record), "written": uuid.uuid4().hex})


def _parsed(content: bytes) -> StageRecord | None:
    try:
        return StageRecord.from_json(json.dumps(json.loads(content)["record"]).encode())
    except (ValueError, TypeError, KeyError):
        return None


def _verified(ref: FileRef, pieces: Iterator[bytes]) -> Iterator[bytes]:
    found = hashlib.sha256()
    last = b""
    for piece in pieces:
        found.update(piece)
        if last:
            yield last
        last = piece
    if found.hexdigest() != ref.sha256:
        raise StoreError(f"the object {ref.sha256} is not what its name says", code="object-corrupt")
    yield last


def _missing(bucket: Bucket, ref: FileRef) -> StoreError:
    return StoreError(
        f"the object {ref.sha256} is not in {bucket.location.url} any more: run the case again", code="object-missing"
    )


def _corrupt(bucket: Bucket, ref: FileRef) -> StoreError:
    return StoreError(
        f"the object {ref.sha256} in {bucket.location.url} has other content than its name says: remove it there and "
        "run the case again",
        code="object-corrupt",
    )
