"""Threads of the service outlive what goes wrong in them, and work outlives a database that is away."""

import threading
import time

import pytest
from sqlalchemy.exc import OperationalError, ProgrammingError

from worker.compute.watch import Watch, write_end
from worker.records.jobs import Jobs
from worker.upkeep.repeat import Repeated


def away(*args, **options):
    raise OperationalError("SELECT 1", {}, ConnectionError())


@pytest.mark.parametrize("error", [OSError("broken pipe"), KeyError("mistake"), ProgrammingError("", {}, KeyError())])
def test_an_error_does_not_end_the_thread(error, caplog):
    calls = []
    enough = threading.Event()

    def action():
        calls.append(time.monotonic())
        if len(calls) == 3:
            enough.set()
        raise error

    repeated = Repeated("heartbeat", action, 0.01, at_once=True)
    repeated.start()
    assert enough.wait(5.0)
    repeated.stop()
    assert "heartbeat failed" in caplog.text
    count = len(calls)
    time.sleep(0.05)
    assert len(calls) == count


@pytest.mark.embedded
@pytest.mark.parametrize(("outlasts", "verdict"), [(True, "running"), (False, "lost")])
def test_a_database_that_is_away_for_longer_than_a_lease(jobs: Jobs, monkeypatch, outlasts, verdict):
    watch = Watch(jobs, jobs.create({}, {}).id, "a", 600.0, outlasts=outlasts)
    monkeypatch.setattr(jobs, "renew", away)
    monkeypatch.setattr(jobs, "state_of", away)
    now = time.monotonic()
    monkeypatch.setattr("worker.compute.watch.time.monotonic", lambda: now + jobs.lease_seconds + 1)
    assert watch.verdict() == verdict


def test_the_end_of_a_case_waits_for_the_database(monkeypatch):
    monkeypatch.setattr("worker.records.database.RETRY_SECONDS", 0.01)
    answers = iter([away] * 20 + [lambda: True])
    assert write_end(lambda: next(answers)(), threading.Event()) is True


def test_a_worker_that_stops_does_not_wait_for_it_for_ever(monkeypatch):
    monkeypatch.setattr("worker.compute.watch.STOP_SECONDS", 0.1)
    stopping = threading.Event()
    stopping.set()
    assert write_end(away, stopping) is None
