"""The outbox: told of exactly what happened, again until it arrives, and no longer than makes sense."""

import json
import time
from datetime import UTC, datetime

import anyio
import pytest
import sqlalchemy as sa
from standardwebhooks.webhooks import Webhook as Verifier

from worker.records.jobs import Jobs
from worker.records.rows import NotFoundError, StateError
from worker.records.studies import NewCase, Studies
from worker.records.webhooks import CLAIM_SECONDS, KEEP_SECONDS, RETRY_SECONDS, Attempt, Webhooks
from worker.upkeep import outbound
from worker.upkeep.courier import Courier, signed_headers

ALL = ["simulation.succeeded", "simulation.failed", "simulation.cancelled"]


@pytest.fixture
def hooks(engine, clock):
    return Webhooks(engine, clock)


def attempt(message, error="", status=200):
    return Attempt(message.attempts + 1, message.next_attempt, 0.1, status, error, "")


def fail_case(jobs):
    identifier = jobs.create({}, {}, "a case").id
    jobs.claim(identifier, "me")
    jobs.fail(identifier, "me", {"kind": "user", "code": "x", "message": "y"})
    return identifier


def test_every_end_is_announced_once(hooks, jobs, clock):
    hook, _ = hooks.create("https://example.org/", ALL)
    failed = fail_case(jobs)
    clock.now += 1
    done = jobs.create({}, {}).id
    jobs.claim(done, "me")
    jobs.succeed(done, "me", {"results": {"volume_ml": 1.0}})
    jobs.succeed(done, "me", {})  # late and double: nothing changes, nothing is told
    clock.now += 1
    cancelled = jobs.create({}, {}).id
    jobs.cancel(cancelled)
    messages = [json.loads(m.body) for m in reversed(hooks.messages(hook.id, 10))]
    assert [(t["type"], t["data"]["id"]) for t in messages] == [
        ("simulation.failed", failed),
        ("simulation.succeeded", done),
        ("simulation.cancelled", cancelled),
    ]
    assert messages[0]["data"]["error"]["code"] == "x"
    assert messages[0]["data"]["name"] == "a case"
    assert messages[1]["data"]["results"] == {"volume_ml": 1.0}
    assert datetime.fromisoformat(messages[0]["timestamp"]) == datetime.fromtimestamp(1_000_000, UTC)


def test_only_who_wants_to_know_and_only_from_then_on(hooks, jobs):
    fail_case(jobs)
    wants, _ = hooks.create("https://example.org/a", ["simulation.failed"])
    other, _ = hooks.create("https://example.org/b", ["simulation.succeeded"])
    fail_case(jobs)
    assert len(hooks.messages(wants.id, 10)) == 1
    assert hooks.messages(other.id, 10) == []


def test_no_message_without_its_change(hooks, jobs, engine, monkeypatch):
    """The change and its message are one transaction: neither stays without the other."""
    hook, _ = hooks.create("https://example.org/", ALL)
    identifier = jobs.create({}, {}).id

    def broken(self, connection, identifier):
        original(self, connection, identifier)
        raise RuntimeError("after the message was recorded")

    original = Jobs._ended
    monkeypatch.setattr(Jobs, "_ended", broken)
    with pytest.raises(RuntimeError):
        jobs.cancel(identifier)
    assert jobs.get(identifier).state == "queued"
    assert hooks.messages(hook.id, 10) == []


def test_a_message_is_claimed_by_one_courier(hooks, jobs, clock):
    hook, secret = hooks.create("https://example.org/", ALL)
    fail_case(jobs)
    (message,) = hooks.due()
    assert hooks.claim(message) == ("https://example.org/", secret)
    assert hooks.claim(message) is None
    assert hooks.due() == []
    clock.now += CLAIM_SECONDS  # the courier was killed
    (again,) = hooks.due()
    assert again.attempts == 1
    assert hooks.claim(again) is not None
    hooks.told(message, attempt(message, "late", None))  # the first one was only slow
    assert hooks.message(hook.id, message.id)[1] == []


def test_tried_again_for_a_day_then_disabled(hooks, jobs, clock):
    hook, _ = hooks.create("https://example.org/", ALL)
    fail_case(jobs)
    start = clock.now
    tries = 0
    while pending := hooks.due():
        (message,) = pending
        assert hooks.claim(message)
        hooks.told(message, attempt(message, "it answered 500", 500))
        tries += 1
        row, log = hooks.message(hook.id, message.id)
        assert len(log) == tries
        if row.next_attempt is not None:
            assert hooks.get(hook.id).failing_since == start
            clock.now = row.next_attempt
    assert tries == len(RETRY_SECONDS) + 1
    assert 20 * 3600 < clock.now - start < 28 * 3600
    assert row.state == "failed"
    assert "it answered 500" in hooks.get(hook.id).disabled_reason
    fail_case(jobs)  # nothing is recorded for it any more
    assert len(hooks.messages(hook.id, 10)) == 1
    hooks.enable(hook.id)
    fail_case(jobs)
    assert len(hooks.messages(hook.id, 10)) == 2


def test_one_message_that_is_never_taken_does_not_disable(hooks, jobs, clock):
    hook, _ = hooks.create("https://example.org/", ALL)
    fail_case(jobs)
    (bad,) = hooks.due()
    for _ in range(len(RETRY_SECONDS) + 1):
        assert hooks.claim(bad)
        hooks.told(bad, attempt(bad, "it answered 422", 422))
        bad, _ = hooks.message(hook.id, bad.id)
        clock.now = bad.next_attempt or clock.now
        if bad.attempts == 3:
            fail_case(jobs)
            good = next(m for m in hooks.due() if m.id != bad.id)
            assert hooks.claim(good)
            hooks.told(good, attempt(good))
    assert bad.state == "failed"
    assert hooks.get(hook.id).disabled is None


def test_gone_means_gone(hooks, jobs):
    hook, _ = hooks.create("https://example.org/", ALL)
    fail_case(jobs)
    fail_case(jobs)
    message, _ = hooks.due()
    hooks.claim(message)
    hooks.told(message, attempt(message, "it answered 410", 410))
    assert "410" in hooks.get(hook.id).disabled_reason
    assert hooks.due() == []


def test_replay(hooks, jobs, clock):
    hook, _ = hooks.create("https://example.org/", ALL)
    fail_case(jobs)
    (message,) = hooks.due()
    with pytest.raises(StateError):
        hooks.replay(hook.id, message.id)
    hooks.claim(message)
    hooks.told(message, attempt(message))
    assert hooks.due() == []
    assert hooks.replay(hook.id, message.id).body == message.body
    (again,) = hooks.due()
    assert again.id == message.id
    with pytest.raises(NotFoundError):
        hooks.replay("0" * 32, message.id)


def test_a_deleted_webhook_is_told_nothing_and_an_old_log_is_forgotten(hooks, jobs, clock):
    hook, _ = hooks.create("https://example.org/", ALL)
    fail_case(jobs)
    (message,) = hooks.due()
    hooks.claim(message)
    hooks.told(message, attempt(message))
    hooks.prune()
    assert len(hooks.messages(hook.id, 10)) == 1
    clock.now += KEEP_SECONDS + 1
    hooks.prune()
    assert hooks.messages(hook.id, 10) == []
    fail_case(jobs)
    hooks.delete(hook.id)
    assert hooks.due() == []
    with pytest.raises(NotFoundError):
        hooks.delete(hook.id)


def test_the_signature_is_that_of_standard_webhooks():
    secret = "whsec_" + "MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
    headers = signed_headers(secret, "msg_1", int(time.time()), b'{"type":"x"}')
    assert Verifier(secret).verify(b'{"type":"x"}', headers) == {"type": "x"}
    with pytest.raises(Exception, match="signature"):
        Verifier(secret).verify(b'{"type":"y"}', headers)


def test_the_courier_sends_each_receiver_what_is_due(hooks, jobs, make_settings, monkeypatch):
    good, secret = hooks.create("https://good.example/", ALL)
    hooks.create("https://bad.example/", ALL)
    for _ in range(3):
        fail_case(jobs)
    sent = []

    async def post(url, body, headers, private):
        sent.append((url, body, headers))
        failed = "bad" in url
        return outbound.Answer(500 if failed else 204, "it answered 500" if failed else "", "", 0.1)

    monkeypatch.setattr(outbound, "post", post)
    courier = Courier(make_settings(), hooks)
    anyio.run(courier.send_due)
    assert [u for u, _, _ in sent].count("https://good.example/") == 3
    assert [u for u, _, _ in sent].count("https://bad.example/") == 1  # the rest waits with it
    for url, body, headers in sent:
        if "good" in url:
            Verifier(secret).verify(body, headers)
    assert {m.state for m in hooks.messages(good.id, 10)} == {"delivered"}
    anyio.run(courier.send_due)
    assert len(sent) == 4


def test_indexes_serve_the_courier(engine, hooks):
    """With many messages done, looking for what is due reads only that."""
    if engine.dialect.name == "sqlite":
        with engine.connect() as connection:
            query = "EXPLAIN QUERY PLAN SELECT id FROM webhook_messages WHERE state='pending' AND next_attempt <= 1"
            plan = str(connection.execute(sa.text(query)).all())
        assert "webhook_messages_due" in plan


def study_of(jobs, cases):
    studies = Studies(jobs)
    new = [NewCase(f"case {n}", {}, {}, {}) for n in range(cases)]
    return studies, studies.create("a study", {}, [], {}, new).id


def test_the_end_of_a_study_is_told_once(hooks, jobs, clock):
    hook, _ = hooks.create("https://example.org/", ["study.finished"])
    studies, identifier = study_of(jobs, 2)
    first, last = (case.id for case in studies.cases(identifier))
    jobs.claim(first, "me")
    jobs.fail(first, "me", {"kind": "user", "code": "x", "message": "y"})
    assert studies.announce_finished() == []
    jobs.claim(last, "me")
    jobs.succeed(last, "me", {})
    assert studies.announce_finished() == [identifier]
    assert studies.announce_finished() == []
    (message,) = hooks.messages(hook.id, 10)
    data = json.loads(message.body)["data"]
    assert (data["id"], data["state"], data["counts"]) == (identifier, "partial", {"failed": 1, "succeeded": 1})


@pytest.mark.parametrize("how", ["case", "study"])
def test_a_study_that_goes_on_ends_once_more(hooks, jobs, clock, how):
    hook, _ = hooks.create("https://example.org/", ["study.finished"])
    studies, identifier = study_of(jobs, 1)
    (case,) = studies.cases(identifier)
    jobs.claim(case.id, "me")
    jobs.fail(case.id, "me", {"kind": "user", "code": "x", "message": "y"})
    studies.announce_finished()
    if how == "case":
        jobs.retry(case.id)
    else:
        studies.retry(identifier)
    assert studies.announce_finished() == []
    studies.cancel(identifier)
    assert studies.announce_finished() == [identifier]
    assert len(hooks.messages(hook.id, 10)) == 2
