"""One delivery at a time to a destination: in parallel, cancelled, taken over, over TLS, held to a bandwidth."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import closing

import pytest

from tests.support.peers import Link, Scp
from tests.support.services import need
from tests.support.waiting import wait_for
from worker.delivery import association
from worker.delivery.association import Throttle
from worker.delivery.echo import echo
from worker.serve.processes import environment

LARGE = {"rows": 4096, "columns": 2048}


def running(room, identifier):
    thread = threading.Thread(target=room.sender.run, args=(identifier,))
    thread.start()
    return thread


def test_parallel_associations(room):
    """As many as the destination allows, each instance once."""
    together = threading.Barrier(3)
    with closing(Scp(before=lambda event: together.wait(20))) as peer:
        row = room.deliver(peer.port, room.case(5), limits={"associations": 3})
        uids = [uid for uid, _ in peer.received]
        assert peer.most_open == 3
    assert row.state == "succeeded"
    assert len(uids) == len(set(uids)) == 6


def test_a_second_delivery_to_the_same_destination_waits(room):
    proceed = threading.Event()
    with closing(Scp(before=lambda event: proceed.wait(20))) as peer:
        destination = room.destination(peer.port)
        first = room.queue(destination, [room.file("a.dcm", number=1)])
        second = room.queue(destination, [room.file("b.dcm", number=2)])
        thread = running(room, first)
        wait_for(lambda: peer.received)
        room.sender.run(second)
        assert room.deliveries.get(second).state == "queued"
        assert room.deliveries.unsent() == []
        proceed.set()
        thread.join(20)
        assert [row.id for row in room.deliveries.unsent()] == [second]
        assert room.run(second).state == "succeeded"


def test_cancel_in_transfer(room):
    """At once, although the peer has stopped and every time limit is long."""
    with closing(Scp()) as peer, closing(Link(peer.port)) as link:
        limits = {"stall_seconds": 3600.0, "response_seconds": 3600.0}
        identifier = room.queue(room.destination(link.port, limits=limits), [room.file("a.dcm", **LARGE)])
        thread = running(room, identifier)
        wait_for(lambda: link.passed > 500_000)
        link.stopped.set()
        room.deliveries.cancel(identifier)
        thread.join(20)
        assert not thread.is_alive()
        link.stopped.clear()
    assert room.deliveries.get(identifier).state == "cancelled"
    assert room.deliveries.instances(identifier)[0].attempts == 0


def test_a_worker_that_stops_gives_the_delivery_back(room):
    with closing(Scp()) as peer, closing(Link(peer.port)) as link:
        identifier = room.queue(room.destination(link.port), [room.file("a.dcm", **LARGE)])
        thread = running(room, identifier)
        wait_for(lambda: link.passed > 500_000)
        link.stopped.set()
        room.stopping.set()
        thread.join(20)
        link.stopped.clear()
    row = room.deliveries.get(identifier)
    assert (row.state, row.attempt, row.owner, row.failures) == ("queued", 0, None, 0)


WORKER = """
import sys, threading
from worker.records.database import connect
from worker.records.deliveries import Deliveries
from worker.delivery.sender import Sender
from worker.settings import Settings
from worker.storage import open_store
settings = Settings.load()
deliveries = Deliveries(connect(settings.resolved_database_url), settings.lease_seconds)
Sender("killed", settings, deliveries, open_store(settings), threading.Event()).run(sys.argv[1])
"""


def test_a_worker_that_is_killed(room):
    """Whoever goes on sends only what was not confirmed."""
    proceed = threading.Event()

    def hold(event):
        if len(peer.received) > 3:
            proceed.wait(20)

    with closing(Scp(before=hold)) as peer:
        identifier = room.queue(room.destination(peer.port), room.case(6))
        worker = subprocess.Popen([sys.executable, "-c", WORKER, identifier], env=environment(room.settings))
        try:
            wait_for(lambda: room.states(identifier).count("stored") == 3 and len(peer.received) == 4)
            os.kill(worker.pid, signal.SIGKILL)
        finally:
            worker.kill()
            worker.wait()
        proceed.set()
        assert room.deliveries.get(identifier).state == "running"
        room.deliveries.expire_leases()
        assert room.deliveries.take_back(3) == [identifier]
        row = room.run(identifier)
        uids = [uid for uid, _ in peer.received]
    assert (row.state, row.attempt, row.instances_stored) == ("succeeded", 2, 7)
    assert [uids.count(uid) for uid in uids[:3]] == [1, 1, 1]
    assert len(uids) == 8  # only the one without an answer was sent again


def test_a_worker_that_lost_its_lease_changes_nothing_but_what_is_stored(room):
    proceed = threading.Event()
    with closing(Scp(before=lambda event: proceed.wait(20))) as peer:
        identifier = room.queue(room.destination(peer.port), [room.file("a.dcm")])
        thread = running(room, identifier)
        wait_for(lambda: peer.received)
        room.deliveries.expire_leases()
        room.deliveries.take_back(3)
        proceed.set()
        thread.join(20)
    row = room.deliveries.get(identifier)
    assert row.state == "queued"
    assert row.instances_stored in (0, 1)  # whether the answer was quicker than the end of the association
    assert room.states(identifier) == ["stored" if row.instances_stored else "waiting"]


def test_throttle(monkeypatch):
    """Two megabytes a second, whoever sends."""
    now = [100.0]
    monkeypatch.setattr(association.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(association.time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    throttle = Throttle(2e6)
    for _ in range(5):
        throttle.wait(1_000_000)
    assert now[0] == pytest.approx(102.0)
    now[0] += 50
    throttle.wait(1_000_000)
    assert now[0] == pytest.approx(152.0)
    Throttle(None).wait(10**12)


def test_bandwidth_reaches_the_socket(room, monkeypatch):
    waited = []
    monkeypatch.setattr(Throttle, "wait", lambda self, size: waited.append((self.rate, size)))
    with closing(Scp()) as peer:
        items = [room.file("a.dcm", rows=512, columns=1024)]
        assert room.deliver(peer.port, items, limits={"bandwidth_MBps": 3.0}).state == "succeeded"
    assert {rate for rate, _ in waited} == {3e6}
    assert sum(size for _, size in waited) > items[0].size


@pytest.fixture
def certificates(tmp_path):
    """Keys and certificates for "localhost": of the peer and of ourselves, each its own authority."""
    need("openssl", "openssl")
    folder = tmp_path / "data" / "secrets"
    folder.mkdir(parents=True)
    for name in ("peer", "ours"):
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost",
             "-addext", "subjectAltName=DNS:localhost", "-keyout", f"{name}.key", "-out", f"{name}.pem"],
            cwd=folder, check=True, capture_output=True,
        )  # fmt: skip
    return folder


OURS = {"certificate_file": "ours.pem", "key_file": "ours.key"}


@pytest.mark.needs_dcmtk
def test_tls(room, storescp, certificates):
    """Both sides show a certificate; neither talks to whom it does not know."""
    options = ["+tls", str(certificates / "peer.key"), str(certificates / "peer.pem")]
    peer = storescp(*options, "+cf", str(certificates / "ours.pem"))

    def deliver(name, **tls):
        destination = room.destination(peer.port, name=name, host="localhost", tls=tls, limits={"attempts": 1})
        return room.run(room.queue(destination, room.case(1, seed=len(name))))

    row = deliver("right", ca_file="peer.pem", **OURS)
    assert (row.state, row.error) == ("succeeded", None)
    row = deliver("unknown-peer", **OURS)
    assert (row.state, row.error["code"]) == ("failed", "tls-certificate")
    assert "tls.ca_file" in row.error["message"]
    row = deliver("without-ours", ca_file="peer.pem")
    assert (row.state, row.error["code"]) == ("failed", "association-aborted")
    assert "certificate of ours" in row.error["message"]
    row = deliver("other-name", ca_file="peer.pem", server_name="pacs.example.org", **OURS)
    assert (row.state, row.error["code"]) == ("failed", "tls-certificate")
    assert deliver("unverified", verify=False, **OURS).state == "succeeded"
    row = deliver("no-file", ca_file="missing.pem")
    assert (row.state, row.error["code"]) == ("failed", "tls-file")
    assert "missing.pem" in row.error["message"]


@pytest.mark.needs_dcmtk
def test_tls_with_a_peer_that_has_none(room, storescp, certificates):
    destination = room.destination(storescp("-ta", "1").port, tls={"ca_file": "peer.pem"})
    assert echo(destination.definition, room.settings)["code"] == "tls-failed"
