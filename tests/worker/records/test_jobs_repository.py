"""The repository: who may change what, on SQLite and PostgreSQL."""

import threading

import pytest

from worker.records.fleet import Fleet
from worker.records.jobs import StageProgress
from worker.records.rows import NotFoundError, StateError

ERROR = {"kind": "system", "code": "test", "message": "for the test"}
MANIFEST = {"files": {}, "results": {"force_N": 100.0}}


def states(jobs, identifier):
    return [e.data["state"] for e in jobs.events_after(identifier, 0) if e.kind == "state"]


@pytest.fixture
def queued(jobs):
    return jobs.create({"seed": 1}, {"seconds": 1.0}, "case").id


def test_a_case_from_queue_to_end(jobs, queued):
    claimed = jobs.claim(queued, "a")
    assert (claimed.state, claimed.attempt, claimed.owner) == ("running", 1, "a")
    assert jobs.progress(queued, "a", StageProgress("mesh", 1, 8, 0.5, "half"))
    assert jobs.succeed(queued, "a", MANIFEST)
    done = jobs.get(queued)
    assert (done.state, done.owner, done.lease_until, done.fraction) == ("succeeded", None, None, 1.0)
    assert (done.stages_done, done.stages_total) == (8, 8)
    assert done.results == {"force_N": 100.0}
    assert jobs.manifest(queued) == MANIFEST
    assert jobs.specification(queued) == {"seed": 1}
    assert states(jobs, queued) == ["queued", "running", "succeeded"]
    sequences = [e.sequence for e in jobs.events_after(queued, 0)]
    assert sequences == list(range(1, done.revision + 1))
    assert [e.sequence for e in jobs.events_after(queued, 2)] == [3, 4]


def test_one_claim_wins(jobs, queued):
    assert jobs.claim(queued, "a")
    assert jobs.claim(queued, "b") is None
    assert jobs.get(queued).attempt == 1


def test_one_of_many_threads_claims(jobs, queued):
    won = []
    barrier = threading.Barrier(8)

    def compete(name):
        barrier.wait()
        if jobs.claim(queued, name):
            won.append(name)

    threads = [threading.Thread(target=compete, args=(f"w{n}",)) for n in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(won) == 1
    assert jobs.get(queued).owner == won[0]
    assert states(jobs, queued) == ["queued", "running"]


def test_only_the_owner_ends_a_case(jobs, queued):
    jobs.claim(queued, "a")
    assert not jobs.succeed(queued, "b", MANIFEST)
    assert not jobs.fail(queued, "b", ERROR)
    assert not jobs.progress(queued, "b", StageProgress("mesh", 0, 8, 0.1, ""))
    assert not jobs.release(queued, "b")
    assert jobs.renew(queued, "b") is None
    assert jobs.get(queued).state == "running"


def test_an_expired_lease_goes_back_to_the_queue(jobs, queued, clock):
    jobs.claim(queued, "a")
    jobs.mark_sent(queued)
    assert jobs.take_back(3) == []
    clock.now += 29
    assert jobs.renew(queued, "a") == "running"
    clock.now += 29
    assert jobs.take_back(3) == []
    clock.now += 2
    assert jobs.take_back(3) == [queued]
    row = jobs.get(queued)
    assert (row.state, row.owner, row.sent, row.attempt) == ("queued", None, None, 1)
    # The one that lost it may say what it likes.
    assert jobs.renew(queued, "a") is None
    assert not jobs.succeed(queued, "a", MANIFEST)
    assert jobs.claim(queued, "b").attempt == 2


def test_progress_renews_the_lease(jobs, queued, clock):
    jobs.claim(queued, "a")
    clock.now += 29
    jobs.progress(queued, "a", StageProgress("mesh", 0, 8, 0.1, ""))
    clock.now += 29
    assert jobs.take_back(3) == []


def test_lost_too_often_fails(jobs, queued, clock):
    for attempt in range(1, 4):
        assert jobs.claim(queued, f"w{attempt}").attempt == attempt
        clock.now += 31
        assert jobs.take_back(3) == [queued]
    row = jobs.get(queued)
    assert row.state == "failed"
    assert row.error["code"] == "worker-lost"
    assert jobs.take_back(3) == []


def test_cancel_queued_is_at_once(jobs, queued):
    assert jobs.cancel(queued).state == "cancelled"
    assert jobs.claim(queued, "a") is None
    assert jobs.cancel(queued).state == "cancelled"  # again does no harm


def test_cancel_running_waits_for_the_worker(jobs, queued):
    jobs.claim(queued, "a")
    assert jobs.cancel(queued).state == "cancelling"
    assert jobs.renew(queued, "a") == "cancelling"
    assert jobs.cancelled(queued, "a")
    assert states(jobs, queued) == ["queued", "running", "cancelling", "cancelled"]


def test_cancelled_without_a_worker(jobs, queued, clock):
    jobs.claim(queued, "a")
    jobs.cancel(queued)
    clock.now += 31
    assert jobs.take_back(3) == [queued]
    assert jobs.get(queued).state == "cancelled"


@pytest.mark.parametrize("end", ["succeed", "fail", "release"])
def test_an_end_after_cancel_is_a_cancel(jobs, queued, end):
    jobs.claim(queued, "a")
    jobs.cancel(queued)
    more = {"succeed": [MANIFEST], "fail": [ERROR], "release": []}[end]
    assert getattr(jobs, end)(queued, "a", *more)
    row = jobs.get(queued)
    assert (row.state, row.error, jobs.manifest(queued)) == ("cancelled", None, None)


def test_cancel_of_finished(jobs, queued):
    jobs.claim(queued, "a")
    jobs.succeed(queued, "a", MANIFEST)
    with pytest.raises(StateError) as caught:
        jobs.cancel(queued)
    assert caught.value.state == "succeeded"


def test_release_does_not_count(jobs, queued):
    jobs.mark_sent(queued)
    jobs.claim(queued, "a")
    assert jobs.release(queued, "a")
    row = jobs.get(queued)
    assert (row.state, row.attempt, row.sent, row.owner) == ("queued", 0, None, None)


def test_retry(jobs, queued):
    with pytest.raises(StateError):
        jobs.retry(queued)
    jobs.claim(queued, "a")
    jobs.fail(queued, "a", ERROR)
    assert jobs.get(queued).error == ERROR
    again = jobs.retry(queued)
    assert (again.state, again.attempt, again.error, again.finished) == ("queued", 0, None, None)
    jobs.claim(queued, "b")
    jobs.succeed(queued, "b", MANIFEST)
    with pytest.raises(StateError):
        jobs.retry(queued)


def test_delete_takes_the_events_along(jobs, queued):
    with pytest.raises(StateError):
        jobs.delete(queued)
    jobs.cancel(queued)
    jobs.delete(queued)
    with pytest.raises(NotFoundError):
        jobs.get(queued)
    assert jobs.events_after(queued, 0) == []
    for ask in (jobs.delete, jobs.cancel, jobs.retry, jobs.specification, jobs.manifest):
        with pytest.raises(NotFoundError):
            ask(queued)


def test_pages_newest_first_without_gaps(jobs, clock):
    identifiers = []
    for n in range(7):
        clock.now += n % 2  # some at the same time
        identifiers.append(jobs.create({}, {}).id)
    seen, before = [], None
    while page := jobs.page(2, before=before):
        seen += [row.id for row in page]
        before = (page[-1].created, page[-1].id)
    assert sorted(seen) == sorted(identifiers)
    ages = [jobs.get(i).created for i in seen]
    assert ages == sorted(ages, reverse=True)
    jobs.claim(identifiers[3], "a")
    assert [row.id for row in jobs.page(9, state="running")] == [identifiers[3]]


def test_what_is_to_be_sent(jobs, clock):
    first, second = jobs.create({}, {}).id, jobs.create({}, {}).id
    assert {row.id for row in jobs.unsent()} == {first, second}
    jobs.mark_sent(first)
    assert [row.id for row in jobs.unsent()] == [second]
    assert jobs.sent_before(clock.now) == []
    clock.now += 1
    assert [row.id for row in jobs.sent_before(clock.now)] == [first]
    jobs.mark_unsent(first)
    jobs.claim(second, "a")
    assert [row.id for row in jobs.unsent()] == [first]


def test_leases_of_dead_workers_end_together(jobs, queued):
    jobs.claim(queued, "a")
    jobs.expire_leases()
    assert jobs.take_back(3) == [queued]


def test_fleet(engine, jobs, queued, clock):
    fleet = Fleet(engine, clock)
    fleet.ping()
    assert fleet.alive() == 0
    fleet.beat("one", 1)
    fleet.beat("one", 1)
    fleet.beat("two", 2)
    assert fleet.alive() == 2
    fleet.gone("two")
    assert fleet.alive() == 1
    clock.now += 60
    assert fleet.alive() == 0
    fleet.forget(30)
    assert fleet.alive(1e9) == 0
    assert jobs.counts() == {"queued": 1}
    assert fleet.queues()["interactive"][1] == 60


def test_a_failure_that_may_be_chance_is_tried_again(jobs):
    reason = {"kind": "system", "code": "compute-crashed", "message": "killed"}
    identifier = jobs.create({}, {}).id
    jobs.claim(identifier, "a")
    jobs.mark_sent(identifier)
    assert not jobs.try_again(identifier, "another", reason)
    assert jobs.try_again(identifier, "a", reason)
    row = jobs.get(identifier)
    assert (row.state, row.attempt, row.owner, row.sent, row.error) == ("queued", 1, None, None, None)
    last = jobs.events_after(identifier, 0)[-1].data
    assert last == {"state": "queued", "attempt": 1, "reason": reason}
    assert [job.id for job in jobs.unsent()] == [identifier]
    jobs.claim(identifier, "b")
    jobs.cancel(identifier)
    assert jobs.try_again(identifier, "b", reason)
    assert jobs.get(identifier).state == "cancelled"  # nobody wants it any more
