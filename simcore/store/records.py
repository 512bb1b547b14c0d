"""What a stage made: its record, its key, and commits that go on beside the computation."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simcore.core.artifacts import Report
from simcore.core.canonical import digest
from simcore.store.hashing import FileRef, Hashing


@dataclass(frozen=True)
class StageRecord:
    """What one run of one stage made."""

    stage: str
    version: int
    key: str
    outputs: dict[str, FileRef]
    report: Report = field(default_factory=dict)
    seconds: float = 0.0
    peak_memory_bytes: int = 0

    @property
    def digest(self) -> str:
        """Digest of the outputs: what feeds the keys of later stages (of large outputs their own key may stand for it).
        Independent of when and how fast it ran."""
        return digest({name: ref.sha256 for name, ref in self.outputs.items()})


def parsed(content: bytes | None, stamped: bool = False) -> StageRecord | None:
    """A record from its JSON; None where there is none: an unreadable record is recomputed, not trusted.

    stamped: it lies under ``record``, beside what tells one writing of it from another.
    """
    try:
        data = json.loads(content or b"")
        fields = data["record"] if stamped else data
        return StageRecord(**{**fields, "outputs": {name: FileRef(**ref) for name, ref in fields["outputs"].items()}})
    except (ValueError, TypeError, KeyError, AttributeError):
        return None


@dataclass(frozen=True)
class Begun:
    """A stage whose files are there. record: as soon as they are hashed."""

    record: Future[StageRecord]
    cached: bool

    @classmethod
    def there(cls, record: StageRecord) -> Begun:
        return cls(completed(record), cached=True)


Compute = Callable[[Path, str, Hashing], tuple[Report, float, int]]
"""compute(folder, key, hashing): writes the outputs of a stage below ``folder``; returns (report, seconds, peak memory
in bytes). Files that it opens by ``hashing.open`` are hashed while they are written."""


def completed(record: StageRecord) -> Future[StageRecord]:
    """A record that is there already."""
    future: Future[StageRecord] = Future()
    future.set_result(record)
    return future


def stage_key(stage: str, version: int, parameters: Any, inputs: dict[str, str]) -> str:
    """Key of a stage: its name and version, its own part of the specification, the digests of its inputs."""
    return digest({"stage": stage, "version": version, "parameters": parameters, "inputs": inputs})


class Commits:
    """Commits of stages, one after the other beside the computation of what follows.

    A disk takes seconds to have a volume for certain, and so does its digest. Closing waits for all of them; the first
    that failed is raised then, or by the next ``take``.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "commit")
        self._hasher = ThreadPoolExecutor(1, "hash")
        self._underway: list[Future[None]] = []

    def hash(self, make: Callable[[], StageRecord]) -> Future[StageRecord]:
        """Runs what makes a record of finished files."""
        return self._hasher.submit(make)

    def take(self, commit: Callable[[], None], resources: contextlib.ExitStack) -> None:
        """Runs ``commit`` and then leaves ``resources`` (the lock and the folder of the stage)."""

        def run() -> None:
            with resources:
                commit()

        self._underway.append(self._thread.submit(run))
        self._raise_failures()

    def _raise_failures(self) -> None:
        for future in self._underway:
            if future.done():
                future.result()

    def __enter__(self) -> Commits:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._hasher.shutdown()
        self._thread.shutdown()
        if error is None:
            self._raise_failures()
