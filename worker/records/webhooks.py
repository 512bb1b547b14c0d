"""Webhooks: who wants to be told of what, and the outbox of what is still to be told.

A message is recorded in the same transaction as the change that it tells of (``announce``) and sent later by
``worker.upkeep.courier``: nothing is told that did not happen, and nothing that happened is forgotten.
"""

from __future__ import annotations

import base64
import json
import random
import secrets
import uuid
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from tomosim_contract.names import MessageState, WebhookEvent
from worker.records.database import Repository, columns_of, metadata, newest, reading, rows_of
from worker.records.rows import NotFoundError, StateError

Json = dict[str, Any]

MINUTE = 60.0
HOUR = 3600.0
DAY = 24 * HOUR

RETRY_SECONDS = (5.0, 30.0, 2 * MINUTE, 10 * MINUTE, 30 * MINUTE, HOUR, 2 * HOUR, 4 * HOUR, 6 * HOUR, 10 * HOUR)
"""Pauses after each failed attempt, about a day in all; each is varied by up to a tenth."""

CLAIM_SECONDS = 60.0
"""A sender that was silent for longer was killed: another one sends the message."""

KEEP_SECONDS = 7 * DAY
"""For so long one can look at messages that are done with."""

SECRET_BYTES = 32

webhooks = sa.Table(
    "webhooks",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("url", sa.Text, nullable=False),
    sa.Column("description", sa.String(200), nullable=False),
    sa.Column("events", sa.JSON, nullable=False),
    sa.Column("secret", sa.String(100), nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    # Since when every attempt has failed; NULL after a success.
    sa.Column("failing_since", sa.Double),
    sa.Column("disabled", sa.Double),
    sa.Column("disabled_reason", sa.Text, nullable=False),
)

messages = sa.Table(
    "webhook_messages",
    metadata,
    sa.Column("id", sa.String(40), primary_key=True),
    sa.Column("webhook_id", sa.String(32), sa.ForeignKey("webhooks.id", ondelete="CASCADE"), nullable=False),
    sa.Column("event", sa.String(32), nullable=False),
    # The very bytes that are signed and sent, every time the same.
    sa.Column("body", sa.Text, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("attempts", sa.Integer, nullable=False),
    # When it is to be sent (again); while it is sent, when its sender counts as gone.
    sa.Column("next_attempt", sa.Double),
    sa.Column("finished", sa.Double),
    sa.Index("webhook_messages_due", "state", "next_attempt"),
    sa.Index("webhook_messages_by_age", "webhook_id", "created", "id"),
)

attempts = sa.Table(
    "webhook_attempts",
    metadata,
    sa.Column("message_id", sa.String(40), sa.ForeignKey("webhook_messages.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("seconds", sa.Double, nullable=False),
    sa.Column("status", sa.Integer),
    sa.Column("error", sa.Text, nullable=False),
    sa.Column("answer", sa.Text, nullable=False),
)


@dataclass(frozen=True)
class Webhook:
    """A subscription, without its secret. Times: seconds since 1970."""

    id: str
    url: str
    description: str
    events: list[WebhookEvent]
    created: float
    failing_since: float | None
    disabled: float | None
    disabled_reason: str


@dataclass(frozen=True)
class Message:
    """Something that is told to one webhook."""

    id: str
    webhook_id: str
    event: WebhookEvent
    body: str
    state: MessageState
    created: float
    attempts: int
    next_attempt: float | None
    finished: float | None


@dataclass(frozen=True)
class Attempt:
    """One time a message was sent. status: of HTTP, None where no answer came; error: empty where it went well."""

    number: int
    at: float
    seconds: float
    status: int | None
    error: str
    answer: str


def announce(connection: sa.Connection, at: float, event: WebhookEvent, *data: Callable[[], Json]) -> None:
    """Records messages for every webhook that wants to be told of ``event``; part of the caller's transaction.

    at: seconds since 1970. data: makes what is told, as JSON can say it, each in a message of its own; called only
    where somebody wants to know.
    """
    # Locked, so that a webhook which is deleted meanwhile does not break the change that is told of.
    query = sa.select(webhooks.c.id, webhooks.c.events).where(webhooks.c.disabled.is_(None))
    rows = connection.execute(query.with_for_update(read=True, key_share=True))
    wanting = [row.id for row in rows if event in row.events]
    if wanting:
        for make in data:
            _record(connection, {_message_id(uuid.uuid4().hex): one for one in wanting}, at, event, make())


def _message_id(name: str) -> str:
    return f"msg_{name}"


def _record(connection: sa.Connection, receivers: dict[str, str], at: float, event: str, data: Json) -> None:
    """receivers: identifiers of messages, and the webhook of each."""
    stamp = datetime.fromtimestamp(at, UTC).isoformat().replace("+00:00", "Z")
    body = json.dumps({"type": event, "timestamp": stamp, "data": data}, separators=(",", ":"), allow_nan=False)
    rows = [
        {
            "id": message_id,
            "webhook_id": webhook_id,
            "event": event,
            "body": body,
            "state": "pending",
            "created": at,
            "attempts": 0,
            "next_attempt": at,
        }
        for message_id, webhook_id in receivers.items()
    ]
    connection.execute(messages.insert(), rows)


class Webhooks(Repository):
    """Repository of webhooks, their messages and the attempts to send them."""

    # What clients ask for

    def create(
        self, url: str, events: Sequence[WebhookEvent], description: str = "", identifier: str = ""
    ) -> tuple[Webhook, str]:
        """A new webhook and its secret ("whsec_..." as Standard Webhooks has it), which is told only now.

        identifier: a new one where empty.
        """
        secret = "whsec_" + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()
        webhook = Webhook(identifier or uuid.uuid4().hex, url, description, list(events), self.clock(), None, None, "")
        with self.engine.begin() as connection:
            connection.execute(webhooks.insert().values(**vars(webhook), secret=secret))
        return webhook, secret

    def made_before(self, identifier: str) -> tuple[Webhook, str] | None:
        """What ``create`` returned, for a client whose answer was lost; None where it did not get so far."""
        with reading(self.engine) as connection:
            secret = connection.scalar(sa.select(webhooks.c.secret).where(webhooks.c.id == identifier))
            return None if secret is None else (_webhook(connection, identifier), secret)

    def all(self) -> list[Webhook]:
        """Every webhook, oldest first."""
        with reading(self.engine) as connection:
            query = sa.select(*columns_of(webhooks, Webhook)).order_by(webhooks.c.created, webhooks.c.id)
            return rows_of(connection.execute(query), Webhook)

    def get(self, identifier: str) -> Webhook:
        """raises: NotFoundError"""
        with reading(self.engine) as connection:
            return _webhook(connection, identifier)

    def delete(self, identifier: str) -> None:
        """Forgets a webhook and what was to be told to it. raises: NotFoundError"""
        with self.engine.begin() as connection:
            if not connection.execute(webhooks.delete().where(webhooks.c.id == identifier)).rowcount:
                raise NotFoundError(identifier, "webhook")

    def enable(self, identifier: str) -> Webhook:
        """Tells a disabled webhook again of what happens from now on. raises: NotFoundError"""
        values = {"disabled": None, "disabled_reason": "", "failing_since": None}
        with self.engine.begin() as connection:
            connection.execute(webhooks.update().where(webhooks.c.id == identifier).values(values))
            return _webhook(connection, identifier)

    def test(self, identifier: str, name: str = "") -> Message:
        """Records a message of the event "webhook.test". raises: NotFoundError

        name: 32 hexadecimal digits that its identifier is made of; new ones where empty. Nothing is recorded where it
        was before.
        """
        message_id = _message_id(name or uuid.uuid4().hex)
        with self.engine.begin() as connection:
            _webhook(connection, identifier)
            if not connection.scalar(sa.select(sa.exists().where(messages.c.id == message_id))):
                data = {"webhook": identifier}
                _record(connection, {message_id: identifier}, self.clock(), "webhook.test", data)
            return _message(connection, identifier, message_id)

    def messages(self, identifier: str, limit: int, before: tuple[float, str] | None = None) -> list[Message]:
        """What was and is to be told, newest first; ``before``: (created, id) of the last one already seen.

        raises: NotFoundError
        """
        c = messages.c
        query = sa.select(*columns_of(messages, Message)).where(c.webhook_id == identifier)
        with reading(self.engine) as connection:
            _webhook(connection, identifier)
            return rows_of(connection.execute(newest(query, messages, limit, before)), Message)

    def message(self, identifier: str, message_id: str) -> tuple[Message, list[Attempt]]:
        """A message and every attempt to send it, oldest first. raises: NotFoundError"""
        query = sa.select(*columns_of(attempts, Attempt)).where(attempts.c.message_id == message_id)
        with reading(self.engine) as connection:
            message = _message(connection, identifier, message_id)
            return message, rows_of(connection.execute(query.order_by(attempts.c.number)), Attempt)

    def replay(self, identifier: str, message_id: str) -> Message:
        """Sends a message again that is done with, with the same identifier and content.

        raises: NotFoundError, StateError where it is still to be sent
        """
        done = (messages.c.id == message_id, messages.c.webhook_id == identifier, messages.c.state != "pending")
        values = {"state": "pending", "next_attempt": self.clock(), "finished": None}
        with self.engine.begin() as connection:
            changed = connection.execute(messages.update().where(*done).values(values)).rowcount
            message = _message(connection, identifier, message_id)
            if not changed:
                raise StateError("queued")
        return message

    # What the courier does

    def due(self, except_to: Collection[str] = (), limit: int = 200) -> list[Message]:
        """What is to be sent now, oldest first, without what goes to these webhooks."""
        c = messages.c
        query = sa.select(*columns_of(messages, Message)).where(c.state == "pending", c.next_attempt <= self.clock())
        query = query.where(c.webhook_id.not_in(except_to))
        with reading(self.engine) as connection:
            return rows_of(connection.execute(query.order_by(c.next_attempt, c.created).limit(limit)), Message)

    def claim(self, message: Message) -> tuple[str, str] | None:
        """Takes one attempt of a message that is due: (url, secret), or None where another sender was faster."""
        c, now = messages.c, self.clock()
        unchanged = (c.id == message.id, c.state == "pending", c.attempts == message.attempts, c.next_attempt <= now)
        values = {"attempts": message.attempts + 1, "next_attempt": now + CLAIM_SECONDS}
        where = sa.select(webhooks.c.url, webhooks.c.secret).where(webhooks.c.id == message.webhook_id)
        with self.engine.begin() as connection:
            if not connection.execute(messages.update().where(*unchanged).values(values)).rowcount:
                return None
            url, secret = connection.execute(where).one()
            return url, secret

    def told(self, message: Message, attempt: Attempt) -> None:
        """Writes down how a claimed attempt ended; after a failure, when the next one is, or that there is none.

        message: as it was before ``claim``. A webhook is disabled where it says 410 Gone, and where a message has
        used up all its attempts and nothing else arrived meanwhile.
        """
        now = self.clock()
        mine = sa.and_(
            messages.c.id == message.id, messages.c.state == "pending", messages.c.attempts == attempt.number
        )
        with self.engine.begin() as connection:
            values = self._after(message, attempt, now)
            if not connection.execute(messages.update().where(mine).values(values)).rowcount:
                return
            connection.execute(attempts.insert().values(message_id=message.id, **vars(attempt)))
            if not attempt.error:
                self._set_webhook(connection, message, failing_since=None)
                return
            failing = sa.func.coalesce(webhooks.c.failing_since, now)
            self._set_webhook(connection, message, failing_since=failing)
            self._hold_back(connection, message, values["next_attempt"] or now)
            if attempt.status == 410:
                self._disable(connection, message.webhook_id, "it answered 410: it wants no more messages")
            elif values["state"] == "failed" and self._nothing_arrived_since(connection, message):
                reason = f"nothing has arrived for {(now - message.created) / HOUR:.0f} hours: {attempt.error}"
                self._disable(connection, message.webhook_id, reason)

    def _after(self, message: Message, attempt: Attempt, now: float) -> Json:
        if not attempt.error:
            return {"state": "delivered", "next_attempt": None, "finished": now}
        if attempt.number > len(RETRY_SECONDS):
            return {"state": "failed", "next_attempt": None, "finished": now}
        pause = RETRY_SECONDS[attempt.number - 1] * random.uniform(0.9, 1.1)
        return {"state": "pending", "next_attempt": now + pause}

    def _hold_back(self, connection: sa.Connection, message: Message, until: float) -> None:
        """What else is due for the same receiver need not be tried before the message that just failed."""
        others = (messages.c.webhook_id == message.webhook_id, messages.c.state == "pending")
        connection.execute(messages.update().where(*others, messages.c.next_attempt < until).values(next_attempt=until))

    def _set_webhook(self, connection: sa.Connection, message: Message, **values: Any) -> None:
        connection.execute(webhooks.update().where(webhooks.c.id == message.webhook_id).values(values))

    def _nothing_arrived_since(self, connection: sa.Connection, message: Message) -> bool:
        theirs = sa.select(messages.c.id).where(messages.c.webhook_id == message.webhook_id)
        arrived = (attempts.c.message_id.in_(theirs), attempts.c.error == "", attempts.c.at >= message.created)
        return connection.execute(sa.select(attempts.c.message_id).where(*arrived).limit(1)).first() is None

    def _disable(self, connection: sa.Connection, identifier: str, reason: str) -> None:
        now = self.clock()
        values = {"disabled": now, "disabled_reason": reason}
        connection.execute(webhooks.update().where(webhooks.c.id == identifier).values(values))
        waiting = (messages.c.webhook_id == identifier, messages.c.state == "pending")
        ended = {"state": "failed", "next_attempt": None, "finished": now}
        connection.execute(messages.update().where(*waiting).values(ended))

    def prune(self) -> None:
        """Forgets messages that have been done with for a week."""
        old = messages.c.finished < self.clock() - KEEP_SECONDS
        with self.engine.begin() as connection:
            connection.execute(messages.delete().where(old))


def _webhook(connection: sa.Connection, identifier: str) -> Webhook:
    query = sa.select(*columns_of(webhooks, Webhook)).where(webhooks.c.id == identifier)
    rows = rows_of(connection.execute(query), Webhook)
    if not rows:
        raise NotFoundError(identifier, "webhook")
    return rows[0]


def _message(connection: sa.Connection, webhook_id: str, identifier: str) -> Message:
    mine = (messages.c.id == identifier, messages.c.webhook_id == webhook_id)
    rows = rows_of(connection.execute(sa.select(*columns_of(messages, Message)).where(*mine)), Message)
    if not rows:
        raise NotFoundError(identifier, "message")
    return rows[0]
