"""The repository of deliveries, on SQLite and PostgreSQL: one at a time to a destination, what is stored is stored."""

import contextlib
import threading

import pytest

from tomosim_contract.destination import Destination
from worker.delivery.outcomes import no_answer, of_status
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Item, Request
from worker.records.destinations import Destinations, InUseError, NameTakenError
from worker.records.rows import NotFoundError, StateError

AGAIN = no_answer("the link broke", "PEER", "US")
ERROR = {"kind": "system", "code": "test", "message": "for the test"}


@pytest.fixture
def deliveries(engine, clock):
    return Deliveries(engine, lease_seconds=30, clock=clock)


@pytest.fixture
def make(engine, clock, deliveries):
    """Queues a delivery of so many instances to a destination that is made where it is not there."""
    destinations = Destinations(engine, clock)

    def queue(name="pacs", count=3):
        with contextlib.suppress(NameTakenError):
            destinations.create(Destination(name=name, host="127.0.0.1", port=104, called_aet="PACS"))
        items = [Item("5" * 32, f"{n}.dcm", f"{n:064x}", 100 + n) for n in range(count)]
        return deliveries.create(Request(name, items, simulation_id="5" * 32)).id

    return queue


def test_one_of_many_workers_claims_for_a_destination(deliveries, make):
    """Each of its own delivery: the limits of the destination hold for all together."""
    mine = [make() for _ in range(6)]
    won = []
    barrier = threading.Barrier(6)

    def compete(identifier):
        barrier.wait()
        if deliveries.claim(identifier, f"w{identifier}"):
            won.append(identifier)

    threads = [threading.Thread(target=compete, args=(i,)) for i in mine]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert len(won) == 1
    assert deliveries.unsent() == []
    elsewhere = make("other")
    assert [row.id for row in deliveries.unsent()] == [elsewhere]
    assert deliveries.claim(elsewhere, "b")
    deliveries.succeed(won[0], f"w{won[0]}")
    assert {row.id for row in deliveries.unsent()} == set(mine) - set(won)


def test_what_is_stored_stays_stored(deliveries, make, clock):
    identifier = make()
    deliveries.claim(identifier, "a")
    assert deliveries.record(identifier, 0, of_status(0), 3) == "stored"
    assert deliveries.record(identifier, 0, AGAIN, 3) == "stored"
    clock.now += 31
    assert deliveries.take_back(3) == [identifier]
    # The answer of a peer to a worker that lost its lease counts; nothing else that this worker says does.
    assert deliveries.record(identifier, 1, of_status(0xB000), 3) == "stored"
    assert not deliveries.succeed(identifier, "a")
    assert not deliveries.postpone(identifier, "a", ERROR, 3, 5.0)
    row = deliveries.get(identifier)
    assert (row.state, row.instances_stored, row.bytes_stored) == ("queued", 2, 201)
    assert [i.state for i in deliveries.instances(identifier)] == ["stored", "stored", "waiting"]


def test_an_instance_fails_after_its_attempts(deliveries, make):
    identifier = make()
    deliveries.claim(identifier, "a")
    assert [deliveries.record(identifier, 0, AGAIN, 3) for _ in range(3)] == ["waiting", "waiting", "failed"]
    assert deliveries.get(identifier).instances_failed == 1


def test_pauses_grow_and_a_success_begins_anew(deliveries, make, clock):
    identifier = make()
    waits = []
    for _ in range(3):
        deliveries.claim(identifier, "a")
        deliveries.postpone(identifier, "a", ERROR, 8, 250.0)
        waits.append(deliveries.get(identifier).not_before - clock.now)
        assert deliveries.claim(identifier, "a") is None
        clock.now += waits[-1]
    assert waits == [250.0, 500.0, 600.0]
    deliveries.claim(identifier, "a")
    deliveries.record(identifier, 0, of_status(0), 8)
    deliveries.postpone(identifier, "a", ERROR, 8, 250.0)
    assert deliveries.get(identifier).not_before - clock.now == 250.0
    clock.now += 250
    deliveries.claim(identifier, "a")
    deliveries.postpone(identifier, "a", ERROR, 2, 250.0)
    assert deliveries.get(identifier).state == "failed"


def test_retry_keeps_what_is_stored(deliveries, make):
    identifier = make()
    with pytest.raises(StateError):
        deliveries.retry(identifier)
    deliveries.claim(identifier, "a")
    deliveries.record(identifier, 0, of_status(0), 3)
    deliveries.record(identifier, 1, of_status(0xC000), 3)
    deliveries.fail(identifier, "a", ERROR)
    row = deliveries.retry(identifier)
    assert (row.state, row.attempt, row.error, row.instances_stored, row.instances_failed) == ("queued", 0, None, 1, 0)
    assert [i.state for i in deliveries.instances(identifier)] == ["stored", "waiting", "waiting"]


def test_cancel_between_two_attempts(deliveries, make):
    identifier = make()
    deliveries.claim(identifier, "a")
    deliveries.cancel(identifier)
    assert deliveries.postpone(identifier, "a", ERROR, 8, 5.0)
    assert deliveries.get(identifier).state == "cancelled"


def test_a_destination_in_use_stays(deliveries, make, engine):
    identifier = make()
    destinations = Destinations(engine)
    (row,) = destinations.all()
    with pytest.raises(InUseError):
        destinations.delete(row.id)
    deliveries.cancel(identifier)
    destinations.delete(row.id)
    with pytest.raises(NotFoundError):
        destinations.get(row.id)
    with pytest.raises(NotFoundError):
        deliveries.create(Request("pacs", []))


def test_two_changes_of_a_destination(engine, make):
    make()
    destinations = Destinations(engine)
    (row,) = destinations.all()
    assert destinations.replace(row.id, row.definition.with_(port=105), 1).revision == 2
    assert destinations.replace(row.id, row.definition.with_(port=106), 1) is None
    assert destinations.get(row.id).definition.port == 105
