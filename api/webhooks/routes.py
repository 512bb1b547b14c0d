"""/v1/webhooks: who is told of what happens, and what they were told."""

from __future__ import annotations

import re
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response

from api.http.auth import Write
from api.http.bodies import body_of
from api.http.conditions import CHANGED, UNCHANGED, IfMatch, IfNoneMatch, document, require_match
from api.http.deps import Identifier, Served, location
from api.http.errors import ApiError
from api.http.idempotency import IdempotentRoute, Making
from api.http.pages import AskedPage
from api.webhooks.resources import message_resource, webhook_path, webhook_resource
from api.webhooks.service import new_webhook
from tomosim_contract.webhooks import (
    CreatedWebhook,
    MessagePage,
    MessageResource,
    NewWebhook,
    WebhookList,
    WebhookResource,
)
from worker.records.rows import NotFoundError, StateError

MAX_WEBHOOKS = 100

router = APIRouter(prefix="/webhooks", tags=["webhooks"], route_class=IdempotentRoute)


def _message_identifier(message_id: str) -> str:
    if not re.fullmatch("msg_[0-9a-f]{32}", message_id):
        raise NotFoundError(message_id, "message")
    return message_id


MessageIdentifier = Annotated[str, Depends(_message_identifier)]


@router.post("", status_code=201, openapi_extra=body_of(NewWebhook))
def create(
    caller: Write,
    new: Annotated[NewWebhook, Depends(new_webhook)],
    served: Served,
    making: Making,
    request: Request,
    response: Response,
) -> CreatedWebhook:
    """Makes a webhook. Its messages are signed as Standard Webhooks says, with the secret that is shown only now."""
    pair = served.webhooks.made_before(making.identifier) if making.again else None
    if pair is None:
        if len(served.webhooks.all()) >= MAX_WEBHOOKS:
            raise ApiError(409, "too-many-webhooks", f"there are {MAX_WEBHOOKS} webhooks: delete one first")
        description = new.description.replace("\0", "")
        pair = served.webhooks.create(new.url, new.events, description, making.identifier)
    row, secret = pair
    response.headers.update(location(request, webhook_path(row.id)))
    return CreatedWebhook(**webhook_resource(row).model_dump(), secret=secret)


@router.get("")
def list_webhooks(caller: Write, served: Served) -> WebhookList:
    """All webhooks, oldest first."""
    return WebhookList(items=[webhook_resource(row) for row in served.webhooks.all()])


@router.get("/{identifier}", response_model=WebhookResource, responses=UNCHANGED)
def get_webhook(caller: Write, identifier: Identifier, served: Served, if_none_match: IfNoneMatch = None) -> Response:
    """One webhook."""
    return document(webhook_resource(served.webhooks.get(identifier)), if_none_match)


@router.delete("/{identifier}", status_code=204, responses=CHANGED)
def delete(caller: Write, identifier: Identifier, served: Served, if_match: IfMatch = None) -> None:
    """Forgets a webhook and what was still to be told."""
    require_match(if_match, document(webhook_resource(served.webhooks.get(identifier))).headers["ETag"])
    served.webhooks.delete(identifier)


@router.post("/{identifier}/test", status_code=202)
def test(caller: Write, identifier: Identifier, served: Served, making: Making) -> MessageResource:
    """Sends a message of the event ``webhook.test``; its document says whether it arrived."""
    return message_resource(served.webhooks.test(identifier, making.identifier), [])


@router.post("/{identifier}/enable")
def enable(caller: Write, identifier: Identifier, served: Served) -> WebhookResource:
    """Tells a disabled webhook again of what happens from now on."""
    return webhook_resource(served.webhooks.enable(identifier))


@router.get("/{identifier}/messages")
def list_messages(
    caller: Write,
    identifier: Identifier,
    served: Served,
    page: AskedPage,
) -> MessagePage:
    """What was told in the last week and what is to be told, the newest first."""
    rows = served.webhooks.messages(identifier, page.rows, page.before)
    shown, following = page.shown(rows)
    return MessagePage(items=[message_resource(row) for row in shown], next=following)


@router.get("/{identifier}/messages/{message_id}")
def get_message(
    caller: Write, identifier: Identifier, message_id: MessageIdentifier, served: Served
) -> MessageResource:
    """One message with its content and every attempt to send it."""
    return message_resource(*served.webhooks.message(identifier, message_id))


@router.post("/{identifier}/messages/{message_id}/replay", status_code=202)
def replay(caller: Write, identifier: Identifier, message_id: MessageIdentifier, served: Served) -> Any:
    """Sends a message again that is done with."""
    try:
        return message_resource(served.webhooks.replay(identifier, message_id))
    except StateError:
        raise ApiError(409, "not-finished", "the message is still to be sent") from None
