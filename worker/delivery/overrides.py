"""Everything here replaces or reaches into internals of pynetdicom, of the one version that is named.

What it leaves open is closed here: a failure is remembered, a peer that stops reading ends the association (a time
limit on every byte of the socket: nothing else ends a blocked send), the sender waits for the network instead of
queueing a whole file, bandwidth is shared, a rejection that comes quickly is read, and so is every answer.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

from pynetdicom import AE, _config
from pynetdicom.association import Association
from pynetdicom.pdu import P_DATA_TF
from pynetdicom.pdu_primitives import A_ASSOCIATE, P_DATA, MaximumLengthNotification
from pynetdicom.transport import AddressInformation, AssociationSocket

from simcore.dicom.identity import IMPLEMENTATION_UID
from tomosim_contract.destination import Destination

VERSION = "3.0.4"
"""The version of pynetdicom whose internals these are; pyproject.toml takes no other one."""

_config.STORE_SEND_CHUNKED_DATASET = True
_config.LOG_HANDLER_LEVEL = "none"
# What it reports as errors are answers of peers: they are recorded with the instance.
logging.getLogger("pynetdicom").setLevel(logging.CRITICAL)

BATCH_BYTES = 1 << 18
"""Data goes to the socket in portions of about this size."""

LOOK_SECONDS = 0.05
"""A paused association says so at least this often."""

QUEUE_LENGTH = 4
"""Portions that may wait for the socket."""


class Throttle:
    """Bandwidth shared by several associations. rate: bytes a second; None: no limit."""

    def __init__(self, rate: float | None) -> None:
        self.rate = rate
        self._lock = threading.Lock()
        self._free_at = 0.0

    def wait(self, size: int) -> None:
        """Returns when ``size`` bytes more may be sent."""
        if self.rate is None:
            return
        with self._lock:
            start = max(time.monotonic(), self._free_at)
            self._free_at = start + size / self.rate
        if (left := start - time.monotonic()) > 0:
            time.sleep(left)


class Socket(AssociationSocket):
    """Remembers why it failed, gives up where no byte moves, keeps to a bandwidth, counts."""

    socket: Any
    failure: Exception | None = None
    connected = False
    stalled = False
    stall_seconds: float = 60.0
    throttle = Throttle(None)
    count: Callable[[int], None] = staticmethod(lambda size: None)

    def connect(self, primitive: Any) -> None:
        """As the base class, which only logs the reason of a failure and then waits for ever in send."""
        try:
            if self.tls_args:
                context, name = self.tls_args
                self.socket = context.wrap_socket(self.socket, server_hostname=name)
            self.socket.settimeout(self.assoc.connection_timeout)
            self.socket.connect(primitive.address_info.as_tuple)
            self.socket.settimeout(self.stall_seconds)
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.assoc.requestor.address_info = AddressInformation.from_tuple(self.socket.getsockname())
            self._is_connected = self.connected = True
            primitive.result = "Evt2"
        except (OSError, ValueError) as error:
            self.failure = error
            self._shutdown_socket()
            self.socket = None
            primitive.result = "Evt17"
        self.provider_queue.put(primitive)
        self._ready.set()

    def send(self, bytestream: bytes) -> None:
        """As the base class; a peer that takes no byte for ``stall_seconds`` ends the association."""
        self.send_parts([bytestream])

    def send_parts(self, parts: list[bytes]) -> None:
        """Sends several buffers as one, without joining them where the socket can do so."""
        assert self.socket is not None
        try:
            if isinstance(self.socket, ssl.SSLSocket):
                parts = [b"".join(parts)]
            size = sum(map(len, parts))
            self.throttle.wait(size)
            sent = self._send_some(self.socket, parts)
            if sent < size:
                left = memoryview(b"".join(parts))[sent:]
                while left:
                    left = left[self.socket.send(left) :]
            self.count(size)
        except Exception as error:
            self.failure = error
            self.stalled = isinstance(error, TimeoutError)
            self.event_queue.put("Evt17")

    @staticmethod
    def _send_some(used: socket.socket, parts: list[bytes]) -> int:
        return int(used.send(parts[0]) if len(parts) == 1 else used.sendmsg(parts))


class PatientQueue(queue.Queue[Any]):
    """Primitives on their way to the socket.

    Data waits where there is much already, so a file is read as it is sent; and small fragments go on together, since
    pynetdicom needs as long for a small one as for a large one.
    """

    def __init__(self, association: Association) -> None:
        super().__init__()
        self._thread = association.dul
        self._batch = P_DATA()
        self._batch_bytes = 0

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        if not isinstance(item, P_DATA):
            super().put(item, block, timeout)
            return
        fragments = item.presentation_data_value_list
        self._batch.presentation_data_value_list.extend(fragments)
        self._batch_bytes += sum(len(data) for _, data in fragments)
        is_last = fragments[-1][1][0] & 0x02
        if is_last or self._batch_bytes >= BATCH_BYTES:
            ready, self._batch, self._batch_bytes = self._batch, P_DATA(), 0
            self._wait_for_room()
            super().put(ready, block, timeout)

    def _wait_for_room(self) -> None:
        with self.not_full:
            while self._qsize() >= QUEUE_LENGTH:
                if not self._thread.is_alive():
                    raise ConnectionError("the association has ended")
                self.not_full.wait(0.2)


def _send_data(association: Association) -> Callable[[Any], None]:
    """Replaces the way of a PDU to the socket: fragments of data take a short one, each in a PDU of its own."""
    usual = association.dul._send

    def send(pdu: Any) -> None:
        if not isinstance(pdu, P_DATA_TF):
            usual(pdu)
            return
        parts = []
        for fragment in pdu.presentation_data_value_items:
            data = fragment.presentation_data_value
            parts += [_PDU_HEADER.pack(4, len(data) + 5, len(data) + 1, fragment.presentation_context_id), data]
        association.dul.socket.send_parts(parts)

    return send


class Checkpoint:
    """Where pynetdicom's own thread of an association waits while we wait for an answer. Set to begin with.

    With the event of pynetdicom the thread may have passed when the association still says that it is paused; it then
    takes the answer for a request and throws it away, and an instance that was stored is sent again. Here passing and
    saying so are one step.
    """

    def __init__(self, association: Any) -> None:
        self._association = association
        self._is_set = True
        self._changed = threading.Condition()

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        with self._changed:
            self._is_set = True
            self._changed.notify_all()

    def clear(self) -> None:
        with self._changed:
            self._is_set = False
            self._changed.notify_all()

    def wait(self) -> bool:
        with self._changed:
            while not self._is_set:
                # Said again and again: a thread that serves a report says otherwise when it ends.
                self._association._is_paused = True
                self._changed.wait(LOOK_SECONDS)
            self._association._is_paused = False
        return True


_PDU_HEADER = struct.Struct(">BxIIB")
"""P-DATA-TF with one item: type, length, length of the item, presentation context (PS3.8 section 9.3.5)."""


class Entity(AE):
    """Makes associations on sockets of ours."""

    def __init__(self, destination: Destination, throttle: Throttle, count: Callable[[int], None]) -> None:
        super().__init__(destination.calling_aet)
        limits = destination.limits
        self.implementation_class_uid = IMPLEMENTATION_UID
        self.implementation_version_name = "TOMOSIM"
        self.connection_timeout = limits.connect_seconds
        self.acse_timeout = limits.negotiate_seconds
        self.network_timeout = None
        self._stall_seconds = limits.stall_seconds
        self._throttle = throttle
        self._count = count
        self.socket: Socket | None = None

    def _create_socket(
        self, assoc: Association, address: AddressInformation, tls_args: tuple[ssl.SSLContext, str] | None
    ) -> AssociationSocket:
        used = Socket(assoc, address=address)
        used.tls_args = tls_args
        used.stall_seconds = self._stall_seconds
        used.throttle = self._throttle
        used.count = self._count
        assoc.dul.to_provider_queue = PatientQueue(assoc)
        assoc.dul._send = _send_data(assoc)
        assoc._reactor_checkpoint = Checkpoint(assoc)  # type: ignore[assignment]
        self.socket = used
        return used


def limit_pdu(association: Association, limit: int) -> None:
    """Holds what we send to the smaller one of the peer's limit (0: none) and ours [byte]."""
    for item in association.acceptor.primitive.user_information:
        if isinstance(item, MaximumLengthNotification):
            item.maximum_length_received = min(item.maximum_length_received or limit, limit)


def rejection_of(association: Association) -> Any:
    """The peer's rejection; None where it sent none."""
    if association.is_rejected:
        return association.acceptor.primitive
    # pynetdicom looks at the state of the socket after it waited for the connection: where the peer's rejection was
    # quicker than the thread that waits, it takes the closed socket for one that never connected, and reads no answer.
    with contextlib.suppress(queue.Empty):
        while True:
            left = association.dul.to_user_queue.get_nowait()
            if isinstance(left, A_ASSOCIATE) and left.result in (1, 2):
                return left
    return None


def ended_by_peer(association: Association) -> bool:
    """Whether the peer aborted it, and not we."""
    return bool(association.is_aborted and not association._sent_abort)


def wake(association: Association) -> None:
    """Lets pynetdicom's own thread go on, which an exception on the way has left waiting."""
    association._reactor_checkpoint.set()
