"""One attempt at all that is missing of a delivery: associations, instances, storage commitment."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from simcore.core.errors import SimulationError, StoreError
from simcore.store.hashing import FileRef
from simcore.store.store import Store
from tomosim_contract.destination import Destination
from tomosim_contract.names import failure, internal_failure
from worker.delivery import association, commitment, outcomes
from worker.delivery.association import AssociationError, Kind, Peer
from worker.delivery.commitment import Reports
from worker.delivery.files import UNCOMPRESSED, FileError, Header, converted, offered, read_header
from worker.delivery.overrides import Throttle
from worker.records.database import Result, outlast
from worker.records.deliveries import Deliveries
from worker.records.delivery_tables import Delivery, Instance, Outcome
from worker.records.rows import Json
from worker.settings import Settings

log = logging.getLogger(__name__)

FAILURES_IN_A_ROW = 2
"""An association is opened anew after a failure; after so many the delivery is postponed."""

PORTION = 100
"""Instances that are made ready, and sent on the same associations."""


@dataclass(frozen=True)
class Tools:
    """What every tour works with."""

    settings: Settings
    deliveries: Deliveries
    store: Store
    reports: Reports


@dataclass(frozen=True)
class Parcel:
    """An instance that is ready to be sent."""

    instance: Instance
    header: Header
    path: Path


class Tour:
    """One attempt at all that is missing, on as many associations as the destination allows.

    refusal: why the whole delivery cannot be made. trouble: why something is to be tried again.
    """

    def __init__(self, tools: Tools, row: Delivery, destination: Destination, folder: Path) -> None:
        self.deliveries = tools.deliveries
        self.settings = tools.settings
        self.store = tools.store
        self.row = row
        self.destination = destination
        self.folder = folder
        self.refusal: Json | None = None
        self.trouble: Json | None = None
        self.uncommitted = False
        self.bytes_sent = 0
        self._reports = tools.reports
        rate = destination.limits.bandwidth_MBps
        self._throttle = Throttle(None if rate is None else rate * 1e6)
        self._stopped = threading.Event()
        self._lock = threading.Lock()
        self._left: deque[Parcel] = deque()
        self._kinds: set[Kind] = set()
        self._peers: set[Peer] = set()
        self._threads: list[threading.Thread] = [threading.Thread(target=self._run, name="delivery", daemon=True)]

    def start(self) -> None:
        self._threads[0].start()

    def is_alive(self) -> bool:
        return self._threads[0].is_alive()

    def join(self, timeout_seconds: float | None) -> None:
        self._threads[0].join(timeout_seconds)

    def stop(self) -> None:
        """Ends every association at once; what was on its way is sent again another time."""
        self._stopped.set()
        with self._lock:
            peers = list(self._peers)
        for peer in peers:
            peer.abort()

    def _run(self) -> None:
        """Portion by portion, so that a study needs no more room on the disk than a case (files may come from afar)."""
        try:
            last = -1
            while self._goes_on and (portion := self._portion(last)):
                last = portion[-1].number
                self._deliver(portion)
            if self._goes_on and self.destination.commitment_seconds is not None:
                self._commit(self.destination.commitment_seconds)
        except AssociationError as error:
            self._no_association(error)
        except FileError as error:
            self.refusal = failure("file-not-readable", f"no storage commitment: {error}")
        except SimulationError as error:
            self.refusal = error.to_dict()
        except Exception as error:
            log.exception("delivery failed", extra={"delivery": self.row.id})
            self.refusal = internal_failure(error)

    @property
    def _goes_on(self) -> bool:
        return not self._stopped.is_set() and self.refusal is None and self.trouble is None

    def _portion(self, after: int) -> list[Instance]:
        take = partial(self.deliveries.instances, self.row.id, state="waiting", after=after, limit=PORTION)
        return self._outlast(take)

    def _deliver(self, portion: list[Instance]) -> None:
        for instance in portion:
            if self._stopped.is_set():
                return
            if (parcel := self._prepare(instance)) is not None:
                self._left.append(parcel)
                self._kinds |= {Kind(parcel.header.kind.sop_class, s) for s in self._syntaxes(parcel)}
        count = min(self.destination.limits.associations, len(self._left))
        threads = [threading.Thread(target=self._carry, name="delivery", daemon=True) for _ in range(count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _commit(self, seconds: float) -> None:
        """Asks for storage commitment of all that is stored. raises: AssociationError"""
        stored = self._outlast(lambda: self.deliveries.uncommitted(self.row.id))
        by_uid = {i.sop_instance: i for i in stored if i.sop_instance}
        if not by_uid:
            return
        self.uncommitted = True
        paths = [self.store.path(FileRef(i.sha256, i.size)) for i in by_uid.values()]
        headers = [read_header(path) for path in paths]
        peer = self._connect([Kind(commitment.PUSH_MODEL, s) for s in UNCOMPRESSED])
        try:
            references = [commitment.Reference(h.kind.sop_class, h.sop_instance) for h in headers]
            transaction = commitment.request(peer, references, self._reports)
            report = self._reports.wait(transaction, seconds, lambda: not self._stopped.is_set())
        finally:
            self._close(peer)
        if self._stopped.is_set():
            return
        if report is None:
            text = (
                f"{self.destination.called_aet} took the request for storage commitment and sent no report within "
                f"{seconds:g} s: tell it the address for {self.destination.calling_aet} and set "
                "TOMOSIM_COMMITMENT_ADDRESS, or raise commitment_seconds; everything is stored"
            )
            raise AssociationError("commitment-timeout", text, again=False)
        self.uncommitted = False
        committed = [i.number for uid, i in by_uid.items() if uid in report.committed]
        others = {i.number: report.failed.get(uid, "its report does not name it") for uid, i in by_uid.items()}
        failed = {number: why for number, why in others.items() if number not in committed}
        self._outlast(lambda: self.deliveries.commit(self.row.id, committed, failed))

    def _prepare(self, instance: Instance) -> Parcel | None:
        """Reads what a file is; None where it cannot be sent, which is written down."""
        try:
            path = self.store.path(FileRef(instance.sha256, instance.size))
            header = read_header(path)
        except StoreError as error:
            if error.code in ("store-unavailable", "storage-full"):
                self.trouble = error.to_dict()
            else:
                self._record(instance, outcomes.unreadable(instance.name, str(error)))
            return None
        except FileError as error:
            self._record(instance, outcomes.unreadable(instance.name, str(error)))
            return None
        if self._outlast(lambda: self._is_other_version(instance, header.sop_instance)):
            self._record(instance, outcomes.reused(header.sop_instance))
            return None
        return Parcel(instance, header, path)

    def _is_other_version(self, instance: Instance, sop_instance: str) -> bool:
        if instance.sop_instance is None:
            self.deliveries.identify(self.row.id, instance.number, sop_instance)
        return self.deliveries.other_version(self.row.destination_id, sop_instance, instance.sha256)

    def _syntaxes(self, parcel: Parcel) -> list[str]:
        return offered(parcel.header.kind, self.destination)

    def _carry(self) -> None:
        """Sends parcels on one association, on a new one after a failure."""
        peer: Peer | None = None
        failures = 0
        try:
            while not self._stopped.is_set() and failures < FAILURES_IN_A_ROW and (parcel := self._take()):
                if peer is None:
                    peer = self._connect(self._kinds)
                outcome = self._send(peer, parcel)
                if outcome.verdict == "again" and self._stopped.is_set():
                    return  # we ended the association: not the peer's doing
                self._record(parcel.instance, outcome)
                failures = failures + 1 if outcome.verdict == "again" else 0
                if outcome.verdict == "again":
                    self.trouble = outcome.error()
                    self._close(peer)
                    peer = None
        except AssociationError as error:
            self._no_association(error)
        except SimulationError as error:  # an address that is not allowed
            self.refusal = error.to_dict()
        except Exception as error:
            log.exception("delivery failed", extra={"delivery": self.row.id})
            self.refusal = internal_failure(error)
        finally:
            if peer is not None:
                self._close(peer)

    def _take(self) -> Parcel | None:
        with self._lock:
            return self._left.popleft() if self._left and self.refusal is None else None

    def _connect(self, kinds: Iterable[Kind]) -> Peer:
        peer = association.connect(
            self.destination,
            kinds,
            allowed=self.settings.allowed_destinations,
            secrets=self.settings.resolved_secrets_folder,
            throttle=self._throttle,
            count=self._count,
            on_report=self._reports.receive,
        )
        with self._lock:
            self._peers.add(peer)
        if self._stopped.is_set():
            peer.abort()
        peer.echo()
        return peer

    def _no_association(self, error: AssociationError) -> None:
        if self._stopped.is_set():
            return
        if error.again:
            self.trouble = error.to_dict()
        else:
            self.refusal = error.to_dict()

    def _send(self, peer: Peer, parcel: Parcel) -> Outcome:
        sop_class = parcel.header.kind.sop_class
        called = self.destination.called_aet
        if not peer.accepts(sop_class):
            return outcomes.class_refused(association.name_of(sop_class), called)
        syntaxes = self._syntaxes(parcel)
        syntax = next((s for s in syntaxes if Kind(sop_class, s) in peer.accepted), None)
        if syntax is None:
            names = ", ".join(map(association.name_of, syntaxes))
            return outcomes.syntax_refused(association.name_of(sop_class), names, called)
        path = parcel.path
        try:
            if syntax != parcel.header.kind.transfer_syntax:
                path = converted(path, syntax, self.folder / f"{parcel.instance.number}.dcm")
            status = peer.store(path)
        except FileError as error:
            return outcomes.unreadable(parcel.instance.name, str(error))
        except OSError as error:
            return outcomes.unreadable(parcel.instance.name, error.strerror or str(error))
        finally:
            if path != parcel.path:
                path.unlink(missing_ok=True)
        if status is not None:
            return outcomes.of_status(status)
        if peer.stalled:
            return outcomes.stalled(self.destination.limits.stall_seconds)
        return outcomes.no_answer(peer.why(), called, self.destination.calling_aet)

    def _record(self, instance: Instance, outcome: Outcome) -> None:
        extra = {"delivery": self.row.id, "instance": instance.name, "code": outcome.code}
        log.info("instance %s", outcome.verdict, extra=extra)
        attempts = self.destination.limits.attempts
        self._outlast(lambda: self.deliveries.record(self.row.id, instance.number, outcome, attempts))

    def _outlast(self, action: Callable[[], Result]) -> Result:
        return outlast(action, self._stopped.is_set)

    def _close(self, peer: Peer) -> None:
        with self._lock:
            self._peers.discard(peer)
        peer.close()

    def _count(self, size: int) -> None:
        self.bytes_sent += size
