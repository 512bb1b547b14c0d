"""Runs the stages of one case: each computed once, some beside others, told of in the order of the table."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from simcore.core import memory
from simcore.core.artifacts import Report
from simcore.pipeline.graph import Case, CaseProgress, Stage, StageResult, Work
from simcore.store.hashing import Hashing
from simcore.store.records import Commits, stage_key


class Scheduler:
    """Two lanes. Stages with parallel kernels run on the thread of the caller, in the order of the table. Each of the
    others runs on one thread beside them, from when its inputs are there and the stage that it comes ``after`` is
    computed; on the caller's thread where an input has to be computed again, which takes kernels.

    Clients see the stages in their order: what the thread beside tells, and its records, come when the caller reaches
    a stage behind it, or the end. Where a stage fails, those that were begun beside it are still kept.
    """

    def __init__(self, table: Sequence[Stage], case: Case, tell: CaseProgress, later: Commits) -> None:
        self._table = table
        self._case = case
        self._tell = tell
        self._later = later
        self._inputs = {stage.name: stage.inputs(case.spec) for stage in table}
        self._computed: set[str] = set()
        self._beside: dict[str, Future[StageResult[Any]]] = {}
        self._notes: dict[str, list[Callable[[], None]]] = {}
        self._reached: list[str] = []

    def run(self) -> None:
        """raises: what the first stage that fails raises"""
        with ThreadPoolExecutor(1, "beside") as self._thread:
            for stage in self._table:
                if stage.name in self._beside:
                    self._reached.append(stage.name)
                    continue
                self._join()
                if self._inputs[stage.name] is None:
                    self._leave_out(stage)
                else:
                    self._case.records.append(self._run(stage, self._tell, self._is_computed))
            self._join()

    def _leave_out(self, stage: Stage) -> None:
        if stage.stands_in is not None:
            self._case.results[stage.name] = self._case.results[stage.stands_in]
        self._tell(stage.name, 1.0, "not needed")
        self._is_computed(stage.name)

    def _join(self) -> None:
        """Waits for the stages beside that the caller has come past, and tells of them."""
        for name in self._reached:
            self._case.records.append(self._beside[name].result())
            for note in self._notes[name]:
                note()
        self._reached = []

    def _is_computed(self, name: str) -> None:
        """Starts what waited for ``name``: its artifact will do, and its files need not be stored yet."""
        self._computed.add(name)
        for stage in self._table:
            if not stage.parallel and self._may_start(stage):
                self._notes[stage.name] = []
                self._beside[stage.name] = self._thread.submit(
                    self._run, stage, self._note_of(stage.name), self._computed.add, alone=False
                )

    def _may_start(self, stage: Stage) -> bool:
        inputs = self._inputs[stage.name]
        if inputs is None or stage.name in self._beside or stage.name in self._computed:
            return False
        needed = {source.stage for source in inputs.values()} | ({stage.after} if stage.after else set())
        return needed <= self._computed and not any(
            self._case.results[source.stage].recomputes for source in inputs.values()
        )

    def _note_of(self, name: str) -> CaseProgress:
        def note(stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
            self._notes[name].append(partial(self._tell, stage, fraction, message, cached=cached))

        return note

    def _run(
        self, stage: Stage, tell: CaseProgress, computed: Callable[[str], None], *, alone: bool = True
    ) -> StageResult[Any]:
        """computed: called with the stage's name as soon as its artifact is there. alone: whether the peak of the
        process's memory is that of this stage."""
        case = self._case

        def progress(fraction: float, message: str) -> None:
            tell(stage.name, fraction, message)

        def work(folder: Path, key: str, hashing: Hashing) -> tuple[Report, float, int]:
            if alone:
                memory.reset_peak()
            start = time.perf_counter()
            report = stage.write(case, Work(folder, hashing, progress)) if stage.write else keep(folder)
            return report, time.perf_counter() - start, memory.peak_bytes()

        def keep(folder: Path) -> Report:
            result.fresh = result.compute(progress)
            computed(stage.name)
            result.codec.save(folder, result.fresh)
            return result.fresh.report  # type: ignore[no-any-return]

        progress(0.0, "started")
        inputs = {label: case.results[s.stage].by(s.by) for label, s in (self._inputs[stage.name] or {}).items()}
        key = stage_key(stage.name, stage.version, stage.parameters(case), inputs)
        result = case.results[stage.name] = StageResult(case, stage, key)
        try:
            result.begun.set_result(case.store.begin(key, stage.name, stage.version, work, self._later))
        except BaseException as error:
            result.begun.set_exception(error)  # the thread beside must not wait for its record for ever
            raise
        computed(stage.name)
        tell(stage.name, 1.0, "done", cached=result.cached)
        return result
