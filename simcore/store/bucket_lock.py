"""One computation per key, on however many machines.

``locks/<key>`` is made by a conditional write (If-None-Match), renewed while the holder lives, and taken over
(If-Match) where it was not for ``LOCK_SECONDS``, by the clock of the service; at once where the holder worked in our
own folder, whose lock the system has freed: it is dead. It lies in the bucket, not in a database, because a computation
knows the store alone. Should two machines compute one key after all, both results are whole and one of them stays.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
import uuid

from simcore.core.errors import StoreError
from simcore.store.bucket import Bucket
from simcore.store.workspaces import workspace_prefix

LOCK_SECONDS = 120.0
"""A holder that was silent for longer has lost its lock; a stage may keep all threads of a process busy for long."""

POLL_SECONDS = 1.0


class BucketLock:
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
        there = self._bucket.get(self._name)
        if there is None:
            return None
        holder, head = there
        if head.age > LOCK_SECONDS or holder.endswith(self._folder.encode()):
            return self._bucket.put(self._name, self._content(), tag=head.tag)
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


def release(bucket: Bucket, process: int) -> None:
    """Frees the locks of a process of this machine that was killed."""
    with contextlib.suppress(StoreError):  # they end by themselves
        for head in bucket.list("locks/"):
            there = bucket.get(head.name)
            if there and there[0].startswith(workspace_prefix(process).encode()):
                bucket.delete(head.name, tag=there[1].tag)
