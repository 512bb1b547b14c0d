"""Who asks, and what they may do: API keys with scopes.

A route takes ``caller: Read`` (or Write, Deliver, Administer) as its first parameter. Where no key was ever made,
requests from this machine are those of the administrator ``local``.
"""

from __future__ import annotations

import base64
import binascii
import hmac
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request

from api.http.deps import Services, services
from api.http.errors import ApiError
from tomosim_contract.names import SCOPES, Scope
from worker import logs
from worker.records.quotas import Submitter
from worker.settings import is_loopback

CHALLENGES = [
    ("WWW-Authenticate", 'Bearer realm="tomosim"'),
    ("WWW-Authenticate", 'Basic realm="tomosim", charset="UTF-8"'),
]
"""Each in a line of its own: Chromium asks for no password where it stands behind another one."""


@dataclass(frozen=True)
class Principal:
    """Who asks. active_cases, cases_per_day: quotas of the key; None: those of the settings."""

    id: str
    name: str
    scopes: frozenset[Scope]
    active_cases: int | None = None
    cases_per_day: int | None = None

    def may(self, scope: Scope) -> bool:
        return scope in self.scopes or "admin" in self.scopes


LOCAL = Principal("local", "everybody on this machine", frozenset(SCOPES), active_cases=0, cases_per_day=0)
ADMIN = Principal("admin", "key of the settings", frozenset(SCOPES), active_cases=0, cases_per_day=0)


def authenticate(request: Request) -> Principal:
    """Who asks. raises: ApiError 401, 429, or 403 where a foreign page may stand behind a request without a key"""
    known: Principal | None = getattr(request.state, "principal", None)
    if known is not None:
        return known
    served = services(request)
    try:
        secret = _secret(request.headers.get("authorization"))
        principal = _without_key(request, served) if secret is None else _with_key(secret, served)
    except ApiError:
        _take(served, f"address/{request.client.host if request.client else 'local'}")
        raise
    if principal is not LOCAL:
        _take(served, f"key/{principal.id}")
    request.state.principal = principal
    return principal


def _take(served: Services, bucket: str) -> None:
    """raises: ApiError 429 where requests come too fast"""
    if wait := served.rates.take(bucket):
        seconds = max(1, math.ceil(wait))
        raise ApiError(
            429,
            "rate-limit",
            f"more than {served.rates.per_second:g} requests a second: wait {seconds} s",
            headers={"Retry-After": str(seconds)},
        )


Caller = Annotated[Principal, Depends(authenticate)]


def _needs(scope: Scope) -> Callable[[Principal], Principal]:
    def check(caller: Caller) -> Principal:
        if not caller.may(scope):
            has = ", ".join(sorted(caller.scopes)) or "none"
            raise ApiError(403, "scope-missing", f"this needs a key with the scope {scope!r}; the key has: {has}")
        return caller

    return check


def _submitter(request: Request, caller: Caller) -> Submitter:
    settings = services(request).settings
    active = settings.quota_active_cases if caller.active_cases is None else caller.active_cases
    daily = settings.quota_cases_per_day if caller.cases_per_day is None else caller.cases_per_day
    return Submitter(caller.id, logs.field("request"), active, daily)


Submitting = Annotated[Submitter, Depends(_submitter)]
"""Who posts cases, as their rows keep it. Goes with ``Write``."""

Read = Annotated[Principal, Depends(_needs("read"))]
Write = Annotated[Principal, Depends(_needs("write"))]
Deliver = Annotated[Principal, Depends(_needs("deliver"))]
Administer = Annotated[Principal, Depends(_needs("admin"))]


def _secret(authorization: str | None) -> str | None:
    """The secret of ``Bearer SECRET``, or of ``Basic``, where it is the password (browsers ask for one)."""
    if authorization is None:
        return None
    scheme, _, value = authorization.strip().partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    if scheme.lower() == "basic":
        try:
            return base64.b64decode(value.strip(), validate=True).decode().partition(":")[2]
        except (binascii.Error, UnicodeDecodeError):
            pass
    raise _unauthorized("send 'Authorization: Bearer KEY', or Basic with the key as password")


def _with_key(secret: str, served: Services) -> Principal:
    admin = served.settings.admin_secret
    if admin and hmac.compare_digest(secret.encode(), admin.encode()):
        return ADMIN
    key = served.keys.find(secret)
    if key is None:
        raise _unauthorized("there is no such API key")
    if ended := key.end(served.keys.clock()):
        raise _unauthorized(f"the API key {key.id} ({key.name}) is {ended}")
    served.keys.mark_used(key)
    return Principal(key.id, key.name, frozenset(key.scopes), key.active_cases, key.cases_per_day)


def _without_key(request: Request, served: Services) -> Principal:
    settings = served.settings
    if settings.admin_secret or served.keys.exist():
        raise _unauthorized("an API key is needed: send 'Authorization: Bearer KEY'")
    if settings.trusted_network:
        return LOCAL
    if not is_loopback(settings.host) or (request.client is not None and not is_loopback(request.client.host)):
        raise _unauthorized("without API keys only this machine is served: make one with 'tomosim keys create'")
    # A page of another site, in a browser on this machine, by a name that it lets point to 127.0.0.1.
    host = request.headers.get("host", "")
    if not is_loopback(_name(host)):
        raise ApiError(403, "host-not-allowed", f"Host = {host[:100]!r}: ask for 127.0.0.1 or localhost")
    return LOCAL


def _name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _unauthorized(detail: str) -> ApiError:
    return ApiError(401, "unauthorized", detail, headers=CHALLENGES)
