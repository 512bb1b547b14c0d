"""The store in object storage: as in a folder, for several machines (each with a folder of its own)."""

import multiprocessing
import os
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from simcore.core.errors import StoreError
from simcore.store import bucket, bucket_lock
from simcore.store.bucket import Bucket, Location
from simcore.store.bucket_backend import BucketBackend
from simcore.store.store import Store
from simcore.store.workspaces import workspace_prefix
from tests.support.waiting import wait_for


def open_store(root: Path, location: Location, **options) -> Store:
    return Store(root, 0, partial(BucketBackend, location=location, **options))


@pytest.fixture
def location(make_location):
    return make_location()


@pytest.fixture
def machine(location, tmp_path):
    """A machine of its own: the same bucket, another folder."""

    def make(name="here", **options) -> Store:
        return open_store(tmp_path / name, location, **options)

    return make


@pytest.fixture
def there(location):
    return Bucket(location)


def write(text: str):
    def compute(folder: Path, key: str, hashing: object):
        (folder / "sub").mkdir()
        (folder / "a.txt").write_text(text)
        (folder / "sub" / "b.txt").write_text(text + "b")
        return {"n": len(text)}, 0.5, 1000

    return compute


def computed_twice(*_):
    pytest.fail("computed twice")


def make_old(there, monkeypatch, name="stages/"):
    """As if everything of this name had been written a day ago."""
    head, get = Bucket.head, Bucket.get

    def aged(found):
        return found and bucket.Head(found.name, found.size, found.tag, found.modified - 86400, found.age + 86400)

    monkeypatch.setattr(Bucket, "head", lambda self, n: aged(head(self, n)) if n.startswith(name) else head(self, n))
    monkeypatch.setattr(
        Bucket,
        "get",
        lambda self, n: (found := get(self, n)) and ((found[0], aged(found[1])) if n.startswith(name) else found),
    )


def test_what_one_machine_computed_another_reads(machine):
    first, cached = machine("one").run("s", 1, {"p": 1}, {}, write("x"))
    store = machine("two")
    again, cached_again = store.run("s", 1, {"p": 1}, {}, computed_twice)
    assert (cached, cached_again) == (False, True)
    assert again == first
    assert store.path(again.outputs["sub/b.txt"]).read_text() == "xb"
    assert b"".join(store.stream(again.outputs["a.txt"])) == b"x"
    assert again.digest == first.digest


def test_names_in_the_bucket(machine, there):
    record, _ = machine().run("s", 1, {}, {}, write("x"))
    names = {head.name for head in there.list("")}
    digests = [ref.sha256 for ref in record.outputs.values()]
    assert names == {f"stages/{record.key[:2]}/{record.key}.json", *(f"objects/{d[:2]}/{d}" for d in digests)}


def test_large_files_go_in_parts(machine, monkeypatch, tmp_path):
    monkeypatch.setattr(bucket, "PART_BYTES", 5 << 20)
    content = os.urandom(1 << 20) * 12
    (tmp_path / "large").write_bytes(content)
    ref = machine("one").add(tmp_path / "large")
    other = machine("two")
    assert b"".join(other.stream(ref, 5_000_000, 3_000_000)) == content[5_000_000:8_000_000]
    assert not (other.root / "objects" / ref.sha256[:2]).exists()  # streamed, not kept
    assert b"".join(other.stream(ref)) == content
    assert other.path(ref).read_bytes() == content
    assert b"".join(other.stream(ref, 1, 2)) == content[1:3]


def test_a_lost_object_is_computed_again(machine, there):
    record, _ = machine("one").run("s", 1, {}, {}, write("x"))
    lost = record.outputs["a.txt"]
    there.delete(f"objects/{lost.sha256[:2]}/{lost.sha256}")
    other = machine("two")
    with pytest.raises(StoreError, match="run the case again") as caught:
        other.path(lost)
    assert caught.value.code == "object-missing"
    assert not other.has(lost)
    assert other.get(record.key) is None
    again, cached = other.run("s", 1, {}, {}, write("x"))
    assert (again, cached) == (record, False)
    assert machine("three").path(lost).read_text() == "x"


def test_changed_content_is_never_used(machine, there):
    record, _ = machine("one").run("s", 1, {}, {}, write("x"))
    ref = record.outputs["a.txt"]
    there.put(f"objects/{ref.sha256[:2]}/{ref.sha256}", b"y")
    other = machine("two")
    for use in (other.path, lambda r: list(other.stream(r))):
        with pytest.raises(StoreError) as caught:
            use(ref)
        assert caught.value.code == "object-corrupt"
    assert not other.backend.folder.path(ref).exists()


def test_an_unreadable_record_is_computed_again(machine, there):
    record, _ = machine().run("s", 1, {}, {}, write("x"))
    there.put(f"stages/{record.key[:2]}/{record.key}.json", b"{}")
    assert machine().get(record.key) is None
    _, cached = machine().run("s", 1, {}, {}, write("x"))
    assert not cached


def _compute_slowly(root: Path, location: Location, log: Path) -> None:
    def compute(folder: Path, key: str, hashing: object):
        with open(log, "a") as f:
            f.write("computed\n")
        time.sleep(0.5)
        (folder / "a.txt").write_text("x")
        return {}, 0.5, 0

    open_store(root, location).run("s", 1, {}, {}, compute)


def test_one_computation_however_many_machines_ask(location, tmp_path):
    context = multiprocessing.get_context("spawn")
    asking = [
        context.Process(target=_compute_slowly, args=(tmp_path / str(n), location, tmp_path / "log")) for n in range(3)
    ]
    for p in asking:
        p.start()
    for p in asking:
        p.join(60)
        assert p.exitcode == 0
    assert (tmp_path / "log").read_text() == "computed\n"


def test_a_lock_is_renewed_and_only_a_silent_one_taken_over(machine, there, monkeypatch):
    monkeypatch.setattr(bucket_lock, "POLL_SECONDS", 0.05)
    entered = threading.Event()

    def ask():
        with machine("two").lock("k"):
            entered.set()

    with machine("one").lock("k"):
        held = there.head("locks/k")
        asking = threading.Thread(target=ask)
        asking.start()
        # The renewal of the holder, as its thread does it.
        assert there.put("locks/k", b"renewed", tag=held.tag)
        assert not entered.wait(0.3)
        monkeypatch.setattr(bucket_lock, "LOCK_SECONDS", -1.0)  # now it counts as silent
        assert entered.wait(10)
        asking.join()
    assert there.head("locks/k") is None


def _hold_for_ever(root, location):
    with open_store(root, location).lock("k"):
        time.sleep(600)


def test_who_was_killed_holds_up_nobody_of_its_own_machine(machine, location, there, tmp_path):
    """Whoever killed it may be gone as well: a worker that dies takes its compute process along."""
    holder = multiprocessing.get_context("spawn").Process(target=_hold_for_ever, args=(tmp_path / "one", location))
    holder.start()
    wait_for(lambda: there.head("locks/k"), "the lock")
    holder.kill()
    holder.join()
    held = there.head("locks/k")
    entered = threading.Event()

    def ask():
        with machine("two").lock("k"):
            entered.set()

    asking = threading.Thread(target=ask)
    asking.start()
    assert not entered.wait(1.5)  # another machine cannot know that it is dead
    assert there.head("locks/k").tag == held.tag
    start = time.monotonic()
    with machine("one").lock("k"):
        assert time.monotonic() - start < 10
    assert entered.wait(10)
    asking.join()


def test_the_locks_of_a_killed_process_are_freed(machine, there):
    store = machine()
    there.put("locks/mine", store_content := f"{workspace_prefix(4711)}x".encode())
    there.put("locks/other", store_content.replace(b"4711", b"4712"))
    store.remove_workspaces(4711)
    assert [head.name for head in there.list("locks/")] == ["locks/other"]


def test_a_record_that_is_used_is_not_removed(machine, there, monkeypatch):
    """Whoever comes first wins: the collection that removes an old record, or the case that asks for it."""
    record, _ = machine().run("s", 1, {}, {}, write("x"))
    name = f"stages/{record.key[:2]}/{record.key}.json"
    make_old(there, monkeypatch)
    seen = there.head(name)
    assert machine("two").get(record.key) == record  # written again
    assert not there.delete(name, tag=seen.tag)
    before = there.get(name)
    monkeypatch.setattr(Bucket, "get", lambda self, n: before)  # seen by a case just before ...
    assert machine("two").remove_record(record.key, time.time() - 3600)  # ... it is removed
    assert machine("two").get(record.key) is None


def test_lately_used_records_and_objects_stay(machine):
    store = machine()
    record, _ = store.run("s", 1, {}, {}, write("x"))
    ref = record.outputs["a.txt"]
    assert not store.remove_record(record.key, time.time() - 3600)
    assert not store.remove_object(ref.sha256, time.time() - 3600)
    assert [r.name for r in store.records()] == [record.key]
    assert {o.name: o.size for o in store.objects()} == {r.sha256: r.size for r in record.outputs.values()}
    assert store.remove_record(record.key, time.time() + 3600)
    assert store.remove_object(ref.sha256, time.time() + 3600)
    assert list(store.records()) == []
    assert not store.has(ref)


def test_an_old_object_is_written_again_before_its_record(machine, there, monkeypatch):
    machine().run("s", 1, {"p": 1}, {}, write("x"))
    make_old(there, monkeypatch, "objects/")
    before = {h.name: h.modified for h in there.list("objects/")}
    time.sleep(1.1)  # times of the service are whole seconds
    machine().run("s", 1, {"p": 2}, {}, write("x"))
    assert all(h.modified > before[h.name] for h in there.list("objects/"))


def test_an_object_removed_during_a_commit_is_written_again(machine, there, monkeypatch):
    store = machine()
    put = Bucket.put

    def put_and_lose(self, name, *args, **options):
        tag = put(self, name, *args, **options)
        if name.startswith("stages/") and not lost:
            lost.append(next(self.list("objects/")).name)
            self.delete(lost[0])
        return tag

    lost = []
    monkeypatch.setattr(Bucket, "put", put_and_lose)
    record, _ = store.run("s", 1, {}, {}, write("x"))
    assert lost
    assert store.get(record.key) == record


def test_the_cache_is_kept_small(machine, monkeypatch):
    store = machine(cache_bytes=3)
    record, _ = store.run("s", 1, {}, {}, write("x"))
    a, b = record.outputs["a.txt"], record.outputs["sub/b.txt"]
    store.backend.cache.trim()
    assert store.backend.folder.path(a).exists()  # used within the hour
    for n, ref in enumerate((a, b)):
        os.utime(store.backend.folder.path(ref), (time.time() - 7200 + n,) * 2)
    store.backend.cache.size = 2
    store.backend.cache.trim()
    assert not store.backend.folder.path(a).exists()
    assert store.backend.folder.path(b).exists()
    assert store.path(a).read_text() == "x"  # fetched again


def test_documents(machine):
    machine("one").write_document("phantoms", "b.json", b"{}")
    machine("one").write_document("phantoms", "a.json", b"[]")
    assert machine("two").documents("phantoms") == ["a.json", "b.json"]
    assert machine("two").read_document("phantoms", "a.json") == b"[]"
    assert machine("two").read_document("phantoms", "c.json") is None


def test_unfinished_uploads_are_swept(machine, there):
    client, name = there._client, there.location.bucket
    client.create_multipart_upload(Bucket=name, Key=there.location.prefix + "objects/x")
    machine().sweep_temporary(time.time() - 1.2e9)  # before 2008; moto begins them all in 2010
    assert "Uploads" in client.list_multipart_uploads(Bucket=name)
    machine().sweep_temporary()
    assert "Uploads" not in client.list_multipart_uploads(Bucket=name)


def test_what_is_wrong_with_the_bucket_is_said(location, tmp_path):
    def use(**changes):
        wrong = Location(**{**vars(location), **changes})
        with pytest.raises(StoreError) as caught:
            open_store(tmp_path, wrong).check()
        return caught.value.code, str(caught.value)

    code, message = use(url="s3://not-there")
    assert code == "store-unavailable"
    assert "make the bucket" in message or "make it" in message
    assert use(url="https://example.org")[0] == "invalid-store-url"
    code, message = use(endpoint="http://127.0.0.1:9")
    assert code == "store-unavailable"
    assert "http://127.0.0.1:9" in message


def test_without_credentials(location, tmp_path, monkeypatch):
    for name in [n for n in os.environ if n.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(StoreError, match="TOMOSIM_STORE_ACCESS_KEY"):
        open_store(tmp_path, Location(location.url, location.endpoint)).check()


def test_the_secret_is_not_shown(location):
    assert "test-secret" not in repr(location)
