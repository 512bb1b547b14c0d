"""Documents of webhooks, made from their rows."""

from __future__ import annotations

from api.http.documents import PREFIX, when, when_or_none
from tomosim_contract.webhooks import AttemptResource, MessageResource, WebhookResource
from worker.records.webhooks import Attempt, Message, Webhook


def webhook_path(identifier: str) -> str:
    return f"{PREFIX}/webhooks/{identifier}"


def webhook_resource(row: Webhook) -> WebhookResource:
    """The document of a webhook."""
    path = webhook_path(row.id)
    links = {"self": path, "messages": f"{path}/messages", "test": f"{path}/test"}
    if row.disabled is not None:
        links["enable"] = f"{path}/enable"
    return WebhookResource(
        id=row.id,
        url=row.url,
        description=row.description,
        events=row.events,
        state="disabled" if row.disabled is not None else "failing" if row.failing_since is not None else "active",
        created_at=when(row.created),
        failing_since=when_or_none(row.failing_since),
        disabled_at=when_or_none(row.disabled),
        disabled_reason=row.disabled_reason,
        links=links,
    )


def message_resource(row: Message, log: list[Attempt] | None = None) -> MessageResource:
    """The document of a message; with its content where ``log`` is given."""
    path = f"{webhook_path(row.webhook_id)}/messages/{row.id}"
    links = {"self": path, "webhook": webhook_path(row.webhook_id)}
    if row.state != "pending":
        links["replay"] = f"{path}/replay"
    return MessageResource(
        id=row.id,
        event=row.event,
        state=row.state,
        created_at=when(row.created),
        attempts=row.attempts,
        next_attempt_at=when_or_none(row.next_attempt),
        finished_at=when_or_none(row.finished),
        body=None if log is None else row.body,
        log=None if log is None else [_attempt_resource(one) for one in log],
        links=links,
    )


def _attempt_resource(row: Attempt) -> AttemptResource:
    return AttemptResource(**{**vars(row), "at": when(row.at)})
