"""Stages of a case against a store: each computed once, told of, timed, and some beside others."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from simcore.core import files, memory
from simcore.core.artifacts import Report
from simcore.core.progress import Progress
from simcore.core.store import Begun, Commits, Hashing, StageRecord, Store, stage_key


class CaseProgress(Protocol):
    """Told of every step: ``fraction`` of the stage in [0, 1]; ``cached`` where nothing had to be computed."""

    def __call__(self, stage: str, fraction: float, message: str, *, cached: bool = False) -> None: ...


def silent(stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
    """No progress."""


T = TypeVar("T")


@dataclass
class StageResult(Generic[T]):
    """A stage's record, and its artifact: in memory where it was just computed, else read when first asked for."""

    store: Store
    key: str
    begun: Begun
    load: Callable[[files.Locate], T] | None = None
    fresh: T | None = None

    @property
    def cached(self) -> bool:
        return self.begun.cached

    @property
    def record(self) -> StageRecord:
        """Waits for the digests of large files."""
        return self.begun.record.result()

    @cached_property
    def artifact(self) -> T:
        if self.fresh is not None:
            return self.fresh
        if self.load is None:
            raise TypeError(f"the stage {self.record.stage} has files only")
        return self.load(lambda name: self.store.path(self.record.outputs[name]))


@dataclass
class Run:
    """Runs stages of one case against a store.

    versions: of the stages, by name. alone: no other stages of this process run at the same time.
    """

    store: Store
    versions: dict[str, int]
    tell: CaseProgress
    later: Commits
    alone: bool = True
    records: list[StageResult[Any]] = field(default_factory=list)

    def stage(
        self,
        name: str,
        parameters: Any,
        inputs: dict[str, StageResult[Any] | str],
        compute: Callable[[Progress], T],
        save: Callable[[Path, T], None],
        load: Callable[[files.Locate], T],
    ) -> StageResult[T]:
        """One stage whose artifact is a value: computed in memory, then saved.

        inputs: other stages, or digests of the part of them that matters.
        """
        kept: list[T] = []

        def work(folder: Path, key: str, hashing: Hashing, progress: Progress) -> Report:
            artifact = compute(progress)
            kept.append(artifact)
            save(folder, artifact)
            return artifact.report  # type: ignore[attr-defined, no-any-return]

        result: StageResult[T] = self.file_stage(name, parameters, inputs, work)
        result.load = load
        result.fresh = kept[0] if kept else None
        return result

    def file_stage(
        self,
        name: str,
        parameters: Any,
        inputs: dict[str, StageResult[Any] | str],
        work: Callable[[Path, str, Hashing, Progress], Report],
    ) -> StageResult[Any]:
        """One stage that writes files; as those of ``Store.run``."""

        def compute(folder: Path, key: str, hashing: Hashing) -> tuple[Report, float, int]:
            if self.alone:
                memory.reset_peak()
            start = time.perf_counter()
            report = work(folder, key, hashing, lambda fraction, message: self.tell(name, fraction, message))
            return report, time.perf_counter() - start, memory.peak_bytes()

        self.tell(name, 0.0, "started")
        digests = {k: given if isinstance(given, str) else given.record.digest for k, given in inputs.items()}
        key = stage_key(name, self.versions[name], parameters, digests)
        begun = self.store.begin(key, name, self.versions[name], compute, self.later)
        self.tell(name, 1.0, "done", cached=begun.cached)
        result: StageResult[Any] = StageResult(self.store, key, begun)
        self.records.append(result)
        return result

    def leave_out(self, name: str) -> None:
        """Tells of a stage that this case has no use for."""
        self.tell(name, 1.0, "not needed")


class Beside:
    """Stages of a case that run on a thread of their own, beside those of the caller. Closing waits for them.

    They may start no parallel kernel, because numba's threads serve one caller. What they tell, and their records,
    come when this is closed: clients see the stages in their order.
    """

    def __init__(self, case: Run) -> None:
        self._case = case
        self._told: list[Callable[[], None]] = []
        self._run = Run(case.store, case.versions, self._tell_later, case.later, alone=False)
        self._thread = ThreadPoolExecutor(1, "beside")
        self._underway: dict[Callable[[Run], None], Future[None]] = {}

    def start(self, stages: Callable[[Run], None]) -> None:
        """Runs ``stages`` after those that were started before; the same ones only once."""
        if stages not in self._underway:
            self._underway[stages] = self._thread.submit(stages, self._run)

    def _tell_later(self, stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
        self._told.append(partial(self._case.tell, stage, fraction, message, cached=cached))

    def __enter__(self) -> Beside:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._thread.shutdown()  # what was begun is kept, even where the caller's stage failed
        if error is not None:
            return
        for stages in self._underway.values():
            stages.result()
        for tell in self._told:
            tell()
        self._case.records += self._run.records
