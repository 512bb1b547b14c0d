"""What is replaced inside pynetdicom."""

import sys
import threading
import time
from contextlib import closing
from types import SimpleNamespace

import pytest

from tests.support import peers
from worker.delivery.association import Kind, connect
from worker.delivery.overrides import Checkpoint


@pytest.fixture
def hasty():
    """Threads take turns as often as they can."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def passed_while_paused(checkpoint, association, pauses=3000):
    """How often the thread of an association went on while it said that it was paused; both loops are pynetdicom's."""
    association.rounds, association.ended = 0, False

    def reactor():
        while not association.ended:
            association._is_paused = True
            checkpoint.wait()
            association._is_paused = False
            association.rounds += 1

    thread = threading.Thread(target=reactor)
    thread.start()
    passed = 0
    for _ in range(pauses):
        checkpoint.clear()
        while not association._is_paused:
            pass
        before = association.rounds
        for _ in range(20):
            passed += association.rounds != before
            if association.rounds != before:
                break
        checkpoint.set()
    association.ended = True
    checkpoint.set()
    thread.join()
    return passed


def test_a_paused_association_takes_no_answer(hasty):
    association = SimpleNamespace(_is_paused=False)
    assert passed_while_paused(Checkpoint(association), association) == 0


def test_a_report_that_ends_does_not_hide_that_an_association_is_paused():
    """pynetdicom serves an N-EVENT-REPORT on a thread of its own, which says in the end that nothing is paused."""
    association = SimpleNamespace(_is_paused=False)
    checkpoint = Checkpoint(association)
    checkpoint.clear()
    thread = threading.Thread(target=checkpoint.wait)
    thread.start()
    for _ in range(3):
        association._is_paused = False
        checkpoint.clear()
        limit = time.monotonic() + 5
        while not association._is_paused:
            assert time.monotonic() < limit
    checkpoint.set()
    thread.join(5)
    assert not thread.is_alive()


def test_the_event_of_pynetdicom_lets_it_pass(hasty):
    """Why it is replaced: should this fail, a new version needs it no more."""
    event = threading.Event()
    event.set()
    assert passed_while_paused(event, SimpleNamespace(_is_paused=False), 20000) > 0


def test_associations_have_it(room):
    with closing(peers.Scp()) as peer:
        opened = connect(room.destination(peer.port).definition, [Kind(peers.MG, "1.2.840.10008.1.2.1")])
        assert isinstance(opened._association._reactor_checkpoint, Checkpoint)
        opened.close()
