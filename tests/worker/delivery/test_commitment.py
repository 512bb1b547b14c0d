"""Storage commitment: asked for after the last instance, its report heard on either association."""

import threading
from contextlib import closing

import pytest
from pydicom.dataset import Dataset
from pynetdicom import AE, evt
from pynetdicom.sop_class import Verification

from tests.support import peers
from worker.delivery.commitment import PUSH_MODEL, PUSH_MODEL_INSTANCE, Listener


class Committing:
    """Stores everything, and reports on the association of the request. lost: how many instances it has lost."""

    def __init__(self, lost=0, reports=True, status=0x0000):
        self.lost, self.reports, self.status = lost, reports, status
        self.stored, self.asked = [], []
        entity = AE("PEER")
        for uid in (Verification, peers.MG, peers.TOMO):
            entity.add_supported_context(uid, ["1.2.840.10008.1.2.1", "1.2.840.10008.1.2"])
        entity.add_supported_context(PUSH_MODEL)
        handlers = [(evt.EVT_C_STORE, self._store), (evt.EVT_N_ACTION, self._act)]
        self._server = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=handlers)
        self.port = self._server.server_address[1]

    def _store(self, event):
        self.stored.append(str(event.request.AffectedSOPInstanceUID))
        return 0x0000

    def _act(self, event):
        request = event.action_information
        self.asked.append([str(item.ReferencedSOPInstanceUID) for item in request.ReferencedSOPSequence])
        if self.reports and self.status == 0:
            threading.Thread(target=self._report, args=(event.assoc, request), daemon=True).start()
        return self.status, None

    def _report(self, association, request):
        items = list(request.ReferencedSOPSequence)
        report = Dataset()
        report.TransactionUID = request.TransactionUID
        report.ReferencedSOPSequence = items[self.lost :]
        if self.lost:
            for item in items[: self.lost]:
                item.FailureReason = 0x0112
            report.FailedSOPSequence = items[: self.lost]
        association.send_n_event_report(report, 2 if self.lost else 1, PUSH_MODEL, PUSH_MODEL_INSTANCE)
        self.lost = 0

    def close(self):
        self._server.shutdown()


def test_a_report_on_the_same_association(room):
    with closing(Committing()) as peer:
        row = room.deliver(peer.port, room.case(2), commitment_seconds=20.0)
    assert (row.state, row.error) == ("succeeded", None)
    assert set(room.codes(row.id)) == {"committed"}
    assert [sorted(uids) for uids in peer.asked] == [sorted(peer.stored)]


def test_what_the_peer_lost_is_sent_again_on_retry(room):
    with closing(Committing(lost=1)) as peer:
        row = room.deliver(peer.port, room.case(2), commitment_seconds=20.0)
        assert (row.state, row.error["code"]) == ("failed", "not-committed")
        assert "0x0112" in row.error["message"]
        assert (row.instances_stored, row.instances_failed) == (2, 1)
        lost = next(i for i in room.deliveries.instances(row.id) if i.state == "failed")
        assert row.bytes_stored == row.bytes - lost.size
        row = room.run(room.deliveries.retry(row.id).id)
    assert (row.state, row.instances_stored, row.bytes_stored) == ("succeeded", 3, row.bytes)
    assert peer.asked[1] == [lost.sop_instance]
    assert len(peer.stored) == 4


def test_no_report(room):
    with closing(Committing(reports=False)) as peer:
        row = room.deliver(peer.port, room.case(1), commitment_seconds=0.2)
        assert (row.state, row.error["code"]) == ("failed", "commitment-timeout")
        assert "TOMOSIM_COMMITMENT_ADDRESS" in row.error["message"]
        assert row.instances_stored == 2
        peer.reports = True
        (destination,) = room.destinations.all()
        room.destinations.replace(destination.id, destination.definition.with_(commitment_seconds=20.0), 1)
        row = room.run(room.deliveries.retry(row.id).id)
    assert (row.state, row.error) == ("succeeded", None)
    assert len(peer.stored) == 2  # asked again, not sent again


@pytest.mark.parametrize("offered", [True, False])
def test_a_peer_that_does_not_commit(room, offered):
    with closing(Committing(status=0x0110) if offered else peers.Scp()) as peer:
        row = room.deliver(peer.port, room.case(1), commitment_seconds=5.0)
    assert (row.state, row.error["code"]) == ("failed", "commitment-refused")
    assert row.instances_stored == 2


@pytest.mark.needs_orthanc
def test_orthanc_reports_to_our_address(room, orthanc, free_port):
    """On an association of its own, to the port that it knows for our AE title."""
    peer = orthanc(DicomModalities={"us": ["TOMOSIM", "127.0.0.1", free_port]})
    with closing(Listener(f"127.0.0.1:{free_port}", room.sender.reports)):
        row = room.deliver(peer.port, room.case(2), commitment_seconds=20.0)
    assert (row.state, row.error) == ("succeeded", None)
    assert set(room.codes(row.id)) == {"committed"}
