"""Storage commitment (PS3.4 annex J): asking a peer to say that it will keep what it stored, and hearing its report.

A peer reports on the association of the request, or on one of its own to the address that it has for our AE title:
``Listener`` waits there (TOMOSIM_COMMITMENT_ADDRESS).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydicom.dataset import Dataset
from pydicom.uid import generate_uid
from pynetdicom import AE, evt

from worker.delivery.association import AssociationError, Peer

PUSH_MODEL = "1.2.840.10008.1.20.1"
PUSH_MODEL_INSTANCE = "1.2.840.10008.1.20.1.1"
REQUEST_COMMITMENT = 1
POLL_SECONDS = 0.2

_REASONS = {
    0x0110: "processing failure",
    0x0112: "it does not have the instance",
    0x0119: "another SOP class than the one it has",
    0x0122: "SOP class not supported",
    0x0131: "duplicate transaction",
    0x0213: "resource limitation",
}


@dataclass(frozen=True)
class Reference:
    """An instance that is to be kept."""

    sop_class: str
    sop_instance: str


@dataclass
class Report:
    """What a peer says of a transaction. failed: reasons by SOP Instance UID."""

    committed: set[str] = field(default_factory=set)
    failed: dict[str, str] = field(default_factory=dict)


class Reports:
    """Reports that have come in, by transaction."""

    def __init__(self) -> None:
        self._found: dict[str, Report | None] = {}
        self._changed = threading.Condition()

    def expect(self, transaction: str) -> None:
        """From now on a report of this transaction is kept."""
        with self._changed:
            self._found[transaction] = None

    def wait(self, transaction: str, seconds: float, goes_on: Callable[[], bool]) -> Report | None:
        """The report, or None where none came in time, or the waiting does not go on."""
        deadline = time.monotonic() + seconds
        with self._changed:
            while self._found[transaction] is None and goes_on() and time.monotonic() < deadline:
                self._changed.wait(POLL_SECONDS)
            return self._found.pop(transaction)

    def receive(self, event: Any) -> tuple[int, None]:
        """Handler of N-EVENT-REPORT: keeps a report that is expected; the status of the answer."""
        information = event.event_information
        transaction = str(information.get("TransactionUID", ""))
        report = Report({str(item.ReferencedSOPInstanceUID) for item in information.get("ReferencedSOPSequence", ())})
        for item in information.get("FailedSOPSequence", ()):
            reason = int(item.get("FailureReason", 0x0110))
            report.failed[str(item.ReferencedSOPInstanceUID)] = f"{_REASONS.get(reason, 'failed')} (0x{reason:04X})"
        with self._changed:
            if transaction not in self._found:
                return 0x0112, None  # of another worker, or given up
            self._found[transaction] = report
            self._changed.notify_all()
        return 0x0000, None


class Listener:
    """Takes associations of peers that report. address: host:port. raises: OSError where it cannot listen"""

    def __init__(self, address: str, reports: Reports) -> None:
        host, _, port = address.rpartition(":")
        entity = AE("TOMOSIM")
        entity.add_supported_context(PUSH_MODEL, scu_role=True, scp_role=True)
        entity.add_supported_context("1.2.840.10008.1.1")
        handlers = [(evt.EVT_N_EVENT_REPORT, reports.receive)]
        self._server = entity.start_server((host.strip("[]"), int(port)), block=False, evt_handlers=handlers)

    def close(self) -> None:
        self._server.shutdown()


def request(peer: Peer, references: Sequence[Reference], reports: Reports) -> str:
    """Asks for commitment; the transaction whose report is to be waited for. raises: AssociationError"""
    transaction = str(generate_uid(prefix=None))
    information = Dataset()
    information.TransactionUID = transaction
    information.ReferencedSOPSequence = [_item(reference) for reference in references]
    reports.expect(transaction)
    if not peer.accepts(PUSH_MODEL):
        raise AssociationError(
            "commitment-refused",
            f"{peer.destination.called_aet} offers no storage commitment: enable it there, or take commitment_seconds "
            "from the destination",
            again=False,
        )
    status = peer.act(information, REQUEST_COMMITMENT, PUSH_MODEL, PUSH_MODEL_INSTANCE)
    if status is None:
        raise AssociationError("no-answer", f"the request for commitment: {peer.why()}", again=True)
    if status != 0x0000:
        text = f"{peer.destination.called_aet} answered 0x{status:04X} to the request for commitment: see its log"
        raise AssociationError("commitment-refused", text, again=False)
    return transaction


def _item(reference: Reference) -> Dataset:
    item = Dataset()
    item.ReferencedSOPClassUID = reference.sop_class
    item.ReferencedSOPInstanceUID = reference.sop_instance
    return item
