"""Too little space: nothing new is taken, what runs fails clearly, what is computed stays."""

import os
import subprocess
import threading

import pytest

from simcore.core.errors import StoreError
from simcore.store.store import Store
from worker.compute.supervisor import Slot
from worker.records import schema
from worker.records.database import connect
from worker.records.jobs import Jobs

MANY = 1 << 60


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a disk of 16 MB that can be made larger."""
    if os.getuid() != 0:
        pytest.skip("needs the right to mount a file system")
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(folder)], capture_output=True)
    if done.returncode:
        pytest.skip(f"needs the right to mount a file system: {done.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.embedded
def test_a_case_on_a_full_disk_fails_and_goes_on_when_there_is_space(small_disk, make_settings):
    settings = make_settings(data_folder=small_disk, min_free_bytes=0)
    engine = connect(settings.resolved_database_url)
    schema.upgrade(engine)
    jobs = Jobs(engine)
    slot = Slot("test", settings, jobs, threading.Event())
    try:
        row = jobs.create({"name": "large"}, {})
        slot.run(row.id)
        error = jobs.get(row.id).error
        assert (error["kind"], error["code"]) == ("system", "storage-full")
        assert "stages that finished are kept" in error["message"]
        assert list((settings.store_folder / "tmp").iterdir()) == []
        assert len(list(Store(settings.store_folder).records())) == 1
        # The next one is not kept from running.
        small = jobs.create({"name": "small"}, {})
        slot.run(small.id)
        assert jobs.get(small.id).state == "succeeded"
        subprocess.run(["mount", "-o", "remount,size=96m", str(small_disk)], check=True)
        jobs.retry(row.id)
        slot.run(row.id)
        assert jobs.get(row.id).state == "succeeded"
        assert jobs.manifest(row.id)["computed_stages"] == 1
    finally:
        slot.kill()
        engine.dispose()


def test_a_write_without_space_is_a_full_disk(tmp_path):
    """/dev/full has no space, whatever the disk has."""

    def compute(folder, key, hashing):
        (folder / "a").symlink_to("/dev/full")
        (folder / "a").write_bytes(b"x" * 100_000)
        return {}, 0.0, 0

    store = Store(tmp_path, min_free_bytes=0)
    with pytest.raises(StoreError, match="is full") as caught:
        store.run("s", 1, {}, {}, compute)
    assert caught.value.code == "storage-full"
    assert list((tmp_path / "tmp").iterdir()) == []


def test_below_the_floor_no_stage_is_started(make_settings):
    settings = make_settings(min_free_bytes=MANY)
    engine = connect(settings.resolved_database_url)
    schema.upgrade(engine)
    jobs = Jobs(engine)
    slot = Slot("test", settings, jobs, threading.Event())
    try:
        row = jobs.create({"name": "fine"}, {})
        slot.run(row.id)
        assert jobs.get(row.id).error["code"] == "storage-full"
    finally:
        slot.kill()
        engine.dispose()
