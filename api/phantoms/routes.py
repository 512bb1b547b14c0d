"""/v1/phantoms: label volumes of one's own."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from api.http.auth import Read, Write
from api.http.bodies import content_type
from api.http.deps import Served, location, services
from api.http.errors import ApiError
from api.phantoms.resources import phantom_path, phantom_resource
from api.phantoms.service import check_size, receive
from simcore.phantom.upload import registry
from simcore.phantom.upload.reading import Reading
from tomosim_contract.phantoms import PhantomList, PhantomResource

MEDIA_TYPE = "application/octet-stream"

router = APIRouter(prefix="/phantoms", tags=["phantoms"])

_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    }
}


def _reading(
    reading: Annotated[
        str | None,
        Query(
            description="JSON: how the file is to be read, as far as it does not say so itself: tissues, compressed, "
            "axes, spacing_mm, confirm_size, confirm_tissues, and for raw voxels raw = {shape, spacing_mm, dtype, "
            "...}; see the schema 'reading'"
        ),
    ] = None,
) -> Reading:
    return Reading() if reading is None else Reading.parse(reading)


@router.post("", status_code=201, openapi_extra=_BODY)
async def create(
    caller: Write,
    request: Request,
    response: Response,
    reading: Annotated[Reading, Depends(_reading)],
    name: Annotated[str, Query(max_length=200, description="what the file is called, for people")] = "",
) -> PhantomResource:
    """Takes a label volume (NRRD, MetaImage, NIfTI, or raw voxels with a header in ``reading``) into the store.

    The body is written to the disk as it comes, and unpacked never further than its header announces.
    """
    served = services(request)
    limit = served.settings.upload_limit_bytes
    kind = content_type(request)
    if kind != MEDIA_TYPE:
        # Also keeps out pages of other sites: a browser sends them this type only after asking us.
        raise ApiError(415, "unsupported-media-type", f"Content-Type = {kind!r}: the body must be {MEDIA_TYPE}")
    announced = request.headers.get("content-length", "")
    if announced.isdigit():
        check_size(int(announced), limit)
        served.store.require_space(int(announced))
    with served.store.workspace() as folder:
        received = folder / "upload"
        await receive(request, received, limit)
        upload = await run_in_threadpool(registry.add_received, served.store, received, name, reading)
    response.headers.update(location(request, phantom_path(upload.sha256)))
    return phantom_resource(upload)


@router.get("")
def list_phantoms(caller: Read, served: Served) -> PhantomList:
    """All label volumes, by digest."""
    return PhantomList(items=[phantom_resource(upload) for upload in registry.uploads(served.store)])


@router.get("/{sha256}")
def get_phantom(caller: Read, sha256: str, served: Served) -> PhantomResource:
    """One label volume."""
    upload = registry.get(served.store, sha256) if registry.is_digest(sha256) else None
    if upload is None:
        raise ApiError(404, "phantom-not-found", f"there is no phantom {sha256[:100]!r}")
    return phantom_resource(upload)
