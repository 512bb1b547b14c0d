"""Studies in the database: all cases or none, changes of all at once, on SQLite and PostgreSQL."""

import threading

import pytest
import sqlalchemy as sa

from worker.records.database import simulations
from worker.records.rows import NotFoundError
from worker.records.studies import NewCase, Studies
from worker.records.webhooks import Webhooks

ERROR = {"kind": "system", "code": "test", "message": "for the test"}


def case(number):
    return NewCase(f"case {number}", {"seed": number}, {"seed": number}, {"seconds": 1.0})


@pytest.fixture
def studies(jobs):
    return Studies(jobs)


@pytest.fixture
def make(studies):
    def create(size=3, **more):
        cases = [case(number) for number in range(1, size + 1)]
        return studies.create("mine", {"axes": []}, ["seed"], {}, cases, **more)

    return create


def states(jobs, identifier):
    return [e.data["state"] for e in jobs.events_after(identifier, 0)]


def test_all_cases_in_their_order(studies, jobs, make):
    study = make(1000)
    cases = studies.cases(study.id)
    assert [c.study_number for c in cases] == list(range(1, 1001))
    assert (cases[6].coordinates, cases[6].queue, cases[6].study_id) == ({"seed": 7}, "batch", study.id)
    assert jobs.specification(cases[6].id) == {"seed": 7}
    assert states(jobs, cases[6].id) == ["queued"]
    assert [c.id for c in jobs.unsent()] == [c.id for c in cases[:100]]
    assert [c.study_number for c in jobs.page(2, study_id=study.id)] == [1000, 999]
    assert (study.counts, study.state, study.is_final) == ({"queued": 1000}, "queued", False)


def test_all_or_none(studies, jobs, make):
    make(identifier="1" * 32)
    with pytest.raises(sa.exc.IntegrityError):
        make(identifier="1" * 32)
    cases = [case(1), NewCase("bad", {}, {}, object())]
    with pytest.raises(sa.exc.StatementError):
        studies.create("bad", {}, [], {}, cases)
    assert [study.id for study in studies.page(10)] == ["1" * 32]
    assert len(jobs.page(10)) == 3


def test_changes_of_all_cases(studies, jobs, make):
    study = make(4)
    other = make(1)
    first, second, third, fourth = (c.id for c in studies.cases(study.id))
    jobs.claim(first, "a")
    jobs.fail(first, "a", ERROR)
    jobs.claim(second, "b")
    row, number = studies.cancel(study.id)
    assert (number, row.state) == (3, "cancelling")
    assert row.counts == {"failed": 1, "cancelling": 1, "cancelled": 2}
    assert states(jobs, third) == ["queued", "cancelled"]
    assert [e.sequence for e in jobs.events_after(third, 0)] == [1, 2] == [1, jobs.get(third).revision]
    assert not studies.delete(study.id)
    jobs.cancelled(second, "b")
    assert studies.get(study.id).state == "failed"
    assert studies.retry(study.id)[1] == 1
    assert (jobs.get(first).state, jobs.get(first).attempt, jobs.get(fourth).state) == ("queued", 0, "cancelled")
    assert studies.retry(study.id, ["failed", "cancelled"])[1] == 3
    assert studies.get(other.id).counts == {"queued": 1}


def test_delete_takes_all_that_belongs_to_it(studies, jobs, make, engine):
    study, other = make(), make()
    studies.cancel(study.id)
    assert studies.delete(study.id)
    with pytest.raises(NotFoundError):
        studies.get(study.id)
    with engine.connect() as connection:
        left = connection.scalars(sa.select(simulations.c.study_id)).all()
    assert left == [other.id] * 3


@pytest.mark.parametrize("action", ["get", "cancel", "retry", "delete", "document"])
def test_no_such_study(studies, action):
    with pytest.raises(NotFoundError) as error:
        getattr(studies, action)("0" * 32)
    assert error.value.what == "study"


def test_pages(studies, make, clock):
    identifiers = []
    for _ in range(3):
        clock.now += 1
        identifiers.append(make(1).id)
    first = studies.page(2)
    assert [s.id for s in first] == [identifiers[2], identifiers[1]]
    assert [s.id for s in studies.page(2, (first[1].created, first[1].id))] == [identifiers[0]]


def test_times_are_those_of_the_first_and_the_last_case(studies, jobs, make, clock):
    study = make(2)
    one, two = studies.cases(study.id)
    for number, identifier in enumerate((one.id, two.id)):
        clock.now += 10
        jobs.claim(identifier, "a")
        clock.now += 10
        jobs.succeed(identifier, "a", {"results": {}, "files": {}})
        row = studies.get(study.id)
        assert row.started == study.created + 10
        assert row.finished == (None if number == 0 else study.created + 40)
    assert row.state == "succeeded"


def test_webhooks_are_told_of_every_case_that_is_cancelled(studies, make, engine, clock):
    hooks = Webhooks(engine, clock)
    hook, _ = hooks.create("https://example.org/", ["simulation.cancelled"])
    studies.cancel(make(3).id)
    assert len(hooks.messages(hook.id, 10)) == 3


def test_many_change_one_study_at_once(studies, jobs, make):
    """Nobody waits for another one for ever, and every case ends in one state with all its events."""
    study = make(40)
    ids = [c.id for c in studies.cases(study.id)]
    failures = []
    barrier = threading.Barrier(4)

    def work(action):
        barrier.wait()
        try:
            action()
        except Exception as error:
            failures.append(error)

    def compute():
        for identifier in reversed(ids):
            if jobs.claim(identifier, "a"):
                jobs.fail(identifier, "a", ERROR) or jobs.cancelled(identifier, "a")

    def flip(action):
        return lambda: [action(study.id) for _ in range(5)]

    actions = [compute, flip(studies.cancel), flip(studies.retry), flip(studies.cancel)]
    threads = [threading.Thread(target=work, args=(action,)) for action in actions]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert failures == []
    result, _ = studies.cancel(study.id)
    assert result.is_final
    for identifier in ids:
        row = jobs.get(identifier)
        assert states(jobs, identifier)[-1] == row.state
        assert jobs.events_after(identifier, 0)[-1].sequence == row.revision


def test_how_long_files_are_kept_is_known_though_the_last_cases_did_not_see_one_another(
    studies, jobs, engine, clock, monkeypatch
):
    study = studies.create("mine", {}, ["seed"], {}, [case(1), case(2)], retention=60.0)
    with monkeypatch.context() as patch:
        patch.setattr("worker.records.ends.retention.set_expiry", lambda *_: None)
        for row in studies.cases(study.id):
            jobs.claim(row.id, "a")
            jobs.succeed(row.id, "a", {"results": {}, "files": {}})
    assert [row.expires_at for row in studies.cases(study.id)] == [None, None]
    studies.announce_finished()
    assert [row.expires_at for row in studies.cases(study.id)] == [clock.now + 60] * 2
