"""Work that is done again and again, in a thread of its own."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

log = logging.getLogger(__name__)


class Repeated:
    """Calls ``action`` every few seconds. What it raises is logged, and does not end the thread.

    at_once: it is called when the thread starts, and not first after the pause. stopping: set by ``stop``.
    """

    def __init__(self, name: str, action: Callable[[], object], pause_seconds: float, *, at_once: bool = False) -> None:
        self.action = action
        self.pause_seconds = pause_seconds
        self.stopping = threading.Event()
        self._at_once = at_once
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, patience_seconds: float = 10.0) -> None:
        """Ends the thread; waits no longer than so for what it is doing."""
        self.stopping.set()
        if self._thread.is_alive():
            self._thread.join(patience_seconds)

    def _loop(self) -> None:
        if self._at_once:
            self._call()
        while not self.stopping.wait(self.pause_seconds):
            self._call()

    def _call(self) -> None:
        try:
            self.action()
        except Exception:
            log.exception("%s failed; tried again in %g s", self._thread.name, self.pause_seconds)
