"""The sweep: nothing that was asked for is forgotten, whatever happens to messages and workers."""

import time

import pytest

from tests.support.brokers import MemoryBroker
from tests.support.waiting import wait_for
from worker.records.fleet import Fleet
from worker.upkeep.reaper import Reaper


@pytest.fixture
def broker():
    return MemoryBroker()


@pytest.fixture
def reaper(make_settings, jobs, engine, broker, clock):
    return Reaper(make_settings(resend_seconds=30), jobs, Fleet(engine, clock), broker)


def test_sends_what_was_never_sent_once(reaper, jobs, broker):
    identifier = jobs.create({}, {}, queue="batch").id
    reaper.sweep()
    reaper.sweep()
    assert broker.messages == [(identifier, "batch")]


def test_a_broker_that_is_down_loses_nothing(reaper, jobs, broker):
    identifier = jobs.create({}, {}).id
    broker.down = True
    with pytest.raises(ConnectionError):
        reaper.sweep()
    broker.down = False
    reaper.sweep()
    assert broker.messages == [(identifier, "interactive")]


def test_a_lost_message_is_sent_again(reaper, jobs, broker, clock):
    identifier = jobs.create({}, {}).id
    reaper.sweep()
    broker.messages.clear()  # the broker lost its data
    clock.now += 29
    reaper.sweep()
    assert broker.messages == []
    clock.now += 2
    reaper.sweep()
    assert broker.messages == [(identifier, "interactive")]


def test_a_long_queue_is_not_doubled(reaper, jobs, broker, clock):
    for _ in range(5):
        jobs.create({}, {})
    reaper.sweep()
    clock.now += 3600
    reaper.sweep()
    assert len(broker.messages) == 5


def test_a_lost_message_is_sent_again_while_another_queue_is_long(reaper, jobs, broker, clock):
    for _ in range(120):
        jobs.create({}, {}, queue="batch")
    lost = jobs.create({}, {}).id
    reaper.sweep()
    reaper.sweep()
    broker.messages.remove((lost, "interactive"))
    clock.now += 31
    reaper.sweep()
    assert broker.messages.count((lost, "interactive")) == 1
    assert len(broker.messages) == 121


def test_a_lost_worker_is_noticed(reaper, jobs, broker, clock):
    identifier = jobs.create({}, {}).id
    reaper.sweep()
    broker.messages.clear()
    jobs.claim(identifier, "a")
    clock.now += 31
    reaper.sweep()
    assert jobs.get(identifier).state == "queued"
    assert broker.messages == [(identifier, "interactive")]


def test_the_thread_survives_an_error(make_settings, jobs, engine, broker, clock):
    broker.down = True
    reaper = Reaper(make_settings(sweep_seconds=0.01), jobs, Fleet(engine, clock), broker)
    identifier = jobs.create({}, {}).id
    reaper.start()
    try:
        time.sleep(0.1)
        broker.down = False
        wait_for(lambda: broker.messages, "the message")
    finally:
        reaper.stop()
    assert broker.messages == [(identifier, "interactive")]
