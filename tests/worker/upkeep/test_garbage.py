"""Retention, pins and the collection of garbage: on SQLite and PostgreSQL, in a folder and in S3."""

import os
import subprocess
import sys
import threading
import time
from functools import partial

import pytest
import sqlalchemy as sa

from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import Reading
from simcore.spec import SimulationSpec
from simcore.store.backend import record_name
from simcore.store.bucket_backend import BucketBackend
from simcore.store.store import Store
from tests.support import fake_pipeline
from worker.records import schema
from worker.records.database import connect, simulations
from worker.records.fleet import Chores
from worker.records.jobs import Jobs, StageProgress
from worker.records.retention import ExpiredError, Retention
from worker.records.studies import NewCase, Studies
from worker.serve.processes import environment
from worker.upkeep.garbage import Collector, collect

HOUR = 3600.0
DAY = 24 * HOUR


@pytest.fixture(params=["folder", "s3"])
def store(request, tmp_path):
    if request.param == "folder":
        return Store(tmp_path / "store", min_free_bytes=0)
    location = request.getfixturevalue("make_location")()
    return Store(tmp_path / "store", 0, partial(BucketBackend, location=location))


@pytest.fixture
def collecting(store, tmp_path):
    """The store as the machine sees it that collects: in S3 another one than that of the cases, with its own folder."""
    if not isinstance(store.backend, BucketBackend):
        return store
    return Store(tmp_path / "collecting", 0, partial(BucketBackend, location=store.backend.bucket.location))


@pytest.fixture
def database(tmp_path, backend):
    engine = connect(str(backend.get("database_url", f"sqlite:///{tmp_path / 'garbage.db'}")))
    schema.upgrade(engine)
    yield engine
    engine.dispose()


@pytest.fixture
def real_jobs(database):
    return Jobs(database)


@pytest.fixture
def run(real_jobs, store):
    """Computes a case: its row."""

    def case(seed, **options):
        row = real_jobs.create({"seed": seed}, {}, **options)
        real_jobs.claim(row.id, "test")
        manifest = fake_pipeline.run(SimulationSpec(seed=seed), store, lambda *a, **k: None).manifest
        assert real_jobs.succeed(row.id, "test", manifest)
        return real_jobs.get(row.id)

    return case


def later(database, store, seconds=2 * DAY, **options):
    """A collection at that time from now."""
    return collect(database, store, DAY, time.time() + seconds, **options)


def is_whole(real_jobs, store, row):
    manifest = real_jobs.manifest(row.id)
    return all(store.get(stage["key"]) is not None for stage in manifest["stages"])


# Collection


def test_only_what_nobody_needs_is_collected(run, real_jobs, database, store):
    kept, deleted = run(1), run(2)
    real_jobs.delete(deleted.id)
    assert len(list(store.objects())) == 6
    planned = later(database, store, dry_run=True)
    assert (planned.records, planned.objects, planned.kept_objects) == (2, 3, 3)
    assert len(list(store.objects())) == 6
    done = later(database, store)
    assert done == planned
    assert done.size > 0
    assert is_whole(real_jobs, store, kept)
    assert len(list(store.objects())) == 3
    assert later(database, store).objects == 0


def test_what_was_used_within_the_grace_period_stays(run, real_jobs, database, store):
    real_jobs.delete(run(1).id)
    done = later(database, store, seconds=HOUR)
    assert (done.records, done.objects) == (0, 0)


def test_files_that_two_cases_share_stay_as_long_as_one_needs_them(run, real_jobs, database, store):
    one, two = run(1), run(1)
    real_jobs.delete(one.id)
    assert later(database, store).objects == 0
    real_jobs.delete(two.id)
    assert later(database, store).kept_objects == 0


def test_expired_cases_are_collected_and_pinned_ones_are_not(run, real_jobs, database, store):
    expired, pinned, unlimited = run(1, retention=HOUR), run(2, retention=HOUR), run(3)
    assert expired.expires_at == pytest.approx(time.time() + HOUR, abs=60)
    Retention(database).pin(pinned.id)
    done = later(database, store)
    assert (done.objects, done.kept_objects) == (3, 6)
    assert is_whole(real_jobs, store, pinned)
    assert is_whole(real_jobs, store, unlimited)


def test_uploaded_phantoms_stay(database, store, tmp_path):
    import numpy as np

    np.full((4, 4, 4), 5, "u1").tofile(tmp_path / "p.raw")
    raw = '{"raw": {"shape": [4, 4, 4], "spacing_mm": [1, 1, 1]}'
    header = raw + ', "tissues": {"0": "air", "5": "adipose"}, "confirm_size": true}'
    upload = registry.add_file(store, tmp_path / "p.raw", Reading.parse(header))
    assert [u.sha256 for u in registry.uploads(store)] == [upload.sha256]
    done = later(database, store)
    assert (done.objects, done.kept_objects) == (0, 1)
    assert registry.get(store, upload.sha256) == upload


def test_a_torn_record_is_collected(run, real_jobs, database, store):
    row = run(1)
    key = real_jobs.manifest(row.id)["stages"][0]["key"]
    real_jobs.delete(row.id)
    store.backend.write(record_name(key), b"torn")
    assert later(database, store).records == 2


# Races


def age(store, monkeypatch, seconds=2 * DAY):
    """Everything in the store was used so long ago."""
    if isinstance(store.backend, BucketBackend):
        from simcore.store import bucket

        def aged(head):
            return head and bucket.Head(head.name, head.size, head.tag, head.modified - seconds, head.age + seconds)

        old = {head.name: head.tag for head in store.backend.bucket.list("")}
        head_of, get, listed = bucket.Bucket.head, bucket.Bucket.get, bucket.Bucket.list

        def if_old(head):
            return aged(head) if head and old.get(head.name) == head.tag else head

        def got(self, name):
            entry = get(self, name)
            return entry and (entry[0], if_old(entry[1]))

        monkeypatch.setattr(bucket.Bucket, "head", lambda self, name: if_old(head_of(self, name)))
        monkeypatch.setattr(bucket.Bucket, "get", got)
        monkeypatch.setattr(bucket.Bucket, "list", lambda self, prefix: map(if_old, listed(self, prefix)))
    else:
        then = time.time() - seconds
        for path in (*store.root.glob("objects/*/*"), *store.root.glob("stages/*/*")):
            os.utime(path, (then, then))


def write(text):
    def compute(folder, key, hashing):
        (folder / "a").write_text(text)
        return {}, 0.0, 0

    return compute


def test_a_case_that_reads_its_inputs_keeps_them(database, store, collecting, monkeypatch):
    record, _ = store.run("phantom", 1, {}, {}, write("input"))
    age(store, monkeypatch)
    stored, cached = store.run("phantom", 1, {}, {}, write("input"))
    assert cached
    done = collect(database, collecting, DAY, time.time())
    assert (done.records, done.objects) == (0, 0)
    assert collecting.path(stored.outputs["a"]).read_text() == "input"
    assert stored == record


def test_a_case_that_commits_what_is_about_to_be_removed(database, store, collecting, monkeypatch):
    """The same content under another key: the old file is not removed under the new record."""
    store.run("phantom", 1, {"p": 1}, {}, write("same"))
    age(store, monkeypatch)
    listed = collecting.objects

    def commit_meanwhile():
        rows = list(listed())
        store.run("phantom", 1, {"p": 2}, {}, write("same"))
        return iter(rows)

    monkeypatch.setattr(collecting, "objects", commit_meanwhile)
    done = collect(database, collecting, DAY, time.time())
    record, cached = store.run("phantom", 1, {"p": 2}, {}, write("same"))
    # S3 keeps the time of a write of equal content to the second
    assert cached or isinstance(store.backend, BucketBackend)
    assert collecting.has(record.outputs["a"])
    assert done.records == 1


def test_collections_and_cases_at_once(database, store, monkeypatch):
    """Cases ask for and write the same few stages while collections remove whatever they may, without any grace."""
    if isinstance(store.backend, BucketBackend):
        pytest.skip("its clock has whole seconds: the grace period cannot be so short")
    failures = []
    grace = 0.2
    stop = threading.Event()

    def collect_always():
        while not stop.is_set():
            collect(database, store, grace, time.time())

    collector = threading.Thread(target=collect_always)
    collector.start()
    try:
        for n in range(150):
            began = time.time()
            record, _ = store.run("s", 1, {"n": n % 3}, {}, write(f"content {n % 3 % 2}"))
            try:
                assert store.path(record.outputs["a"]).read_text() == f"content {n % 3 % 2}"
            except OSError as error:
                if time.time() - began < grace:  # a machine that was busy for longer has no claim to it any more
                    failures.append(error)
            if n % 20 == 0:
                time.sleep(0.25)
    finally:
        stop.set()
        collector.join()
    assert failures == []


# Retention


def test_expiry_begins_at_the_end(jobs, clock):
    row = jobs.create({}, {}, retention=DAY)
    assert row.expires_at is None
    clock.now += 5 * DAY
    jobs.claim(row.id, "w")
    jobs.succeed(row.id, "w", {"files": {}})
    assert jobs.get(row.id).expires_at == clock.now + DAY
    assert jobs.manifest(row.id) == {"files": {}}
    clock.now += DAY
    with pytest.raises(ExpiredError, match=row.id):
        jobs.manifest(row.id)
    assert jobs.get(row.id).state == "succeeded"


def test_pins(jobs, clock, engine):
    retention = Retention(engine, clock)
    row = jobs.create({}, {}, retention=DAY)
    retention.pin(row.id)
    jobs.claim(row.id, "w")
    jobs.succeed(row.id, "w", {"files": {}})
    clock.now += 9 * DAY
    assert jobs.manifest(row.id) is not None
    retention.unpin(row.id)
    assert jobs.get(row.id).expires_at == clock.now + DAY
    clock.now += 2 * DAY
    with pytest.raises(ExpiredError):
        retention.pin(row.id)
    with pytest.raises(LookupError):
        retention.pin("0" * 32)


def test_cases_of_a_study_expire_together(jobs, clock, engine):
    studies = Studies(jobs)
    study = studies.create("s", {}, [], {}, [NewCase(str(n), {}, {}, {}) for n in range(3)], retention=DAY)
    first, second, third = studies.cases(study.id, 10)
    jobs.claim(first.id, "w")
    jobs.succeed(first.id, "w", {"files": {}})
    clock.now += 3 * DAY
    assert jobs.manifest(first.id) is not None
    jobs.cancel(second.id)
    jobs.claim(third.id, "w")
    jobs.fail(third.id, "w", {"kind": "user", "code": "c", "message": "m"})
    ends = [jobs.get(case.id).expires_at for case in (first, second, third)]
    assert ends == [clock.now + DAY, None, None]
    Retention(engine, clock).pin_study(study.id)
    clock.now += 9 * DAY
    assert jobs.manifest(first.id) is not None


def test_an_expiry_that_two_ends_at_once_have_missed(jobs, clock, engine):
    row = jobs.create({}, {}, retention=DAY)
    jobs.claim(row.id, "w")
    jobs.succeed(row.id, "w", {"files": {}})
    with engine.begin() as connection:
        connection.execute(simulations.update().values(expires_at=None))
    Retention(engine, clock).complete_expiry()
    assert jobs.get(row.id).expires_at == clock.now + DAY


def test_progress_is_forgotten_and_states_are_not(jobs, clock, engine):
    done, running = jobs.create({}, {}), jobs.create({}, {})
    for row in (done, running):
        jobs.claim(row.id, "w")
        jobs.progress(row.id, "w", StageProgress("mesh", 1, 2, 0.5, ""))
    jobs.succeed(done.id, "w", {"files": {}})
    assert Retention(engine, clock).prune_events(DAY) == 0
    clock.now += 2 * DAY
    assert Retention(engine, clock).prune_events(DAY) == 1
    assert [e.kind for e in jobs.events_after(done.id, 0)] == ["state", "state", "state"]
    assert "progress" in [e.kind for e in jobs.events_after(running.id, 0)]


# Now and then


def test_one_of_many_does_a_chore(engine, clock):
    one, two = Chores(engine, clock), Chores(engine, clock)
    assert one.claim("c", within_seconds=60)
    assert not two.claim("c", within_seconds=60)
    clock.now += 61  # it was killed
    assert two.claim("c", within_seconds=60)
    two.done("c", again_seconds=600)
    clock.now += 500
    assert not one.claim("c", within_seconds=60)
    clock.now += 101
    assert one.claim("c", within_seconds=60)


def test_the_collector_collects_once_an_interval(make_settings, run, real_jobs, database, store):
    real_jobs.delete(run(1).id)
    now = [time.time() + 2 * DAY]
    collector = Collector(make_settings(), database, store, lambda: now[0])
    assert collector.sweep().objects == 3
    assert collector.sweep() is None
    now[0] += HOUR + 1
    assert collector.sweep().objects == 0


def test_by_command(make_settings, tmp_path):
    settings = make_settings(database_url=f"sqlite:///{tmp_path / 'c.db'}", job_timeout_seconds=1, gc_grace_seconds=2)

    def tomosim(*words):
        command = [sys.executable, "-m", "tomosim", *words]
        return subprocess.run(command, env=environment(settings), capture_output=True, text=True)

    assert "tomosim db upgrade" in tomosim("gc").stderr
    assert tomosim("db", "upgrade").returncode == 0
    done = tomosim("gc", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("would remove 0 stages and 0 files")
    with connect(settings.database_url).connect() as connection:
        assert connection.scalar(sa.select(sa.func.count()).select_from(simulations)) == 0
