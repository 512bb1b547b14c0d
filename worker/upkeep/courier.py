"""The courier sends what the outbox of webhooks holds, signed as Standard Webhooks says, each receiver by itself.

It runs in a thread of its own beside the sweep. Any number of couriers may run: a message is claimed before it is
sent. One that is killed meanwhile loses nothing; its message is sent again (receivers know it by its webhook-id).
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import logging
import threading
import time
from collections import defaultdict

import anyio

from simcore import __version__
from worker.records.webhooks import Attempt, Message, Webhooks
from worker.settings import Settings
from worker.upkeep import outbound

log = logging.getLogger(__name__)

POLL_SECONDS = 0.5
PRUNE_SECONDS = 3600.0
MAX_RECEIVERS = 16
"""So many receivers are told at a time."""


def signed_headers(secret: str, identifier: str, timestamp: int, body: bytes) -> dict[str, str]:
    """webhook-id, webhook-timestamp and webhook-signature (v1: HMAC-SHA256 over "id.timestamp.body").

    secret: "whsec_" and the key in base 64. timestamp: seconds since 1970.
    """
    key = base64.b64decode(secret.removeprefix("whsec_"))
    signature = hmac.new(key, f"{identifier}.{timestamp}.".encode() + body, hashlib.sha256).digest()
    return {
        "webhook-id": identifier,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": f"v1,{base64.b64encode(signature).decode()}",
    }


class Courier:
    """Sends what is due every half second, in a thread of its own."""

    def __init__(self, settings: Settings, webhooks: Webhooks) -> None:
        self.webhooks = webhooks
        self.private_hosts = settings.webhook_private_host_names
        self._busy: set[str] = set()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=lambda: anyio.run(self._loop), name="courier", daemon=True)
        self._pruned = 0.0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread; what is being sent is sent again by the next courier."""
        self._stopping.set()
        self._thread.join(10.0)

    async def send_due(self) -> None:
        """Sends everything that is due now, and waits for it."""
        async with anyio.create_task_group() as group:
            self._start_due(group)

    async def _loop(self) -> None:
        async with anyio.create_task_group() as group:
            while not self._stopping.is_set():
                try:
                    self._start_due(group)
                    self._prune()
                except Exception:
                    log.exception("webhooks not looked at; tried again soon")
                await anyio.sleep(POLL_SECONDS)
            group.cancel_scope.cancel()

    def _start_due(self, group: anyio.abc.TaskGroup) -> None:
        waiting: dict[str, list[Message]] = defaultdict(list)
        for message in self.webhooks.due(except_to=self._busy):
            waiting[message.webhook_id].append(message)
        for webhook_id, due in waiting.items():
            if len(self._busy) < MAX_RECEIVERS:
                self._busy.add(webhook_id)
                group.start_soon(self._tell, webhook_id, due)

    async def _tell(self, webhook_id: str, due: list[Message]) -> None:
        """Sends messages to one receiver until one fails: the others would fail as well and only take time."""
        try:
            for message in due:
                if not await self._send(message):
                    return
        except Exception:
            log.exception("webhook not told; tried again", extra={"webhook": webhook_id})
        finally:
            self._busy.discard(webhook_id)

    async def _send(self, message: Message) -> bool:
        claimed = self.webhooks.claim(message)
        if claimed is None:
            return True
        url, secret = claimed
        at = time.time()
        body = message.body.encode()
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"tomosim/{__version__}",
            **signed_headers(secret, message.id, int(at), body),
        }
        answer = await outbound.post(url, body, headers, self.private_hosts)
        attempt = Attempt(message.attempts + 1, at, answer.seconds, answer.status, answer.error, answer.excerpt)
        self.webhooks.told(message, attempt)
        if not answer.ok:
            log.warning("webhook not told", extra={"webhook": message.webhook_id, "error": answer.error})
        return answer.ok

    def _prune(self) -> None:
        now = time.monotonic()
        if not self._pruned or now - self._pruned > PRUNE_SECONDS:
            self._pruned = now
            self.webhooks.prune()
