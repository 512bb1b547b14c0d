"""Finding destinations, and what may stand in one."""

from __future__ import annotations

from typing import Any

from api.http.deps import Services
from api.http.errors import ApiError
from tomosim_contract.destination import Destination
from worker.delivery.addresses import DestinationNotAllowed, require_allowed
from worker.records.destinations import DestinationRow, NameTakenError
from worker.records.rows import NotFoundError


def find_destination(served: Services, name: str, pointer: str) -> DestinationRow:
    """A destination by identifier or name, named in a body. raises: ApiError 422"""
    try:
        return served.destinations.find(name)
    except NotFoundError:
        known = ", ".join(row.definition.name for row in served.destinations.all()) or "none"
        detail = f"there is no destination {name[:100]!r}; there are: {known}"
        item = {"pointer": pointer, "value": name[:100], "detail": detail}
        raise ApiError(422, "invalid-request", f"{pointer}: {detail}", errors=[item]) from None


def check_host(definition: Destination, served: Services) -> None:
    try:
        require_allowed(definition.host, served.settings.allowed_destinations)
    except DestinationNotAllowed as error:
        item = {"pointer": "/host", "value": definition.host, "detail": str(error)}
        raise ApiError(422, "invalid-request", str(error), errors=[item], reason=error.code) from None


def merge(target: Any, patch: Any) -> Any:
    """RFC 7396; a field that is taken away has its default."""
    if not isinstance(patch, dict):
        return patch
    merged = dict(target) if isinstance(target, dict) else {}
    for key, value in patch.items():
        if value is None:
            merged.pop(key, None)
        else:
            merged[key] = merge(merged.get(key), value)
    return merged


def name_taken(error: NameTakenError) -> ApiError:
    return ApiError(409, "name-taken", f"name = {str(error)!r}: another destination has this name")
