"""An association with a destination: opened, tested, instances stored, closed. On pynetdicom (``overrides``)."""

from __future__ import annotations

import contextlib
import socket
import ssl
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydicom.dataset import Dataset
from pydicom.uid import UID
from pynetdicom import build_context, evt
from pynetdicom.association import Association
from pynetdicom.presentation import PresentationContext

from simcore.core.errors import SimulationError
from tomosim_contract.destination import Destination, Tls
from worker.delivery import addresses, overrides
from worker.delivery.overrides import Entity, Socket, Throttle

VERIFICATION = "1.2.840.10008.1.1"

IN_FLIGHT_BYTES = 8_000_000
"""What may lie in the queue and in the socket buffers of both ends when the last byte was handed over."""

SLOWEST_BYTES_PER_SECOND = 100_000.0
"""A link that is slower than this is taken for broken."""


class AssociationError(SimulationError):
    """There is no association. ``again``: it may succeed later without anybody's doing."""

    kind = "system"
    code = "association-failed"

    def __init__(self, code: str, message: str, *, again: bool) -> None:
        super().__init__(message, code=code)
        self.again = again


@dataclass(frozen=True)
class Kind:
    """What an instance is, as far as negotiation goes."""

    sop_class: str
    transfer_syntax: str


class Peer:
    """An association that is open. Closed by ``close``; ``abort`` ends it from another thread, at once."""

    def __init__(self, destination: Destination, association: Association, used: Socket) -> None:
        self.destination = destination
        self._association = association
        self._socket = used
        self._messages = 0
        self.accepted = {Kind(str(c.abstract_syntax), str(c.transfer_syntax[0])) for c in association.accepted_contexts}
        overrides.limit_pdu(association, destination.limits.maximum_pdu)

    @property
    def is_open(self) -> bool:
        return bool(self._association.is_established)

    @property
    def stalled(self) -> bool:
        """Whether it ended because the peer took no byte."""
        return self._socket.stalled

    def accepts(self, sop_class: str) -> bool:
        """Whether the peer takes this class, in whatever transfer syntax."""
        return any(kind.sop_class == sop_class for kind in self.accepted)

    @property
    def offers_echo(self) -> bool:
        return self.accepts(VERIFICATION)

    def echo(self) -> None:
        """C-ECHO, where the peer offers that. raises: AssociationError"""
        if not self.offers_echo:
            return
        limits = self.destination.limits
        self._association.dimse_timeout = limits.negotiate_seconds
        try:
            status = self._association.send_c_echo().get("Status")
        except (RuntimeError, ValueError, ConnectionError) as error:
            raise AssociationError("echo-failed", f"{self._name} did not answer C-ECHO: {error}", again=True) from None
        if status != 0x0000:
            how = "gave no answer to" if status is None else f"answered 0x{status:04X} to"
            raise AssociationError("echo-failed", f"{self._name} {how} C-ECHO: see the peer's log", again=True)

    def store(self, path: Path) -> int | None:
        """C-STORE of a file whose class and transfer syntax were accepted; None where no answer came."""
        size = path.stat().st_size
        self._messages = self._messages % 65535 + 1
        patience = min(size, IN_FLIGHT_BYTES) / SLOWEST_BYTES_PER_SECOND
        self._association.dimse_timeout = self.destination.limits.response_seconds + patience
        try:
            status: int | None = self._association.send_c_store(path, self._messages).get("Status")
            return status
        except (RuntimeError, ConnectionError):
            self._end()
            return None

    def act(self, information: Dataset, action: int, sop_class: str, sop_instance: str) -> int | None:
        """N-ACTION; the status, None where no answer came."""
        self._association.dimse_timeout = self.destination.limits.response_seconds
        try:
            answer, _ = self._association.send_n_action(information, action, sop_class, sop_instance)
            status: int | None = answer.get("Status")
            return status
        except (RuntimeError, ConnectionError):
            self._end()
            return None

    def why(self) -> str:
        """Why no answer came."""
        if self._socket.failure is not None:
            return f"the connection to {self._name} broke ({_text(self._socket.failure)})"
        if overrides.ended_by_peer(self._association):
            return f"{self._name} ended the association without an answer"
        return f"{self._name} gave no answer within {self._association.dimse_timeout:.0f} s"

    def close(self) -> None:
        """Releases the association where it still stands, else cleans up."""
        if self.is_open:
            self._association.release()
        self._end()

    def abort(self) -> None:
        """Ends it at once; what is being sent fails."""
        self._shutdown()

    def _end(self) -> None:
        overrides.wake(self._association)
        if self.is_open or self._association.dul.is_alive():
            self._shutdown()
            self._association.abort()

    def _shutdown(self) -> None:
        used = self._socket.socket
        if used is not None:
            with contextlib.suppress(OSError):
                used.shutdown(socket.SHUT_RDWR)

    @property
    def _name(self) -> str:
        d = self.destination
        return f"{d.called_aet} at {d.host}:{d.port}"


def connect(
    destination: Destination,
    kinds: Iterable[Kind],
    *,
    allowed: Sequence[str] = (),
    secrets: Path = Path(),
    throttle: Throttle | None = None,
    count: Callable[[int], None] = lambda size: None,
    on_report: Callable[[Any], Any] | None = None,
) -> Peer:
    """Opens an association that offers each kind by itself, so that one that is refused harms no other.

    on_report: handler of N-EVENT-REPORT. raises: AssociationError; DestinationNotAllowed
    """
    entity = Entity(destination, throttle or Throttle(None), count)
    where = f"{destination.host}:{destination.port}"
    try:
        address = addresses.resolve(destination.host, destination.port, allowed)
    except OSError as error:
        raise AssociationError(
            "host-not-found", f"host = {destination.host!r} is not known ({_text(error)}): correct it", again=True
        ) from None
    tls = (
        (_tls_context(destination.tls, secrets), destination.tls.server_name or destination.host)
        if destination.tls
        else None
    )
    started = time.monotonic()
    association = entity.associate(
        address,
        destination.port,
        contexts=_contexts(kinds),
        ae_title=destination.called_aet,
        max_pdu=min(destination.limits.maximum_pdu, 131_072),
        tls_args=tls,
        evt_handlers=[(evt.EVT_N_EVENT_REPORT, on_report)] if on_report else [],
    )
    assert entity.socket is not None
    if association.is_established:
        return Peer(destination, association, entity.socket)
    waited = time.monotonic() - started
    raise _why_not(destination, where, association, entity.socket, waited)


def _contexts(kinds: Iterable[Kind]) -> list[PresentationContext]:
    offered = sorted(set(kinds), key=lambda k: (k.sop_class, k.transfer_syntax))
    contexts = [build_context(VERIFICATION, ["1.2.840.10008.1.2", "1.2.840.10008.1.2.1"])]
    # An association has 128 contexts at most; a case has about a tenth of that.
    return contexts + [build_context(k.sop_class, [k.transfer_syntax]) for k in offered[:127]]


def _why_not(
    destination: Destination, where: str, association: Association, used: Socket, waited: float
) -> AssociationError:
    """The reason and the advice for an association that did not come about."""
    failure = None if used.connected else used.failure
    if isinstance(failure, ssl.SSLCertVerificationError):
        text = f"the certificate of {where} is not valid ({failure.verify_message}): correct tls.ca_file or server_name"
        return AssociationError("tls-certificate", text, again=False)
    if isinstance(failure, ssl.SSLError):
        text = f"no TLS with {where} ({failure.reason or failure}): does the peer speak TLS on this port?"
        return AssociationError("tls-failed", text, again=False)
    if destination.tls is not None and isinstance(failure, ConnectionResetError | BrokenPipeError):
        text = f"{where} ended the connection when TLS began: does the peer speak TLS on this port?"
        return AssociationError("tls-failed", text, again=True)
    if isinstance(failure, ConnectionRefusedError):
        text = f"nothing listens at {where}: start the peer, or correct host and port (or the firewall between)"
        return AssociationError("connection-refused", text, again=True)
    if isinstance(failure, TimeoutError):
        text = f"{where} did not answer within {destination.limits.connect_seconds:g} s: is a firewall between?"
        return AssociationError("connection-timeout", text, again=True)
    if failure is not None:
        return AssociationError("unreachable", f"{where} cannot be reached ({_text(failure)})", again=True)
    if (answer := overrides.rejection_of(association)) is not None:
        return _rejection(destination, answer)
    if waited >= destination.limits.negotiate_seconds:
        text = f"{where} took the connection but did not answer within {waited:.0f} s: is it a DICOM service, and well?"
        return AssociationError("association-timeout", text, again=True)
    hint = "" if destination.tls is None else " (over TLS: perhaps it wants a certificate of ours)"
    text = f"{where} ended the connection instead of accepting the association{hint}: see the peer's log"
    return AssociationError("association-aborted", text, again=True)


def _rejection(destination: Destination, answer: Any) -> AssociationError:
    called, calling = destination.called_aet, destination.calling_aet
    reason = str(answer.reason_str)
    match (answer.result_source, answer.diagnostic):
        case (1, 7):
            advice = f"the peer is not called {called!r}: correct called_aet (capitals matter)"
        case (1, 3):
            advice = f"register the calling AE title {calling!r} in the peer, or correct calling_aet"
        case _:
            advice = "see the peer's log"
    permanent = answer.result == 1
    code = "association-rejected" if permanent else "association-rejected-for-now"
    return AssociationError(code, f"{called} rejected the association: {reason}; {advice}", again=not permanent)


def _tls_context(tls: Tls, secrets: Path) -> ssl.SSLContext:
    """raises: AssociationError where a file cannot be used"""
    name = tls.ca_file
    try:
        context = ssl.create_default_context(cafile=str(secrets / name) if name else None)
        if not tls.verify:
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        if tls.certificate_file:
            name = tls.certificate_file
            key = str(secrets / tls.key_file) if tls.key_file else None
            # An encrypted key must not ask for its password on a terminal.
            context.load_cert_chain(str(secrets / name), key, password="")
    except (OSError, ValueError) as error:
        text = f"tls: {name} cannot be used ({_text(error)}): a PEM file in the secrets folder, readable by the worker"
        raise AssociationError("tls-file", text, again=False) from None
    return context


def _text(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def name_of(uid: str) -> str:
    """A UID's name in the standard, with the UID."""
    known = UID(uid).name
    return f"{known} ({uid})" if known != uid else uid
