"""Idempotency keys in the database, on SQLite and PostgreSQL."""

import threading

import pytest

from worker.records.idempotency import ABANDONED_SECONDS, Idempotency, KeyBusyError, KeyReusedError

ANSWER = {"status": 202, "headers": {}, "body": "{}"}


@pytest.fixture
def keys(engine, clock):
    return Idempotency(engine, 3600.0, clock)


def test_an_answer_is_kept(keys):
    claim = keys.claim("me", "k", "digest")
    assert (claim.again, claim.answer) == (False, None)
    with pytest.raises(KeyBusyError):
        keys.claim("me", "k", "digest")
    keys.answer(claim, ANSWER)
    again = keys.claim("me", "k", "digest")
    assert (again.answer, again.identifier) == (ANSWER, claim.identifier)


def test_another_request(keys):
    claim = keys.claim("me", "k", "digest")
    for _ in range(2):
        with pytest.raises(KeyReusedError):
            keys.claim("me", "k", "another")
        keys.answer(claim, ANSWER)


def test_keys_belong_to_who_asks(keys):
    one, other = keys.claim("me", "k", "digest"), keys.claim("you", "k", "another")
    assert one.identifier != other.identifier
    keys.release(one)
    with pytest.raises(KeyBusyError):
        keys.claim("you", "k", "another")


def test_a_dead_request_holds_no_key_for_ever(keys, clock):
    dead = keys.claim("me", "k", "digest")
    clock.now += ABANDONED_SECONDS - 1
    with pytest.raises(KeyBusyError):
        keys.claim("me", "k", "digest")
    clock.now += 2
    follower = keys.claim("me", "k", "digest")
    assert (follower.again, follower.identifier) == (True, dead.identifier)
    with pytest.raises(KeyBusyError):
        keys.claim("me", "k", "digest")
    keys.release(dead)  # it was only slow: the key is not its any more
    keys.answer(follower, ANSWER)
    assert keys.claim("me", "k", "digest").answer == ANSWER


def test_one_that_gave_up_is_followed_at_once(keys):
    failed = keys.claim("me", "k", "digest")
    keys.abandon(failed)
    assert keys.claim("me", "k", "digest").identifier == failed.identifier


def test_a_released_key_is_new(keys):
    first = keys.claim("me", "k", "digest")
    keys.release(first)
    second = keys.claim("me", "k", "another")
    assert (second.again, second.identifier != first.identifier) == (False, True)


def test_keys_expire(keys, clock):
    keys.answer(keys.claim("me", "k", "digest"), ANSWER)
    keys.claim("me", "other", "digest")
    clock.now += 3601
    assert keys.claim("me", "k", "another").again is False
    keys.forget()
    with pytest.raises(KeyBusyError):
        keys.claim("me", "k", "another")
    assert keys.claim("me", "other", "new").again is False


def test_one_of_many_begins(keys):
    barrier = threading.Barrier(8)
    outcomes = []

    def compete():
        barrier.wait()
        try:
            outcomes.append(keys.claim("me", "k", "digest").again)
        except KeyBusyError:
            outcomes.append("busy")

    threads = [threading.Thread(target=compete) for _ in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert sorted(map(str, outcomes)) == ["False", *["busy"] * 7]
