"""What a webhook is made from, and answers about webhooks."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, ConfigDict, Field

from tomosim_contract.names import MessageState, WebhookEvent

DEFAULT_EVENTS: tuple[WebhookEvent, ...] = (
    "simulation.succeeded",
    "simulation.failed",
    "simulation.cancelled",
    "study.finished",
    "delivery.finished",
)


class NewWebhook(BaseModel):
    """A webhook to be made."""

    model_config = ConfigDict(extra="forbid", strict=True)

    url: str = Field(min_length=1, max_length=2000, description="where messages are posted to; https")
    events: list[WebhookEvent] = Field(
        list(DEFAULT_EVENTS), min_length=1, max_length=20, description="what it is told of; everything by default"
    )
    description: str = Field("", max_length=200, description="for people")


class WebhookResource(BaseModel):
    """Somebody who is told of what happens."""

    id: str
    url: str
    description: str
    events: list[WebhookEvent]
    state: str = Field(description="active; failing: the last message did not arrive; disabled: nothing is sent")
    created_at: datetime
    failing_since: datetime | None
    disabled_at: datetime | None
    disabled_reason: str
    links: dict[str, str]


class CreatedWebhook(WebhookResource):
    """A new webhook with its secret, which is shown only here."""

    secret: str = Field(description="key of the signatures, as Standard Webhooks has it: keep it")


class WebhookList(BaseModel):
    """All webhooks, oldest first."""

    items: list[WebhookResource]


class AttemptResource(BaseModel):
    """One time a message was sent."""

    number: int
    at: datetime
    seconds: float
    status: int | None = Field(description="of the HTTP answer; null where none came")
    error: str = Field(description="empty where it arrived")
    answer: str = Field(description="the beginning of the body of the answer")


class MessageResource(BaseModel):
    """Something that a webhook is told."""

    id: str = Field(description="sent as webhook-id, every time the same")
    event: WebhookEvent
    state: MessageState
    created_at: datetime
    attempts: int
    next_attempt_at: datetime | None
    finished_at: datetime | None
    body: str | None = Field(None, description="what is sent; left out of lists")
    log: list[AttemptResource] | None = Field(None, description="every attempt; left out of lists")
    links: dict[str, str]


class MessagePage(BaseModel):
    """Some messages, the newest first; the next page is in the Link header and in ``next``."""

    items: list[MessageResource]
    next: str | None
