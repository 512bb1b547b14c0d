"""What may be a webhook."""

from __future__ import annotations

from fastapi import Request

from api.http.bodies import posted
from api.http.deps import services
from api.http.errors import ApiError
from tomosim_contract.webhooks import NewWebhook
from worker.upkeep import outbound


async def new_webhook(request: Request) -> NewWebhook:
    """A posted webhook. raises: ApiError 413, 415, 422 where its address is not allowed"""
    new = await posted(request, NewWebhook)
    hosts = services(request).settings.webhook_private_host_names
    try:
        url = outbound.check_url(new.url, hosts)
        await outbound.resolve(url, hosts)
    except outbound.RefusedAddressError as error:
        item = {"pointer": "/url", "value": new.url[:200], "detail": str(error)}
        raise ApiError(422, "invalid-request", str(error), errors=[item], reason=error.code) from None
    except OSError:
        pass  # a name that is not known yet, or not now: sending will tell
    return new
