"""The service from Python: ``Client`` for programs that wait, ``AsyncClient`` for those that do not.

Answers are the models that the service itself answers with; errors are exceptions with the service's stable code.
Needs neither the server nor the database nor the numerics.
"""

# ruff: noqa: E402 - the check comes before the imports it is about
from tomosim import own

own.refuse_foreign()

from tomosim.client.async_client import AsyncClient
from tomosim.client.common import DEFAULT_URL
from tomosim.client.errors import (
    ConflictError,
    DigestError,
    GoneError,
    InvalidRequestError,
    NotAllowedError,
    NotAuthenticatedError,
    NotFoundError,
    ServiceError,
    StorageFullError,
    TooManyRequestsError,
    UnavailableError,
    UnreachableError,
)
from tomosim.client.files import Downloaded
from tomosim.client.retrying import Retrying
from tomosim.client.streams import CaseEvent
from tomosim.client.sync_client import Client

__all__ = [
    "DEFAULT_URL",
    "AsyncClient",
    "CaseEvent",
    "Client",
    "ConflictError",
    "DigestError",
    "Downloaded",
    "GoneError",
    "InvalidRequestError",
    "NotAllowedError",
    "NotAuthenticatedError",
    "NotFoundError",
    "Retrying",
    "ServiceError",
    "StorageFullError",
    "TooManyRequestsError",
    "UnavailableError",
    "UnreachableError",
]
