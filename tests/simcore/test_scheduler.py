"""Rows of a table run in two lanes; everything that is known of stages is read from the rows."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from simcore import estimate, presets
from simcore.core.errors import SimulationError
from simcore.pipeline.graph import Case, Codec, Needs, Source, Stage
from simcore.pipeline.result import result_of
from simcore.pipeline.scheduler import Scheduler
from simcore.pipeline.table import TABLE
from simcore.store.records import Commits
from simcore.store.store import Store

SPEC = presets.get("tiny")
WAIT_SECONDS = 20.0


@dataclass
class Value:
    """An artifact."""

    number: int
    report: dict[str, Any] = field(default_factory=dict)


def save(folder: Path, value: Value) -> None:
    (folder / "value").write_text(str(value.number))


STORED: Codec[Value] = Codec(save, lambda locate: Value(int(locate("value").read_text())))


def stage(name: str, *sources: str, **further: Any) -> Stage:
    """A value that is one more than the sum of those it is made from; or with ``write`` files."""

    def compute(case: Case, progress: Any) -> Value:
        return Value(1 + sum(case.artifact(source).number for source in sources))

    row = Stage(
        name,
        version=1,
        inputs=lambda spec: {source: Source(source) for source in sources},
        parameters=lambda case: {},
        needs=lambda spec, sizes: Needs(1.0),
    )
    if "write" not in further:
        row = replace(row, compute=compute, codec=lambda spec: STORED)
    return replace(row, **further)


def run(store: Store, *table: Stage, notes: list[str] | None = None) -> Case:
    case = Case(SPEC, store)

    def tell(stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
        if notes is not None:
            notes.append(stage)

    with Commits() as later:
        Scheduler(table, case, tell, later).run()
    return case


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path, min_free_bytes=0)


def write(action: Callable[[], None] = lambda: None) -> Callable[..., dict[str, Any]]:
    def work(case: Case, work: Any) -> dict[str, Any]:
        action()
        (work.folder / "file").write_text("content")
        return {}

    return work


def test_a_stage_beside_starts_while_the_artifact_that_it_needs_is_being_stored(store: Store) -> None:
    started = threading.Event()

    def slow(folder: Path, value: Value) -> None:
        assert started.wait(WAIT_SECONDS), "the stage beside has not started"
        save(folder, value)

    large = stage("large", codec=lambda spec: Codec(slow, STORED.load))
    beside = stage("beside", parallel=False, write=write(started.set))
    beside = replace(beside, inputs=lambda spec: {"large": Source("large", "key")})
    case = run(store, large, beside)
    assert [record.stage.name for record in case.records] == ["large", "beside"]


def test_a_stage_waits_beside_until_a_core_is_to_spare(store: Store) -> None:
    order: list[str] = []

    def compute(case: Case, progress: Any) -> Value:
        order.append("kernels")
        return Value(1)

    run(
        store,
        stage("first"),
        stage("kernels", "first", compute=compute),
        stage("beside", "first", parallel=False, after="kernels", write=write(lambda: order.append("beside"))),
    )
    assert order == ["kernels", "beside"]


def test_clients_see_the_stages_in_the_order_of_the_table(store: Store) -> None:
    ended = threading.Event()
    notes: list[str] = []

    def last(case: Case, progress: Any) -> Value:
        assert ended.wait(WAIT_SECONDS)
        return Value(1)

    table = (
        stage("first"),
        stage("last", "first", compute=last),
        stage("beside", "first", parallel=False, write=write(ended.set)),
    )
    run(store, *table, notes=notes)
    assert list(dict.fromkeys(notes)) == ["first", "last", "beside"]


def test_a_stage_on_the_callers_thread_is_told_of_after_those_beside_that_are_listed_before_it(store: Store) -> None:
    notes: list[str] = []
    beside = stage("beside", "first", parallel=False, write=write())
    case = run(store, stage("first"), beside, stage("last", "first"), notes=notes)
    assert list(dict.fromkeys(notes)) == ["first", "beside", "last"]
    assert [record.stage.name for record in case.records] == ["first", "beside", "last"]


def test_what_was_begun_beside_a_failing_stage_is_kept(store: Store) -> None:
    def fail(case: Case, progress: Any) -> Value:
        raise SimulationError("not today")

    table = [
        stage("first"),
        stage("last", "first", compute=fail),
        stage("beside", "first", parallel=False, write=write()),
    ]
    with pytest.raises(SimulationError, match="not today"):
        run(store, *table)
    table[1] = stage("last", "first")
    assert [r.stage.name for r in run(store, *table).records if r.cached] == ["first", "beside"]


def test_a_stage_beside_does_not_wait_for_ever_for_a_record_that_never_comes(store: Store) -> None:
    """It needs the digest of files whose storing fails."""

    def fail(folder: Path, value: Value) -> None:
        raise SimulationError("no room")

    table = (
        stage("first", codec=lambda spec: Codec(fail, STORED.load)),
        stage("beside", "first", parallel=False, write=write()),
    )
    with pytest.raises(SimulationError, match="no room"):
        run(store, *table)


def test_an_artifact_that_is_not_stored_is_computed_again_on_the_callers_thread(store: Store) -> None:
    threads: list[str] = []

    def compute(case: Case, progress: Any) -> Value:
        threads.append(threading.current_thread().name)
        return Value(1)

    def read(case: Case, work: Any) -> dict[str, Any]:
        assert case.artifact("volume").number == 1
        (work.folder / "file").write_text("content")
        return {}

    def table(version: int) -> tuple[Stage, Stage]:
        volume = stage("volume", compute=compute, codec=lambda spec: Codec(save, None))
        return volume, stage("pictures", "volume", parallel=False, write=read, version=version)

    run(store, *table(1))
    run(store, *table(2))
    assert threads == [threading.current_thread().name] * 2


def test_what_stands_in_for_a_stage_that_a_case_has_no_use_for(store: Store) -> None:
    notes: list[str] = []
    unused = stage("unused", "first", inputs=lambda spec: None, stands_in="first")
    case = run(store, stage("first"), unused, stage("last", "unused"), notes=notes)
    assert case.artifact("last").number == 2
    assert [r.stage.name for r in case.records] == ["first", "last"]
    assert notes.count("unused") == 1


def test_results_and_public_files_are_those_that_the_rows_name(store: Store) -> None:
    def compute(case: Case, progress: Any) -> Value:
        return Value(1, {"volume": 3.0, "more": 4.0})

    table = (stage("first", compute=compute, results=("volume",)), stage("files", "first", write=write(), public=True))
    result = result_of(run(store, *table), table, 1.0)
    assert {k: v for k, v in result.manifest["results"].items() if k != "cautions"} == {"volume": 3.0}
    assert list(result.files) == ["file"]


def test_the_estimate_is_the_sum_over_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    before = estimate.estimate(SPEC)
    row = replace(TABLE[0], name="another", needs=lambda spec, sizes: Needs(10.0, 1000.0))
    monkeypatch.setattr(estimate, "TABLE", (*TABLE, row))
    after = estimate.estimate(SPEC)
    assert after.seconds == pytest.approx(before.seconds + 10.0)
    assert after.storage_bytes == before.storage_bytes + 1000
    unused = replace(row, inputs=lambda spec: None)
    monkeypatch.setattr(estimate, "TABLE", (*TABLE, unused))
    assert estimate.estimate(SPEC) == before


def test_the_names_of_stages_are_unique_and_lead_only_backwards() -> None:
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names)
    for number, row in enumerate(TABLE):
        sources = {source.stage for source in (row.inputs(SPEC) or {}).values()}
        assert sources | ({row.after} if row.after else set()) <= set(names[:number])
        assert (row.compute is None) == (row.codec is None) == (row.write is not None)
