"""What peers do wrong, and what becomes of the delivery: nothing is lost, nothing is sent twice."""

import signal
import threading
import time
from contextlib import closing

import pytest
from pydicom.uid import JPEGLSLossless, RLELossless

from tests.support import peers
from tests.support.peers import Link, Scp, Silent
from tests.support.waiting import wait_for
from worker.delivery.association import AssociationError, Kind, connect
from worker.delivery.echo import echo
from worker.delivery.overrides import Entity

MEGABYTE = {"rows": 512, "columns": 1024}
LARGE = {"rows": 4096, "columns": 2048}


def counts(row):
    return row.instances_stored, row.instances_failed


def test_closed_port(room, free_port):
    row = room.deliver(free_port, room.case(1))
    assert (row.state, row.error["code"], row.attempt) == ("failed", "connection-refused", 3)
    assert f"127.0.0.1:{free_port}" in row.error["message"]
    assert counts(row) == (0, 0)
    assert room.states(row.id) == ["waiting", "waiting"]


def test_a_peer_that_comes_back(room, free_port):
    """The delivery waits in the queue meanwhile, longer every time."""
    identifier = room.queue(room.destination(free_port, limits={"backoff_seconds": 10.0}), room.case(1))
    waits = []
    for _ in range(2):
        row = room.run(identifier, until_final=False)
        assert (row.state, row.owner, row.sent) == ("queued", None, None)
        waits.append(row.not_before - room.deliveries.clock())
        assert room.deliveries.claim(identifier, "early") is None
        assert room.deliveries.unsent() == []
        room.due(identifier)
    assert 9 < waits[0] <= 10
    assert 19 < waits[1] <= 20
    with closing(Scp()) as peer:
        definition = room.destinations.all()[0]
        room.destinations.replace(definition.id, definition.definition.with_(port=peer.port), 1)
        row = room.run(identifier)
    assert (row.state, row.error, row.failures) == ("succeeded", None, 0)


@pytest.mark.needs_orthanc
def test_wrong_called_title(room, orthanc):
    row = room.deliver(orthanc().port, room.case(1), called_aet="Peer2")
    assert (row.state, row.error["code"], row.attempt) == ("failed", "association-rejected", 1)
    assert "called_aet" in row.error["message"]


class Late(threading.Event):
    """Whoever waits goes on a good while after the event, as on a busy machine."""

    def wait(self, timeout=None):
        happened = super().wait(timeout)
        time.sleep(0.5)
        return happened


@pytest.mark.parametrize("ready", [threading.Event, Late])
def test_a_rejection_quicker_than_the_thread_that_waits_for_the_connection(room, monkeypatch, ready):
    usual = Entity._create_socket

    def create(*arguments):
        association = usual(*arguments)
        association._ready = ready()
        return association

    monkeypatch.setattr(Entity, "_create_socket", create)
    with closing(Scp(strict=True)) as peer:
        row = room.deliver(peer.port, room.case(1), called_aet="PEER2")
    assert (row.state, row.error["code"], row.attempt) == ("failed", "association-rejected", 1)
    assert "called_aet" in row.error["message"]


def test_a_name_that_is_not_known(room):
    row = room.deliver(104, room.case(1), host="no-such-host.invalid", limits={"attempts": 1})
    assert (row.state, row.error["code"]) == ("failed", "host-not-found")


@pytest.mark.parametrize("says", [None, b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_something_that_is_no_dicom_service(room, says):
    with closing(Silent(says)) as peer:
        row = room.deliver(peer.port, room.case(1), limits={"attempts": 1, "negotiate_seconds": 0.5})
    code = "association-timeout" if says is None else "association-aborted"
    assert (row.state, row.error["code"]) == ("failed", code)


@pytest.mark.needs_dcmtk
def test_a_class_that_is_refused(room, storescp, tmp_path):
    """The others arrive; the one that did not is named with its class."""
    configuration = tmp_path / "scp.cfg"
    configuration.write_text(
        "[[TransferSyntaxes]]\n[Uncompressed]\nTransferSyntax1 = LittleEndianExplicit\n"
        "[[PresentationContexts]]\n[Few]\nPresentationContext1 = VerificationSOPClass\\Uncompressed\n"
        "PresentationContext2 = DigitalMammographyXRayImageStorageForProcessing\\Uncompressed\n"
        "[[Profiles]]\n[Default]\nPresentationContexts = Few\n"
    )
    peer = storescp("-xf", str(configuration), "Default")
    row = room.deliver(peer.port, room.case(2))
    assert (row.state, row.error["code"], row.attempt) == ("failed", "class-refused", 1)
    assert counts(row) == (2, 1)
    assert "Breast Tomosynthesis Image Storage" in row.error["message"]
    assert len(peer.stored()) == 2
    answer = echo(room.destinations.all()[0].definition, room.settings)
    assert answer["reachable"]
    assert len(answer["accepted"]) == 1
    assert any("Breast Tomosynthesis" in name for name in answer["refused"])


@pytest.mark.parametrize(
    ("status", "verdict"),
    [(0x0000, "stored"), (0xB000, "stored"), (0xB006, "stored"), (0xB007, "stored"), (0x0111, "stored"),
     (0xA900, "failed"), (0xC000, "failed"), (0xC123, "failed"), (0x0110, "failed"), (0x0124, "failed")],
)  # fmt: skip
def test_statuses(room, status, verdict):
    """Each is final: asked once, and told with advice or a note."""
    with closing(Scp([status])) as peer:
        row = room.deliver(peer.port, room.case(1))
        assert len(peer.received) == 2
    instances = room.deliveries.instances(row.id)
    assert {i.state for i in instances} == {verdict}
    assert {i.status for i in instances} == {status}
    assert row.state == ("succeeded" if verdict == "stored" else "failed")
    if status:
        assert all(f"0x{status:04X}" in i.message for i in instances)
    if verdict == "failed":
        assert f"0x{status:04X}" in row.error["message"]


def test_out_of_resources_and_then_not(room):
    """0xA700 is tried again on a new association; what was stored is not."""
    with closing(Scp([0, 0xA700, 0xA700, 0])) as peer:
        row = room.deliver(peer.port, room.case(3))
        uids = [uid for uid, _ in peer.received]
    assert row.state == "succeeded"
    assert counts(row) == (4, 0)
    assert uids.count(uids[0]) == 1
    assert len(uids) == 6


def test_out_of_resources_for_good(room):
    with closing(Scp([0xA700])) as peer:
        row = room.deliver(peer.port, room.case(3))
    assert (row.state, row.error["code"]) == ("failed", "out-of-resources")
    assert "disk space" in row.error["message"]
    assert row.attempt == 3


@pytest.mark.needs_dcmtk
def test_a_disk_that_is_full(room, storescp):
    """Files of storescp end at a limit: it says 0xA700, or leaves without an answer."""
    import resource

    peer = storescp()
    resource.prlimit(peer.process.pid, resource.RLIMIT_FSIZE, (50_000, 50_000))
    # A signal ends the process at the limit, unless it is ignored: so it is one that died in the transfer.
    row = room.deliver(peer.port, [room.file("large.dcm", **MEGABYTE)], limits={"attempts": 2})
    assert row.state == "failed"
    assert row.error["code"] in ("out-of-resources", "no-answer", "connection-refused")
    assert counts(row)[0] == 0


@pytest.mark.needs_dcmtk
@pytest.mark.parametrize("option", ["--abort-during", "--abort-after"])
def test_aborted_in_transfer(room, storescp, option):
    peer = storescp(option)
    row = room.deliver(peer.port, [room.file("large.dcm", **MEGABYTE)])
    assert (row.state, row.error["code"]) == ("failed", "no-answer")
    assert room.deliveries.instances(row.id)[0].attempts == 3


@pytest.mark.needs_dcmtk
def test_killed_in_transfer_and_started_again(room, storescp):
    peer = storescp()
    items = [room.file(f"large{n}.dcm", number=n, rows=2048, columns=2048) for n in (1, 2, 3)]
    with closing(Link(peer.port, rate=30e6)) as link:
        identifier = room.queue(room.destination(link.port), items)
        attempt = threading.Thread(target=room.sender.run, args=(identifier,))
        attempt.start()
        wait_for(lambda: "stored" in room.states(identifier) and link.passed > 10e6)
        peer.process.kill()
        peer.process.wait()
        attempt.join(30)
        assert not attempt.is_alive()
        row = room.deliveries.get(identifier)
        assert row.state == "queued"
        stored = row.instances_stored
        assert stored in (1, 2)
        again = storescp(port=peer.port)
        room.due(identifier)
        row = room.run(identifier)
    assert row.state == "succeeded"
    assert len(again.stored()) == 3 - stored


def test_a_link_that_breaks(room):
    with closing(Scp()) as peer, closing(Link(peer.port, cut_after=2_500_000)) as link:
        items = [room.file(f"{n}.dcm", number=n, **MEGABYTE) for n in range(1, 6)]
        row = room.deliver(link.port, items)
        uids = [uid for uid, _ in peer.received]
    assert row.state == "succeeded"
    assert sorted(uids) == sorted(set(uids))
    assert len(uids) == 5


@pytest.mark.needs_dcmtk
def test_a_peer_that_stops_reading(room, storescp):
    peer = storescp()
    items = [room.file("large.dcm", **LARGE)]
    identifier = room.queue(room.destination(peer.port, limits={"attempts": 1, "negotiate_seconds": 0.5}), items)
    peer.process.send_signal(signal.SIGSTOP)
    # The kernel accepts the connection; nobody answers.
    row = room.run(identifier)
    assert row.error["code"] == "association-timeout"
    peer.process.send_signal(signal.SIGCONT)


def test_a_peer_that_stops_in_transfer(room):
    """Nothing but the time limit of the socket ends this."""
    with closing(Scp()) as peer, closing(Link(peer.port)) as link:
        items = [room.file("large.dcm", **LARGE)]
        identifier = room.queue(room.destination(link.port, limits={"attempts": 1, "stall_seconds": 0.5}), items)
        attempt = threading.Thread(target=room.sender.run, args=(identifier,))
        attempt.start()
        wait_for(lambda: link.passed > 500_000)
        link.stopped.set()
        attempt.join(30)
        assert not attempt.is_alive()
        link.stopped.clear()
    row = room.deliveries.get(identifier)
    assert (row.state, row.error["code"]) == ("failed", "stalled")
    assert "stall_seconds" in row.error["message"]


def test_a_peer_that_takes_all_and_says_nothing(room):
    silence = threading.Event()
    with closing(Scp(before=lambda event: silence.wait(20))) as peer:
        row = room.deliver(peer.port, [room.file("a.dcm")], limits={"attempts": 1, "response_seconds": 0.3})
        silence.set()
    assert (row.state, row.error["code"]) == ("failed", "no-answer")
    assert "no answer within" in row.error["message"]


def test_a_slow_link(room):
    """No limit on the whole: as long as bytes move, the transfer goes on."""
    with closing(Scp()) as peer, closing(Link(peer.port, rate=1_000_000)) as link:
        limits = {"attempts": 1, "stall_seconds": 1.0, "response_seconds": 0.5}
        row = room.deliver(link.port, [room.file("a.dcm", rows=1024, columns=1024)], limits=limits)
    assert row.state == "succeeded"


@pytest.mark.needs_dcmtk
@pytest.mark.parametrize("syntax", [JPEGLSLossless, RLELossless])
def test_a_transfer_syntax_that_is_refused(room, storescp, syntax):
    """Decompressed on the way; the file of the case stays as it is."""
    from pydicom import dcmread

    peer = storescp()
    item = room.file("a.dcm", compress=syntax)
    row = room.deliver(peer.port, [item])
    assert row.state == "succeeded"
    (path,) = peer.folder.iterdir()
    stored = dcmread(path)
    assert not stored.file_meta.TransferSyntaxUID.is_compressed
    assert stored.pixel_array.tobytes() == room.pixels["a.dcm"].tobytes()
    assert stored.SOPInstanceUID == dcmread(room.store.path(item)).SOPInstanceUID


@pytest.mark.needs_dcmtk
def test_implicit_alone(room, storescp):
    from pydicom import dcmread

    peer = storescp("+xi")
    row = room.deliver(peer.port, room.case(1))
    assert row.state == "succeeded"
    syntaxes = {dcmread(p).file_meta.TransferSyntaxUID.name for p in peer.folder.iterdir()}
    assert syntaxes == {"Implicit VR Little Endian"}


def test_preferred_transfer_syntax(room):
    both = ["1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2"]
    item = room.file("a.dcm", compress=JPEGLSLossless)
    with closing(Scp(syntaxes=both)) as peer:
        room.deliver(peer.port, [item], name="as-it-is")
        room.deliver(peer.port, [item], name="plain", transfer_syntaxes=["implicit"])
        assert [syntax for _, syntax in peer.received] == ["1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2"]


def test_no_common_transfer_syntax(room):
    with closing(Scp(syntaxes=["1.2.840.10008.1.2.4.50"])) as peer:
        row = room.deliver(peer.port, room.case(1))
    assert row.state == "failed"
    assert row.error["code"] == "class-refused"


def test_a_file_that_is_gone(room, lose):
    items = room.case(2)
    lose(room.store, items[0].sha256)
    with closing(Scp()) as peer:
        row = room.deliver(peer.port, items)
    assert (row.state, row.error["code"]) == ("failed", "file-not-readable")
    assert counts(row) == (2, 1)
    assert "projections/0001.dcm" in row.error["message"]


def test_the_same_uid_with_other_content(room):
    """An archive would keep the old version and say that it stored the new one."""
    first = room.file("a.dcm")
    changed = room.file("a.dcm", rows=4, columns=4)
    with closing(Scp()) as peer:
        destination = room.destination(peer.port)
        assert room.run(room.queue(destination, [first])).state == "succeeded"
        assert room.run(room.queue(destination, [first])).state == "succeeded"  # the same again does no harm
        row = room.run(room.queue(destination, [changed]))
        assert len(peer.received) == 2
    assert (row.state, row.error["code"]) == ("failed", "uid-reused")


def test_poison_does_not_keep_the_others(room):
    """One instance at which the peer hangs up each time."""
    poison = []

    def hang_up(event):
        uid = str(event.request.AffectedSOPInstanceUID)
        poison[:] = poison or [uid]
        if uid == poison[0]:
            event.assoc.abort()

    with closing(Scp(before=hang_up)) as peer:
        row = room.deliver(peer.port, room.case(4))
    assert (row.state, row.error["code"]) == ("failed", "no-answer")
    assert counts(row) == (4, 1)


def test_retry_sends_what_is_missing(room):
    with closing(Scp([0, 0, 0xC000, 0])) as peer:
        row = room.deliver(peer.port, room.case(4))
        assert counts(row) == (4, 1)
        row = room.run(room.deliveries.retry(row.id).id)
        assert (row.state, counts(row)) == ("succeeded", (5, 0))
        assert len(peer.received) == 6


def test_nothing_is_sent_after_an_association_that_is_refused(room, make_room):
    other = make_room(destination_hosts="10.0.0.0/8, pacs.example.org")
    row = other.deliver(104, other.case(1))
    assert (row.state, row.error["code"]) == ("failed", "destination-not-allowed")
    assert "10.0.0.0/8" in row.error["message"]


def test_kinds_are_offered_one_by_one(room):
    with closing(Scp()) as peer:
        destination = room.destination(peer.port).definition
        peer_of_ours = connect(
            destination, [Kind("1.2.3.4.5", "1.2.840.10008.1.2.1"), Kind(peers.MG, "1.2.840.10008.1.2.1")]
        )
        assert peer_of_ours.accepts(peers.MG)
        assert not peer_of_ours.accepts("1.2.3.4.5")
        peer_of_ours.close()
        assert not peer_of_ours.is_open


def test_reasons_of_an_association_that_fails(room, free_port):
    with pytest.raises(AssociationError) as caught:
        connect(room.destination(free_port).definition, [])
    assert caught.value.code == "connection-refused"
    assert caught.value.again
