"""A worker slot with a real compute process: every way a case can end, and the next one still works.

One slot serves all tests, as it serves all cases: what one leaves behind would harm the next.
"""

import itertools
import json
import os
import signal
import subprocess
import sys
import threading

import pytest

from tests.support.waiting import wait_for
from worker.compute.supervisor import Slot, Slots
from worker.records import schema
from worker.records.database import connect
from worker.records.jobs import Jobs
from worker.records.quotas import Submitter
from worker.serve.processes import environment

PATIENCE_SECONDS = 60


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and was not waited for does not."""
    try:
        with open(f"/proc/{pid}/stat") as f:
            return f.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.fixture(scope="module")
def settings(make_module_settings):
    return make_module_settings()


@pytest.fixture(scope="module")
def jobs(settings):
    engine = connect(settings.resolved_database_url)
    schema.upgrade(engine)
    yield Jobs(engine, lease_seconds=settings.lease_seconds)
    engine.dispose()


@pytest.fixture(scope="module")
def shared_slot(settings, jobs):
    slot = Slot("test", settings, jobs, threading.Event())
    yield slot
    slot.kill()


@pytest.fixture
def slot(shared_slot):
    yield shared_slot
    shared_slot.stopping.clear()


seeds = itertools.count(1000)


def queue(jobs, name, seed=None):
    """A case of this name; with stages of its own unless a seed is given."""
    return jobs.create({"name": name, "seed": next(seeds) if seed is None else seed}, {"seconds": 1.0}, name).id


def run_in_thread(slot, identifier):
    thread = threading.Thread(target=slot.run, args=(identifier,))
    thread.start()
    return thread


def running(jobs, identifier):
    """The row of a case whose last stage is under way."""
    return wait_for(
        lambda: (row := jobs.get(identifier)).state == "running" and row.message.startswith("step") and row, "the start"
    )


def next_case_works(slot, jobs):
    identifier = queue(jobs, "next")
    slot.run(identifier)
    assert jobs.get(identifier).state == "succeeded"


def test_a_case_succeeds_and_the_process_stays_warm(slot, jobs):
    first = queue(jobs, "noise", seed=1)
    slot.run(first)
    row = jobs.get(first)
    assert (row.state, row.error) == ("succeeded", None)
    assert (row.stage, row.stages_done, row.stages_total) == ("preview", 2, 2)
    assert set(jobs.manifest(first)["files"]) == {"projections/0001.dcm", "volume.dcm", "preview/phantom.png"}
    pid = slot.warm_up().pid
    again = queue(jobs, "noise", seed=1)
    slot.run(again)
    assert slot.warm_up().pid == pid
    assert jobs.manifest(again)["computed_stages"] == 0
    progress = [e.data for e in jobs.events_after(again, 0) if e.kind == "progress"]
    assert [p["message"] for p in progress] == ["started", "from the store", "started", "from the store"]


@pytest.mark.parametrize(
    ("name", "kind", "code", "words"),
    [
        ("refuse", "simulation", "solver-failed", "did not converge"),
        ("mistake", "system", "internal-error", "KeyError"),
        ("memory", "system", "out-of-memory", "TOMOSIM_MEMORY_LIMIT_BYTES"),
        ("cpp", "system", "out-of-memory", "TOMOSIM_MEMORY_LIMIT_BYTES"),
        ("rust", "system", "out-of-memory", "larger voxels"),
        ("exit", "system", "compute-crashed", "exit code 3"),
    ],
)
def test_a_failure_is_clear_and_the_next_case_works(slot, jobs, name, kind, code, words):
    identifier = queue(jobs, name)
    slot.run(identifier)
    row = jobs.get(identifier)
    assert (row.state, row.attempt) == ("failed", 1)
    assert (row.error["kind"], row.error["code"]) == (kind, code)
    assert words in row.error["message"]
    next_case_works(slot, jobs)


def test_memory_limit_holds(make_module_settings, jobs):
    """An allocation that the machine could serve but the limit forbids."""
    slot = Slot("test", make_module_settings(memory_limit_bytes=400_000_000), jobs, threading.Event())
    try:
        identifier = queue(jobs, "gigabyte")
        slot.run(identifier)
        assert jobs.get(identifier).error["code"] == "out-of-memory"
    finally:
        slot.kill()


def test_a_case_that_always_crashes_fails_after_three_attempts(slot, jobs):
    identifier = queue(jobs, "crash")
    for attempt in (1, 2):
        slot.run(identifier)
        row = jobs.get(identifier)
        assert (row.state, row.attempt, row.sent, row.error) == ("queued", attempt, None, None)
    slot.run(identifier)
    row = jobs.get(identifier)
    assert (row.state, row.attempt, row.error["code"]) == ("failed", 3, "compute-crashed")
    assert "SIGSEGV" in row.error["message"]
    assert "attempt 3" in row.error["message"]
    next_case_works(slot, jobs)


def test_a_killed_compute_process_costs_an_attempt_not_the_case(slot, jobs):
    identifier = queue(jobs, "slow")
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    os.kill(slot.warm_up().pid, signal.SIGKILL)
    thread.join(PATIENCE_SECONDS)
    assert jobs.get(identifier).state == "queued"
    assert "SIGKILL" in jobs.events_after(identifier, 0)[-1].data["reason"]["message"]
    slot.run(identifier)
    assert (jobs.get(identifier).state, jobs.get(identifier).attempt) == ("succeeded", 2)


def test_killed_by_the_kernel_for_want_of_memory_is_not_tried_again(slot, jobs, monkeypatch):
    kills = iter([3, 4])
    monkeypatch.setattr("worker.compute.memory.kernel_kills", lambda: next(kills))
    identifier = queue(jobs, "slow")
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    os.kill(slot.warm_up().pid, signal.SIGKILL)
    thread.join(PATIENCE_SECONDS)
    row = jobs.get(identifier)
    assert (row.state, row.attempt, row.error["code"]) == ("failed", 1, "out-of-memory")
    assert "container" in row.error["message"]


def test_a_cancelled_case_is_not_tried_again_after_a_crash(slot, jobs, monkeypatch):
    identifier = queue(jobs, "forever")
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    # The crash is noticed before the cancellation.
    monkeypatch.setattr("worker.compute.watch.STATE_SECONDS", 3600)
    jobs.cancel(identifier)
    os.kill(slot.warm_up().pid, signal.SIGSEGV)
    thread.join(PATIENCE_SECONDS)
    assert jobs.get(identifier).state == "cancelled"


def test_cancel_while_the_process_starts(slot, jobs):
    slot.kill()
    identifier = queue(jobs, "fine")
    thread = run_in_thread(slot, identifier)
    wait_for(lambda: jobs.get(identifier).state == "running")
    assert not slot.warm_up().ready
    jobs.cancel(identifier)
    thread.join(PATIENCE_SECONDS)
    row = jobs.get(identifier)
    assert (row.state, row.stage) == ("cancelled", None)


def test_killed_between_two_cases(slot, jobs):
    next_case_works(slot, jobs)
    process = slot.warm_up()
    os.kill(process.pid, signal.SIGKILL)
    wait_for(lambda: not process.alive)
    next_case_works(slot, jobs)


def test_cancel_kills_the_process(slot, jobs, settings):
    identifier = queue(jobs, "forever")
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    pid = slot.warm_up().pid
    unfinished = settings.store_folder / "tmp"
    assert list(unfinished.iterdir())
    jobs.cancel(identifier)
    thread.join(PATIENCE_SECONDS)
    assert jobs.get(identifier).state == "cancelled"
    assert not is_alive(pid)
    assert list(unfinished.iterdir()) == []
    next_case_works(slot, jobs)


def test_timeout(make_module_settings, jobs):
    slot = Slot("test", make_module_settings(job_timeout_seconds=3.0), jobs, threading.Event())
    try:
        identifier = queue(jobs, "forever")
        slot.run(identifier)
        row = jobs.get(identifier)
        assert (row.state, row.error["code"]) == ("failed", "timeout")
    finally:
        slot.kill()


def test_stopping_gives_the_case_back(slot, jobs):
    identifier = queue(jobs, "forever")
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    pid = slot.warm_up().pid
    slot.stopping.set()
    thread.join(PATIENCE_SECONDS)
    row = jobs.get(identifier)
    assert (row.state, row.attempt, row.sent) == ("queued", 0, None)
    assert not is_alive(pid)
    jobs.mark_sent(identifier)
    slot.run(identifier)  # a message that comes while the worker stops is not lost
    assert (jobs.get(identifier).state, jobs.get(identifier).sent) == ("queued", None)


def test_a_case_taken_by_another_worker_is_let_go(slot, jobs):
    identifier = queue(jobs, "forever")
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    jobs.expire_leases()
    assert jobs.take_back(3) == [identifier]
    jobs.claim(identifier, "another")
    thread.join(PATIENCE_SECONDS)
    assert jobs.get(identifier).owner == "another"
    assert jobs.get(identifier).state == "running"


def test_a_worker_that_starts_anew_does_not_take_what_its_namesake_had(slot, jobs):
    """In a container every worker has the same name; a message that comes again must not be taken for its own."""
    identifier = queue(jobs, "fine")
    assert jobs.claim(identifier, f"{slot.name}/1")
    slot.run(identifier)
    row = jobs.get(identifier)
    assert (row.state, row.owner, row.attempt) == ("running", f"{slot.name}/1", 1)
    jobs.cancel(identifier)


def test_late_and_double_messages_do_nothing(slot, jobs):
    identifier = queue(jobs, "fine")
    slot.run(identifier)
    revision = jobs.get(identifier).revision
    slot.run(identifier)
    slot.run("0" * 32)
    assert jobs.get(identifier).revision == revision


def test_a_pipeline_that_cannot_be_imported(make_module_settings, jobs):
    slot = Slot("test", make_module_settings(pipeline="no_such_module:run"), jobs, threading.Event())
    try:
        identifier = queue(jobs, "fine")
        slot.run(identifier)
        assert "no_such_module" in jobs.get(identifier).error["message"]
    finally:
        slot.kill()


def test_finished_stages_are_kept_over_a_kill(slot, jobs):
    identifier = queue(jobs, "forever", seed=7)
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    jobs.cancel(identifier)
    thread.join(PATIENCE_SECONDS)
    jobs.retry(identifier)
    thread = run_in_thread(slot, identifier)
    running(jobs, identifier)
    messages = [e.data["message"] for e in jobs.events_after(identifier, 0) if e.kind == "progress"]
    assert "from the store" in messages
    jobs.cancel(identifier)
    thread.join(PATIENCE_SECONDS)


def test_two_slots_run_two_cases(make_module_settings, jobs):
    stopping = threading.Event()
    slots = Slots("test", make_module_settings(worker_slots=2), jobs, stopping)
    try:
        cases = [queue(jobs, "forever", seed) for seed in (1, 2)]
        threads = [run_in_thread(slots, c) for c in cases]
        for c in cases:
            running(jobs, c)
        stopping.set()
        for t in threads:
            t.join(PATIENCE_SECONDS)
        assert [jobs.get(c).state for c in cases] == ["queued", "queued"]
    finally:
        slots.kill()


def test_compute_process_dies_with_its_parent(make_module_settings):
    code = (
        "import sys, time; from worker.compute.process import ComputeProcess; from worker.settings import Settings\n"
        "process = ComputeProcess(Settings.load())\n"
        "while not process.ready: process.receive(1)\n"
        "process.run({'name': 'silent'}, {})\n"  # it does not see that nobody listens any more
        "while (process.receive(60) or {}).get('stage') != 'preview': pass\n"
        "print(process.pid, flush=True); time.sleep(600)"
    )
    env = environment(make_module_settings())
    parent = subprocess.Popen([sys.executable, "-c", code], env=env, stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    assert is_alive(child)
    parent.kill()
    parent.wait()
    wait_for(lambda: not is_alive(child), "the end of the compute process")


def test_log_lines_of_the_compute_process_name_their_case(slot, jobs, capfd):
    first = jobs.create({"name": "refuse"}, {"seconds": 1.0}, submitter=Submitter("local", "request-1")).id
    second = jobs.create({"name": "fine"}, {"seconds": 1.0}, submitter=Submitter("local", "request-2")).id
    slot.run(first)
    slot.run(second)
    slot.kill()  # all that it has written has come through
    lines = [json.loads(line) for line in capfd.readouterr().err.splitlines() if line.startswith('{"time"')]
    [failed] = [line for line in lines if line["message"] == "case failed"]
    assert (failed["simulation"], failed["request"], failed["attempt"]) == (first, "request-1", 1)
    assert failed["stage"] == "preview"
    assert "SolverError" in failed["exception"]
    done = [line for line in lines if line["message"] == "stage done" and line["simulation"] == second]
    assert [(line["stage"], line["request"]) for line in done] == [("dicom", "request-2"), ("preview", "request-2")]
