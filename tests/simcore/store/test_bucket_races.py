"""Machines with folders of their own: what the conditional writes of the bucket decide, and no lock of one machine."""

import http.client
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from urllib.parse import urlsplit

import pytest

from simcore.core.errors import StoreError
from simcore.store import bucket_lock
from simcore.store.bucket import Bucket
from simcore.store.bucket_backend import BucketBackend
from simcore.store.store import Store
from tests.support.waiting import wait_for

MACHINES, ROUNDS = 4, 4


@pytest.fixture
def location(make_location):
    return make_location()


@pytest.fixture
def there(location):
    return Bucket(location)


@pytest.fixture
def statuses(there):
    """Of the answers that ``there`` has had."""
    answers = []

    def keep(http_response, **_):
        answers.append(http_response.status_code)

    there._client.meta.events.register("after-call.s3", keep)
    return answers


def connect(location, condition, value, length):
    """The begin of a request that writes an object."""
    address = urlsplit(location.endpoint)
    connection = http.client.HTTPConnection(address.hostname, address.port)
    connection.putrequest("PUT", f"/{location.bucket}/{location.prefix}k")
    scope = "test-key/20260101/us-east-1/s3/aws4_request"
    connection.putheader("Authorization", f"AWS4-HMAC-SHA256 Credential={scope}, SignedHeaders=host, Signature=0")
    connection.putheader(condition, value)
    connection.putheader("Content-Length", str(length))
    return connection


def is_under_way(location):
    """Whether another request writes the object: one with a wrong tag is answered 409 then, and otherwise 412."""
    with closing(connect(location, "If-Match", '"0"', 0)) as connection:
        connection.endheaders()
        return connection.getresponse().status == 409


@pytest.fixture
def half_written(location):
    """Begins to write an object where there is none, and ends it when it is asked to: the status of the answer."""
    with closing(connect(location, "If-None-Match", "*", 4)) as connection:

        def begin():
            connection.endheaders(b"ha")
            wait_for(lambda: is_under_way(location), "the begin")

            def end():
                connection.send(b"lf")
                return connection.getresponse().status

            return end

        yield begin


def test_one_machine_at_a_time_holds_a_lock(location, there, tmp_path, monkeypatch):
    """What each reads and writes while it holds the lock is lost where two hold it."""
    monkeypatch.setattr(bucket_lock, "POLL_SECONDS", 0.05)
    machines = [
        Store(tmp_path / str(number), 0, partial(BucketBackend, location=location)) for number in range(MACHINES)
    ]
    there.put("count", b"0")
    start = threading.Barrier(MACHINES)

    def add(machine):
        start.wait()
        for _ in range(ROUNDS):
            with machine.lock("k"):
                content, _ = there.get("count")
                there.put("count", b"%d" % (int(content) + 1))

    with ThreadPoolExecutor(MACHINES) as pool:
        list(pool.map(add, machines))
    assert there.get("count")[0] == b"%d" % (MACHINES * ROUNDS)
    assert there.head("locks/k") is None


def test_one_of_many_first_writes_succeeds(location, there):
    start = threading.Barrier(MACHINES)

    def write(number):
        start.wait()
        return Bucket(location).put("k", b"%d" % number, fresh=True) is not None

    with ThreadPoolExecutor(MACHINES) as pool:
        outcomes = list(pool.map(write, range(MACHINES)))
    assert outcomes.count(True) == 1
    assert there.get("k")[0] == b"%d" % outcomes.index(True)


@pytest.mark.parametrize("use", ["put", "delete"])
def test_a_write_that_comes_to_nothing_takes_no_lock_from_its_holder(there, statuses, half_written, use):
    """S3 answers 409 while another write is under way: that says nothing of the tag. The holder asks again."""
    tag = there.put("k", b"mine")
    end = half_written()
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(there.delete, "k", tag) if use == "delete" else pool.submit(there.put, "k", b"new", tag)
        wait_for(lambda: 409 in statuses or asked.done(), "the conflict")
        assert end() == 412
        assert asked.result(60)
    assert 409 in statuses
    assert there.get("k") is None if use == "delete" else there.get("k")[0] == b"new"


def test_a_conflict_without_end_is_an_error(there, half_written, monkeypatch):
    monkeypatch.setattr("simcore.store.bucket.CONFLICT_SECONDS", 0.2)
    tag = there.put("k", b"mine")
    end = half_written()
    with pytest.raises(StoreError, match="ConditionalRequestConflict") as caught:
        there.put("k", b"new", tag)
    assert caught.value.code == "store-unavailable"
    assert end() == 412
