"""Peers that misbehave: a scripted SCP, and a link between a sender and a peer that is slow or breaks."""

import contextlib
import socket
import threading
import time

from pynetdicom import AE, evt
from pynetdicom.sop_class import Verification

MG = "1.2.840.10008.5.1.4.1.1.1.2.1"
TOMO = "1.2.840.10008.5.1.4.1.1.13.1.3"


def _end(used):
    """Closing alone tells the other side nothing while a thread of ours still reads from the socket."""
    with contextlib.suppress(OSError):
        used.shutdown(socket.SHUT_RDWR)
    used.close()


class Scp:
    """Answers each C-STORE with the next status of a list (the last one again and again).

    strict: takes associations only that call it by its name, PEER.
    """

    def __init__(self, statuses=(0x0000,), classes=(MG, TOMO), syntaxes=None, before=None, strict=False):
        self.statuses = list(statuses)
        self.before = before
        self.received = []
        self.open = self.most_open = 0
        self._lock = threading.Lock()
        entity = AE("PEER")
        entity.require_called_aet = strict
        entity.add_supported_context(Verification)
        for uid in classes:
            entity.add_supported_context(uid, syntaxes or ["1.2.840.10008.1.2.1"])
        handlers = [
            (evt.EVT_C_STORE, self._store),
            (evt.EVT_ACCEPTED, lambda event: self._count(1)),
            (evt.EVT_CONN_CLOSE, lambda event: self._count(-1)),
        ]
        self._server = entity.start_server(("127.0.0.1", 0), block=False, evt_handlers=handlers)
        self.port = self._server.server_address[1]

    def _count(self, change):
        with self._lock:
            self.open += change
            self.most_open = max(self.most_open, self.open)

    def _store(self, event):
        with self._lock:
            status = self.statuses.pop(0) if len(self.statuses) > 1 else self.statuses[0]
            self.received.append((str(event.request.AffectedSOPInstanceUID), str(event.context.transfer_syntax)))
        if self.before:
            self.before(event)
        return status

    def close(self):
        self._server.shutdown()


class Link:
    """Passes bytes on to a port. rate: bytes a second. Cut by ``cut``, after ``cut_after`` bytes, or stopped."""

    def __init__(self, port, rate=None, cut_after=None):
        self.target = port
        self.rate = rate
        self.cut_after = cut_after
        self.passed = 0
        self.stopped = threading.Event()
        self._sockets = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(("127.0.0.1", self.target))
            except OSError:
                near.close()
                continue
            near.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
            self._sockets += [near, far]
            threading.Thread(target=self._pass, args=(near, far, True), daemon=True).start()
            threading.Thread(target=self._pass, args=(far, near, False), daemon=True).start()

    def _pass(self, source, target, forth):
        with contextlib.suppress(OSError):
            while data := source.recv(16384):
                if forth:
                    while self.stopped.is_set():
                        time.sleep(0.02)
                    if self.rate:
                        time.sleep(len(data) / self.rate)
                    self.passed += len(data)
                    if self.cut_after is not None and self.passed > self.cut_after:
                        self.cut_after = None
                        break
                target.sendall(data)
        # What is shut down but not closed still takes data until its buffer is full.
        for end in (source, target):
            _end(end)

    def close(self):
        self._listener.close()
        for used in self._sockets:
            _end(used)


class Silent:
    """Takes connections and never says anything; or says something that is not DICOM."""

    def __init__(self, says=None):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._sockets = []
        self._says = says
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                self._sockets.append(near)
                if self._says is not None:
                    near.sendall(self._says)
                    near.close()

    def close(self):
        self._listener.close()
        for used in self._sockets:
            _end(used)
