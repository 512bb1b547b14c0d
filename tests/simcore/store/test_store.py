"""The store: nothing torn, nothing computed twice, damage seen."""

import errno
import hashlib
import multiprocessing
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from simcore.core.canonical import canonical
from simcore.core.errors import StoreError
from simcore.store import hashing as hashing_module
from simcore.store import store as store_module
from simcore.store.hashing import Hashing
from simcore.store.records import Commits, stage_key
from simcore.store.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store", min_free_bytes=0)


def write(text: str):
    def compute(folder: Path, key: str, hashing: Hashing):
        (folder / "sub").mkdir()
        (folder / "a.txt").write_text(text)
        (folder / "sub" / "b.txt").write_text(text + "b")
        return {"n": len(text)}, 0.5, 1000

    return compute


def test_a_stage_is_computed_once_and_read_back(store):
    first, cached = store.run("s", 1, {"p": 1}, {}, write("x"))
    again, cached_again = store.run("s", 1, {"p": 1}, {}, lambda *_: pytest.fail("computed twice"))
    assert (cached, cached_again) == (False, True)
    assert again == first
    assert store.path(again.outputs["sub/b.txt"]).read_text() == "xb"
    assert again.report == {"n": 1}


@pytest.mark.parametrize(
    "other", [("t", 1, {"p": 1}, {}), ("s", 2, {"p": 1}, {}), ("s", 1, {"p": 2}, {}), ("s", 1, {"p": 1}, {"i": "d"})]
)
def test_every_part_of_the_key_counts(other):
    assert stage_key(*other) != stage_key("s", 1, {"p": 1}, {})


def test_canonical_json_is_independent_of_order_and_refuses_nan():
    assert canonical({"b": 1, "a": [1.5]}) == canonical({"a": [1.5], "b": 1}) == b'{"a":[1.5],"b":1}'
    with pytest.raises(ValueError):
        canonical(float("nan"))


def test_a_lost_or_cut_file_is_computed_again(store):
    record, _ = store.run("s", 1, {}, {}, write("hello"))
    path = store.path(record.outputs["a.txt"])
    path.unlink()
    assert store.get(record.key) is None
    record, cached = store.run("s", 1, {}, {}, write("hello"))
    assert not cached
    path.chmod(0o644)
    path.write_text("hel")
    assert store.get(record.key) is None
    store.run("s", 1, {}, {}, write("hello"))
    assert path.read_text() == "hello"


def test_objects_are_shared_and_read_only(store):
    one, _ = store.run("s", 1, {"p": 1}, {}, write("x"))
    two, _ = store.run("s", 1, {"p": 2}, {}, write("x"))
    assert one.outputs == two.outputs
    assert one.digest == two.digest
    assert store.path(one.outputs["a.txt"]).stat().st_mode & 0o777 == 0o444


def test_a_failed_stage_leaves_nothing(store):
    def fail(folder: Path, key: str, hashing: object):
        (folder / "half").write_text("half")
        raise RuntimeError("no")

    with pytest.raises(RuntimeError):
        store.run("s", 1, {}, {}, fail)
    assert not list((store.root / "tmp").iterdir())
    assert not [p for p in (store.root / "objects").rglob("*") if p.is_file()]


def test_a_full_disk_is_said(tmp_path):
    store = Store(tmp_path, min_free_bytes=1 << 60)
    with pytest.raises(StoreError, match="GB free") as caught:
        store.run("s", 1, {}, {}, write("x"))
    assert caught.value.code == "storage-full"


def test_an_unwritable_folder_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be made"):
        Store(tmp_path / "file" / "store")


def test_materialise_copies(store, tmp_path):
    record, _ = store.run("s", 1, {}, {}, write("x"))
    store.materialise(record.outputs["a.txt"], tmp_path / "out" / "a.txt")
    (tmp_path / "out" / "a.txt").write_text("changed")
    assert store.path(record.outputs["a.txt"]).read_text() == "x"


def _compute_slowly(root: Path, log: Path) -> None:
    def compute(folder: Path, key: str, hashing: Hashing):
        with open(log, "a") as f:
            f.write("computed\n")
        time.sleep(0.5)
        (folder / "a.txt").write_text("x")
        return {}, 0.5, 0

    Store(root, min_free_bytes=0).run("s", 1, {}, {}, compute)


def test_one_computation_however_many_ask(tmp_path):
    context = multiprocessing.get_context("spawn")
    asking = [context.Process(target=_compute_slowly, args=(tmp_path / "s", tmp_path / "log")) for _ in range(3)]
    for p in asking:
        p.start()
    for p in asking:
        p.join(60)
        assert p.exitcode == 0
    assert (tmp_path / "log").read_text() == "computed\n"


def _write_for_ever(root: Path) -> None:
    store = Store(root, min_free_bytes=0)
    for n in range(10**6):
        store.run("s", 1, {"n": n}, {}, write("x" * (n % 5000)))


def test_kill_at_any_moment_tears_nothing(tmp_path):
    context = multiprocessing.get_context("spawn")
    store = Store(tmp_path / "s", min_free_bytes=0)
    for pause in (0.02, 0.05, 0.11):
        writer = context.Process(target=_write_for_ever, args=(store.root,))
        before = len(list((store.root / "stages").rglob("*.json")))
        writer.start()
        while len(list((store.root / "stages").rglob("*.json"))) <= before:
            time.sleep(0.01)
        time.sleep(pause)
        os.kill(writer.pid, signal.SIGKILL)
        writer.join(60)
    records = list((store.root / "stages").rglob("*.json"))
    assert records
    for path in records:
        record = store.get(path.stem)
        assert record is not None
        for ref in record.outputs.values():
            assert store.path(ref).stat().st_size == ref.size


def begun(store, later):
    """The record as soon as the files are hashed, and whether it was cached."""
    stage = store.begin(stage_key("s", 1, {}, {}), "s", 1, write("x"), later)
    return stage.record.result(), stage.cached


def test_large_outputs_are_committed_beside_what_follows(store, monkeypatch):
    monkeypatch.setattr(store_module, "LARGE_BYTES", 0)
    disk_is_ready = threading.Event()
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (disk_is_ready.wait(30), sync(fd))[1])
    with Commits() as later:
        record, cached = begun(store, later)
        assert not cached
        assert store.get(record.key) is None
        waiting = threading.Thread(target=lambda: found.append(store.run("s", 1, {}, {}, write("x"))))
        found: list = []
        waiting.start()
        disk_is_ready.set()
        waiting.join(30)
    assert found == [(record, True)]
    assert store.get(record.key) == record
    assert list((store.root / "tmp").iterdir()) == []


def test_small_outputs_are_there_at_once(store):
    with Commits() as later:
        record, _ = begun(store, later)
        assert store.get(record.key) == record


def test_a_commit_that_fails_is_told(store, monkeypatch):
    monkeypatch.setattr(store_module, "LARGE_BYTES", 0)

    def full(fd: int) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match="is full"), Commits() as later:
        record, _ = begun(store, later)
    monkeypatch.undo()
    assert store.get(record.key) is None
    assert list((store.root / "tmp").iterdir()) == []


def test_large_outputs_are_hashed_beside_what_follows(store, monkeypatch):
    monkeypatch.setattr(store_module, "LARGE_BYTES", 0)
    go_on = threading.Event()
    hashed = hashing_module.file_ref
    monkeypatch.setattr(hashing_module, "file_ref", lambda path: (go_on.wait(30), hashed(path))[1])
    with Commits() as later:
        stage = store.begin("0" * 64, "s", 1, write("x"), later)
        assert not stage.record.done()
        go_on.set()
        assert stage.record.result(30).key == "0" * 64
    assert store.get("0" * 64) == stage.record.result()


def test_a_digest_that_fails_is_told(store, monkeypatch):
    monkeypatch.setattr(store_module, "LARGE_BYTES", 0)

    def unreadable(path: Path) -> None:
        raise OSError(errno.EIO, "cannot be read")

    monkeypatch.setattr(hashing_module, "file_ref", unreadable)
    with pytest.raises(OSError, match="cannot be read"), Commits() as later:
        store.begin("0" * 64, "s", 1, write("x"), later)
    assert store.get("0" * 64) is None
    assert list((store.root / "tmp").iterdir()) == []


def test_a_disk_that_fails_while_others_are_written_is_told(store, monkeypatch):
    """It fails once; when the stage is committed it may say that all is well."""
    told = []

    def failing(path: Path) -> None:
        told.append(path)
        if len(told) == 1:
            raise OSError(errno.EIO, "disk trouble")

    def compute(folder: Path, key: str, hashing: Hashing):
        with hashing.open(folder / "large") as file:
            file.write(b"first")
        return {}, 0.0, 0

    monkeypatch.setattr(hashing_module, "sync_file", failing)
    with pytest.raises(OSError, match="disk trouble"):
        store.run("s", 1, {}, {}, compute)
    monkeypatch.setattr(store_module, "LARGE_BYTES", 0)
    told.clear()
    with pytest.raises(OSError, match="disk trouble"), Commits() as later:
        store.begin("0" * 64, "s", 1, compute, later)
    assert store.get("0" * 64) is None


def test_a_file_is_hashed_while_it_is_written(store):
    def compute(folder: Path, key: str, hashing: Hashing):
        with hashing.open(folder / "large") as file:
            file.write(b"fir")
            file.write(memoryview(b"st"))
        with hashing.open(folder / "changed") as file:
            content = bytearray(b"before")
            file.write(content)
            content[:] = b"behind"
        with hashing.open(folder / "patched") as file:
            file.write(b"----and more")
            file.seek(0)
            file.write(b"head")
        (folder / "small").write_text("then")
        return {}, 0.0, 0

    record, _ = store.run("s", 1, {}, {}, compute)
    for name, text in (("large", b"first"), ("changed", b"before"), ("patched", b"headand more"), ("small", b"then")):
        assert record.outputs[name].sha256 == hashlib.sha256(text).hexdigest()
        assert store.path(record.outputs[name]).read_bytes() == text
